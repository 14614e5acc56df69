"""What a compiled function was made from: its own code and that of every function it calls, in whatever file.

A Python function flows in; a digest flows out. Code is taken from memory, where it is what runs, not from files, which
may have been edited since they were read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


def digest_calls(function: FunctionType) -> str:
    """Return the SHA-256 of a function, the functions that it calls, the constants that they read, and their modules.

    Names are looked up when this is called, so that a function may call what its file defines further down.
    """
    digest = hashlib.sha256()
    for part in _describe_function(function, set()):
        digest.update(part.encode())
        digest.update(b"\0")
    return digest.hexdigest()


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
