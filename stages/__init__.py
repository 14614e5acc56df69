"""The study: a folder is a workflow, a file in it a stage; what needs no pipeline is in `science`."""

import os
import sys

os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES",
    "stages.science.compilation.locators.InNamedFolder,stages.science.compilation.locators.BesideSource,"
    "stages.science.compilation.locators.InHomeFolder,IPythonCacheLocator,ZipCacheLocator",
)
if "numba" in sys.modules:  # which reads the variable once
    sys.modules["numba"].config.CACHE_LOCATOR_CLASSES = os.environ["NUMBA_CACHE_LOCATOR_CLASSES"]
