"""Tables that others wrote, in Parquet, text and MAT files and in bags of messages.

A path flows in, columns under their own names flow out.
A file that is none of these, or cannot be read, is refused in one line.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import pandas as pd
import pyarrow.parquet

from stages.science.recording.files.bags import is_bag, read_bag
from stages.science.recording.files.delimited import PACKED, Header, read_delimited
from stages.science.recording.files.matlab import Variables, Vector, read_variables

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".log", ".lvm")
TABLE_SUFFIXES = (".parquet", ".mat", ".mcap", *TEXT_SUFFIXES)
REMEDIES = {".xlsx": "save the sheet as CSV", ".xls": "save the sheet as CSV"}
KEPT = 2
"""Text files whose tables are kept, as each is asked for its header and for its values."""


class FileError(Exception):
    """A file cannot be read, or does not hold what it should; the message fits on one line and names the file."""


class UnequalColumns(FileError):
    """Columns that are wanted together differ in length."""


def read_header(path: Path) -> Header:
    """Return what a file that others wrote says of its columns; raises as `read_samples`."""
    with _explained(path):
        if is_bag(path):
            bag = read_bag(path)
            return Header(bag.names, {}, {}, bag.remarks)
        suffix = _suffix(path)
        if suffix == ".parquet":
            names = [str(name) for name in pyarrow.parquet.read_schema(path).names]
            return Header([name for name in names if not name.startswith("__index_level_")], {}, {}, [])
        if suffix == ".mat":
            found = read_variables(path)
            left = [f"{name} is left alone: {why}" for name, why in found.left.items()]
            return Header(list(found.vectors), {}, found.single, left)
        return _read_text(path)[1]


def read_samples(path: Path, names: Collection[str] | None = None) -> pd.DataFrame:
    """Read a table that others wrote; its rows are counted from 0.

    Parameters
    ----------
    path : Path
        A Parquet, text, MAT or MCAP file, or the folder of a ROS 2 bag.
    names : collection of str or None
        Columns that are wanted, of those that are there; None for all, as far as they are equally long.

    Raises
    ------
    FileError
        When it is none of these, whatever the reason.
    UnequalColumns
        When wanted columns differ in length.
    """
    with _explained(path):
        if is_bag(path):
            return read_bag(path).join(names)
        suffix = _suffix(path)
        if suffix == ".mat":
            return _align(path, read_variables(path), names)
        if suffix == ".parquet":
            frame: pd.DataFrame = pd.read_parquet(path)
            frame = frame.reset_index(drop=frame.index.names == [None])
            return frame if names is None else frame[[each for each in frame if each in names]]
        table, _ = _read_text(path)
        return table[[each for each in table if names is None or each in names]]


def read_columns(path: Path) -> dict[str, pd.Series]:
    """Return every column of a file by itself, as those of a MAT file may differ in length."""
    if path.suffix.lower() != ".mat":
        frame = read_samples(path)
        return {str(name): frame[name] for name in frame}
    with _explained(path):
        return {name: pd.Series(_native(values), name=name) for name, values in read_variables(path).vectors.items()}


def _align(path: Path, found: Variables, names: Collection[str] | None) -> pd.DataFrame:
    lengths = {name: len(values) for name, values in found.vectors.items() if names is None or name in names}
    if names is None and lengths:
        usual = max(lengths.values(), key=list(lengths.values()).count)
        lengths = {name: length for name, length in lengths.items() if length == usual}
    firsts: dict[int, str] = {}
    for name, length in lengths.items():
        firsts.setdefault(length, f"{name} ({length})")
    if len(firsts) > 1:
        raise UnequalColumns(f"{path}: expected columns of one length, got {' and '.join(firsts.values())}")
    return pd.DataFrame({name: _native(found.vectors[name]) for name in lengths})


def _native(values: Vector) -> Vector:
    """Return an array in this machine's order of bytes, which pandas demands."""
    return values.astype(values.dtype.newbyteorder("="))


def _read_text(path: Path) -> tuple[pd.DataFrame, Header]:
    state = path.stat()
    return _read_text_of(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=KEPT)
def _read_text_of(path: Path, changed_ns: int, size: int) -> tuple[pd.DataFrame, Header]:
    return read_delimited(path)


def _suffix(path: Path) -> str:
    suffixes = [each.lower() for each in path.suffixes]
    suffix = suffixes[-2] if suffixes[1:] and suffixes[-1] in PACKED else path.suffix.lower()
    if suffix not in TABLE_SUFFIXES:
        remedy = REMEDIES.get(suffix, "save its columns as one of these")
        known = f"{', '.join(TABLE_SUFFIXES[:-1])} or {TABLE_SUFFIXES[-1]}"
        raise FileError(f"{path}: expected a {known} file, got '{path.name}'; {remedy}")
    return suffix


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """State in one line why a file cannot be read."""
    try:
        yield
    except FileError:
        raise
    except ModuleNotFoundError as error:
        library = str(error.name).partition(".")[0]
        remedy = 'type: pip install "pamid[bags]"'
        raise FileError(f"{path}: expected the library {library}, which reads such files; {remedy}") from None
    except Exception as error:  # a library raises whatever the bytes of a broken file lead to
        told = (str(error).splitlines() or [type(error).__name__])[0]
        kind = "CSV" if {*path.suffixes} & {*TEXT_SUFFIXES} else path.suffix[1:].upper() or "a ROS 2 bag"
        raise FileError(f"{path}: cannot be read as {kind} ({told[:200]})") from None
