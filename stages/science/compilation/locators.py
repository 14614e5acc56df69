"""Where numba keeps what it compiled, each function under the fingerprint of all that it calls.

numba's own locators take a compiled function for fresh as long as its own file is unchanged; what it calls in other
files was compiled into it and would go on unchanged. These stand in their place for every function of the process that
is compiled with ``cache=True``, users' own included: `stages` names them to numba before it is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from types import FunctionType

from numba.core import config
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from stages.science.compilation.fingerprint import digest_calls


class Fingerprint:
    """A digest of a function and all that it calls, found when it is first compared or kept.

    It is compared with the text that was kept, and kept as such: a function is decorated before all that it calls is
    there.
    """

    def __init__(self, function: FunctionType):
        self._function = function

    @cached_property
    def _digest(self) -> str:
        return digest_calls(self._function)

    def __eq__(self, other: object) -> bool:
        return str(other) == self._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    def __str__(self) -> str:
        return self._digest

    def __reduce__(self) -> tuple[Callable[[str], str], tuple[str]]:
        return str, (self._digest,)


class ByCalls:
    """Stamps a function by all that it calls."""

    def __init__(self, function: FunctionType, file: str):
        super().__init__(function, file)  # type: ignore[call-arg]
        self._fingerprint, self._module = Fingerprint(function), function.__module__

    def get_source_stamp(self) -> Fingerprint:
        """Return what a kept function must agree with."""
        return self._fingerprint


class InNamedFolder(ByCalls, UserProvidedCacheLocator):
    """In the folder that the variable NUMBA_CACHE_DIR names, shared by all checkouts whose functions are the same."""

    def get_cache_path(self) -> str:
        """Return the folder of the function's module."""
        return f"{config.CACHE_DIR}/{self._module}"  # type: ignore[attr-defined]


class BesideSource(ByCalls, InTreeCacheLocator):
    """In ``__pycache__`` beside the function's file."""


class InHomeFolder(ByCalls, UserWideCacheLocator):
    """In the user's cache folder, where the function's file lies in a folder that may not be written."""
