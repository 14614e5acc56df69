"""Where numba keeps what it compiled, each function under the fingerprint of all that it calls.

numba's own locators take a compiled function for fresh as long as its own file is unchanged; what it calls in other
files was compiled into it and would go on unchanged. These stand in their place for every function of the process that
is compiled with ``cache=True``, users' own included: `stages` names them to numba before it is imported. Code is taken
from memory, where it is what runs, not from files, which may have been edited since they were read.
"""

import hashlib
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import config
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator


class Fingerprint:
    """The SHA-256 of a function, the functions that it calls, the constants that they read, and their modules.

    It is found when it is first compared with the text that was kept, or kept as such: a function is decorated before
    all that it calls is there.
    """

    def __init__(self, function: FunctionType):
        self._function, self._digest = function, ""

    def __eq__(self, other: object) -> bool:
        return str(other) == str(self)

    def __str__(self) -> str:
        if not self._digest:
            parts = (part.encode() + b"\0" for part in _describe_function(self._function, set()))
            self._digest = hashlib.sha256(b"".join(parts)).hexdigest()
        return self._digest

    def __reduce__(self) -> tuple[Callable[[str], str], tuple[str]]:
        return str, (str(self),)


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


def _describe_function(function: FunctionType, told: set[int]) -> Iterator[str]:
    if id(function) in told:
        yield f"again {function.__qualname__}"
        return
    told.add(id(function))
    yield f"{function.__module__}.{function.__qualname__}"
    dispatcher = function.__globals__.get(function.__name__)
    if getattr(dispatcher, "py_func", None) is function:
        yield _describe_options(dispatcher)
    codes = list(_walk(function.__code__))
    for code in codes:
        yield code.co_code.hex()
        yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))
        yield from (repr(constant) for constant in code.co_consts if not isinstance(constant, CodeType))
    yield from _describe_value(function.__defaults__, set(), told)
    for cell in function.__closure__ or ():
        yield from _describe_value(cell.cell_contents, set(), told)
    names = {name for code in codes for name in code.co_names}
    for name in sorted(names & function.__globals__.keys()):
        yield name
        yield from _describe_value(function.__globals__[name], names, told)


def _describe_options(dispatcher: Any) -> str:
    return repr(sorted((name, repr(value)) for name, value in dispatcher.targetoptions.items()))


def _walk(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _walk(constant)


def _describe_value(value: object, names: set[str], told: set[int]) -> Iterator[str]:
    """Tell what a name stands for; of a module, only what `names` may ask of it."""
    function = getattr(value, "py_func", value)
    if isinstance(function, FunctionType):
        if function is not value:
            yield _describe_options(value)
        yield from _describe_function(function, told)
    elif isinstance(value, ModuleType):
        yield f"{value.__name__} {getattr(value, '__version__', '')}"
        for name in sorted(names & vars(value).keys()):
            if not isinstance(vars(value)[name], ModuleType):
                yield name
                yield from _describe_value(vars(value)[name], names, told)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    elif isinstance(value, tuple | list):
        yield f"{type(value).__qualname__} {len(value)}"
        for each in value:
            yield from _describe_value(each, names, told)
    elif isinstance(value, type):
        yield f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', '')}"
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield repr(value)
    else:
        yield f"{type(value).__module__}.{type(value).__qualname__}"
