"""MAT files of version 7 and older: vectors, in structs too, flow out by name, with single numbers and what is neither.

scipy is imported where a file is read, as most studies read none.
"""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

HDF5 = b"\x89HDF\r\n\x1a\n"
MOST_COLUMNS = 64
"""Columns of a matrix beyond which it is no set of signals."""
OBJECT = "an object of MATLAB (a table, timetable, string, function); write its columns as vectors"

Vector = NDArray[Any]


@dataclass
class Variables:
    """The vectors of a MAT file, (N,), its numbers that stand alone, and why the rest cannot be read as columns.

    Vectors of a struct are named ``struct.field``, the columns of a matrix ``matrix_1``, ``matrix_2``, signals that
    Simulink logs ``struct.label``.
    """

    vectors: dict[str, Vector] = field(default_factory=dict)
    single: dict[str, float] = field(default_factory=dict)
    left: dict[str, str] = field(default_factory=dict)


def read_variables(path: Path) -> Variables:
    """Read a MAT file; a `ValueError` tells one of version 7.3."""
    with path.open("rb") as handle:
        head = handle.read(520)
    if head.startswith((b"MATLAB 7.3", HDF5)) or head[512:] == HDF5:
        raise ValueError("version 7.3, expected 7 or older; load it in MATLAB and type: save('new.mat', '-v7')")
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = loadmat(path, simplify_cells=True)
    found = Variables()
    for name, value in loaded.items():
        if not name.startswith("__"):
            _sort(name, value, found)
    return found


def _sort(name: str, value: Any, found: Variables) -> None:
    if isinstance(value, dict):
        for each, part in _spread_scope(value).items():
            _sort(f"{name}.{each}", part, found)
        return
    if isinstance(value, list):
        _stack(name, value, found)
        return
    if type(value).__name__.startswith("Matlab"):
        found.left[name.removeprefix("None") or "a variable"] = OBJECT
        return
    array = np.asarray(value.toarray() if hasattr(value, "toarray") else value)
    reason = _refuse(array)
    if reason:
        found.left[name] = reason
    elif array.size == 1:
        if array.dtype.kind in "fiub":
            found.single[name] = float(array.reshape(()))
        elif array.dtype.kind == "O":
            found.left[name] = OBJECT
    elif array.ndim == 1:
        found.vectors[name] = array.astype(str) if array.dtype.kind in "OU" else array
    else:
        columns = array if array.shape[0] >= array.shape[1] else array.T
        found.vectors |= {f"{name}_{k + 1}": column for k, column in enumerate(columns.T)}


def _spread_scope(struct: dict[str, Any]) -> dict[str, Any]:
    """Return a struct with the values of its signals by their labels, if it is one that Simulink logs; else itself."""
    signals = struct.get("signals")
    several = [signals] if isinstance(signals, dict) else signals
    if (
        "time" not in struct
        or not isinstance(several, list)
        or not all(isinstance(each, dict) and {"values", "label"} <= set(each) for each in several)
    ):
        return struct
    labels = [each["label"] if isinstance(each["label"], str) else "" for each in several]
    told = {
        label or f"signal_{k + 1}": each["values"] for k, (label, each) in enumerate(zip(labels, several, strict=True))
    }
    return {"time": struct["time"], **told} if len(told) == len(several) else struct


def _refuse(array: Vector) -> str:
    """Return why an array holds no columns; empty where it does."""
    kind = array.dtype.kind
    if kind == "V":
        return OBJECT
    if kind == "O":
        texts = array.ndim == 1 and array.size and all(isinstance(each, str) for each in array.flat)
        return "" if texts else "a cell array; write its numbers as vectors"
    if kind == "c":
        return "complex numbers; write their parts as vectors"
    if array.size == 0:
        return "empty"
    if array.ndim > 2 or (array.ndim == 2 and min(array.shape) > MOST_COLUMNS):
        return f"{' x '.join(map(str, array.shape))} numbers; write one vector for each signal"
    return "" if kind in "fiubU" else "neither numbers nor text"


def _stack(name: str, structs: list[Any], found: Variables) -> None:
    """Take an array of structs for records: each field's vectors behind each other, and the struct's number."""
    told = [Variables() for _ in structs]
    for each, into in zip(structs, told, strict=True):
        _sort(name, each, into)
    shared = [key for key in told[0].vectors if all(key in each.vectors for each in told)]
    sizes = [{len(each.vectors[key]) for key in shared} for each in told]
    if not shared or any(len(each) != 1 for each in sizes):
        found.left[name] = "structs whose vectors differ in length; write one vector for each signal"
        return
    found.vectors[name] = np.repeat([f"{k + 1}" for k in range(len(structs))], [each.pop() for each in sizes])
    found.vectors |= {key: np.concatenate([each.vectors[key] for each in told]) for key in shared}
