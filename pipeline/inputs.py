"""Files that a person brings: a path in the configuration flows in; hashes of its bytes, tables and mappings flow out.

A stage whose model has an `InputPath` reads what lies at that path. Its bytes count in the stage's freshness, so that
other bytes at the same path are another study's.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow
import pyarrow.parquet
from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from pipeline.errors import InputError, PipelineError
from pipeline.files import hash_file

TABLE_SUFFIXES = (".parquet", ".csv")
SEPARATORS = ("\t", ";", ",")
"""Between the columns of a CSV file; the one that its header has most of, the first among equals."""


class InputPath(str):
    """The path of a file or folder that is there, from where the command is typed.

    As a field of a stage's model, it makes the stage read those files: of a folder, the ones directly in it, but for
    hidden ones.
    """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        text = core_schema.str_schema(strict=True, min_length=1)
        return core_schema.no_info_after_validator_function(cls._find, text)

    @classmethod
    def _find(cls, text: str) -> InputPath:
        if not Path(text).exists():
            where = "there" if Path(text).is_absolute() else f"in {Path.cwd()}"
            raise ValueError(f"expected the path of a file or folder, got {text!r}, which is not {where}")
        if not cls(text).files:
            raise ValueError(f"expected files in the folder {text!r}, got none")
        return cls(text)

    @property
    def files(self) -> list[Path]:
        """The file itself, or those in the folder, by name."""
        path = Path(self)
        if not path.is_dir():
            return [path]
        return sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))


def hash_inputs(config: BaseModel) -> dict[str, str]:
    """Return the hash of every file that a stage's configuration names, by key and file name.

    Raises
    ------
    PipelineError
        When a file cannot be read.
    """
    hashes = {}
    for key, path in _find_paths(dict(config), ""):
        for file in path.files:
            try:
                hashes[f"{key}/{file.name}"] = hash_file(file)
            except OSError as error:
                raise PipelineError(f"{key}={path}: cannot read {file} ({error.strerror or error})") from None
    return hashes


def read_foreign(path: Path) -> pd.DataFrame:
    """Read a Parquet or CSV file that others wrote; its rows are counted from 0.

    Raises
    ------
    InputError
        When it is neither, whatever the reason.
    """
    try:
        if _suffix(path) == ".csv":
            return pd.read_csv(path, sep=_find_separator(path), encoding="utf-8-sig", low_memory=False)
        frame: pd.DataFrame = pd.read_parquet(path).reset_index(drop=True)
    except (OSError, ValueError, KeyError, TypeError, pyarrow.ArrowException) as error:
        raise _unreadable(path, error) from None
    return frame


def read_header(path: Path) -> list[str]:
    """Return the names of the columns of a Parquet or CSV file that others wrote.

    Raises
    ------
    InputError
        As of `read_foreign`.
    """
    try:
        if _suffix(path) == ".csv":
            return list(pd.read_csv(path, sep=_find_separator(path), encoding="utf-8-sig", nrows=0).columns)
        return [str(name) for name in pyarrow.parquet.read_schema(path).names]
    except (OSError, ValueError, KeyError, TypeError, pyarrow.ArrowException) as error:
        raise _unreadable(path, error) from None


def read_json(path: Path) -> Any:
    """Read a JSON file that others wrote.

    Raises
    ------
    InputError
        Naming the line that breaks it.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: expected JSON, got {error.msg} in line {error.lineno}") from None
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in TABLE_SUFFIXES:
        raise InputError(f"{path}: expected a {' or '.join(TABLE_SUFFIXES)} file, got '{path.name}'")
    return suffix


def _find_separator(path: Path) -> str:
    with path.open(encoding="utf-8-sig") as handle:
        header = handle.readline()
    return max(SEPARATORS, key=header.count)


def _unreadable(path: Path, error: Exception) -> InputError:
    told = (str(error).splitlines() or [type(error).__name__])[0]
    return InputError(f"{path}: cannot be read as {path.suffix[1:].upper()} ({told[:120]})")


def _find_paths(value: Any, key: str) -> Iterator[tuple[str, InputPath]]:
    if isinstance(value, InputPath):
        yield key, value
    elif isinstance(value, BaseModel):
        yield from _find_paths(dict(value), key)
    elif isinstance(value, Mapping):
        for name, each in value.items():
            yield from _find_paths(each, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            yield from _find_paths(each, f"{key}.{index}")
