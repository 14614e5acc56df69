"""Files that a person brings: a path in the configuration flows in; hashes of its bytes and mappings flow out.

A stage whose model has an `InputPath` reads what lies at that path. Its bytes count in the stage's freshness, so that
other bytes at the same path are another study's.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from pipeline.errors import InputError, PipelineError
from pipeline.files import hash_file
from pipeline.flat import walk


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
    """Return the hash of every file that a stage's configuration names, by key and file name."""
    hashes = {}
    for key, path in walk(config):
        for file in path.files if isinstance(path, InputPath) else ():
            try:
                hashes[f"{key}/{file.name}"] = hash_file(file)
            except OSError as error:
                raise PipelineError(f"{key}={path}: cannot read {file} ({error.strerror or error})") from None
    return hashes


def read_json(path: Path) -> Any:
    """Read a JSON file that others wrote; an InputError names the line that breaks it."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: expected JSON, got {error.msg} in line {error.lineno}") from None
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
