"""What was not sent yet: a mark in the outputs folder from before a run begins until all of it was sent.

A mark holds the folder, relative to the outputs folder, and where it goes. Runs without tracking have none.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pipeline.files import hash_json, write_json
from pipeline.tracking.destination import FOLDER, Destination

MARKS = ".not_sent"


def mark(destination: Destination, folder: Path) -> None:
    """Note that a run's or sweep's folder is to be sent; a disk that takes no mark is no failure."""
    with suppress(OSError):
        write_json(_path(destination, folder), _facts(destination, folder))


def clear(destination: Destination, folder: Path) -> None:
    """Note that a folder was sent."""
    with suppress(OSError):
        _path(destination, folder).unlink(missing_ok=True)


def list_marked(destination: Destination) -> Iterator[Path]:
    """Yield the folders that are to be sent there; where one was removed, so is its mark."""
    for path in sorted((destination.outputs / FOLDER / MARKS).glob("*.json")):
        try:
            facts = json.loads(path.read_text(encoding="utf-8"))
            folder = destination.outputs / facts.pop("folder")
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if facts == destination.facts():
            if folder.is_dir():
                yield folder
            else:
                clear(destination, folder)


def _facts(destination: Destination, folder: Path) -> dict[str, str]:
    within = folder.absolute().relative_to(destination.outputs.absolute())
    return {"folder": within.as_posix(), **destination.facts()}


def _path(destination: Destination, folder: Path) -> Path:
    return destination.outputs / FOLDER / MARKS / f"{hash_json(_facts(destination, folder))[:20]}.json"
