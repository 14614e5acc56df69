"""Files that are either whole or absent: temporary name, flush, rename.

Every byte that a run leaves goes through `write_atomically` or `link`, so a process killed at any instant leaves no
half-written file under a final name.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

_PACKAGE = Path(__file__).resolve().parent
CONFIG_FOLDER = _PACKAGE / "conf" if (_PACKAGE / "conf").is_dir() else _PACKAGE.parent / "conf"
"""Of the configuration: beside this package in a checkout, within it once installed."""

TEMPORARY_SUFFIX = ".tmp"
READ_ONLY = 0o444


def write_atomically(path: Path, write: Callable[[Path], object], final: bool = False) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it to `path`, whose folder is made if need be.

    A file that is `final` is made read-only, as runs share it by hard links. When the disk refuses, the temporary file
    is gone and `path` is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(path)
    try:
        write(temporary)
        sync_file(temporary)
        if final:
            temporary.chmod(READ_ONLY)
        temporary.replace(path)
        sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_folder(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Make a folder of files that are final, by their names: all of them are there and whole, or no folder is.

    One that another process made meanwhile stays as it is.
    """
    temporary = temporary_name(folder)
    try:
        temporary.mkdir(parents=True)
        for name, content in contents.items():
            (temporary / name).write_bytes(content)
            sync_file(temporary / name)
            (temporary / name).chmod(READ_ONLY)
        sync_folder(temporary)
        try:
            temporary.rename(folder)
        except OSError:
            if not folder.is_dir():
                raise
        sync_folder(folder.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def temporary_name(path: Path) -> Path:
    """Return a name beside `path` that no process on any machine takes, for what is to be renamed to `path`."""
    return path.with_name(f".{path.stem}.{uuid4().hex[:12]}{TEMPORARY_SUFFIX}{path.suffix}")


def sync_file(path: Path) -> None:
    """Have the bytes of a file reach the disk."""
    with path.open("rb") as handle:
        os.fsync(handle.fileno())


def sync_folder(folder: Path) -> None:
    """Have the names in a folder reach the disk, where the system can do that."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_text(path: Path, text: str, final: bool = False) -> None:
    """Write `text` to `path` atomically, as UTF-8."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"), final)


def write_json(path: Path, mapping: Any, final: bool = False) -> None:
    """Write a mapping to `path` atomically, indented, with a final newline."""
    write_text(path, json.dumps(mapping, indent=1, ensure_ascii=False, allow_nan=False) + "\n", final)


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the mapping that a JSON file holds; an empty one where it is not there, or holds none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def read_end(handle: BinaryIO, most: int) -> str:
    """Return so many bytes at the end of a file, as text."""
    handle.seek(max(0, handle.seek(0, os.SEEK_END) - most))
    return handle.read().decode("utf-8", errors="replace")


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def hash_json(value: Any) -> str:
    """Return the SHA-256 of a value's canonical JSON, in hexadecimal."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def link(source: Path, target: Path) -> None:
    """Make `target` the same file as `source` by a hard link, or a copy where links are refused."""
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(target)
    try:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
            temporary.chmod(READ_ONLY)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def link_folder(source: Path, target: Path) -> None:
    """Make `target` a folder of the same files as `source`, those under temporary names left out."""
    temporary = temporary_name(target)
    for path in sorted(source.rglob("*")):
        within = path.relative_to(source)
        if path.is_file() and not any(part.startswith(".") for part in within.parts):
            link(path, temporary / within)
    if temporary.exists():
        temporary.rename(target)


def clear_temporaries(folder: Path) -> None:
    """Remove what a killed process left under temporary names below `folder`."""
    for leftover in folder.rglob(f".*{TEMPORARY_SUFFIX}*"):
        if leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)
