"""The study, in the order data flows: a file is a stage, a folder is science."""

import os
import sys

os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES",
    "stages.compilation.locators.InNamedFolder,stages.compilation.locators.BesideSource,"
    "stages.compilation.locators.InHomeFolder,IPythonCacheLocator,ZipCacheLocator",
)
if "numba" in sys.modules:  # which reads the variable once
    sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ["NUMBA_CACHE_LOCATOR_CLASSES"]
