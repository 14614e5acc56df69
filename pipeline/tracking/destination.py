"""Where runs are copied to: a tracking section flows in; an address, how to look at it, and what waits for it flow out.

What was not sent yet has a mark in the outputs folder from before a run begins until all of it was sent. A mark holds
the folder, relative to the outputs folder, and where it goes. Runs without tracking have none.
"""

from __future__ import annotations

import importlib.util
import json
import shlex
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.command import python_name
from pipeline.errors import ConfigError
from pipeline.files import hash_json, write_json

if TYPE_CHECKING:
    from pipeline.config import Tracking

FOLDER = "tracking"
"""In the outputs folder: the local store, and marks of what was not sent."""
MARKS = ".not_sent"
SQLITE = "sqlite:///"


@dataclass(frozen=True)
class Destination:
    """An experiment in MLflow, for the runs of an outputs folder."""

    outputs: Path
    uri: str
    experiment: str

    @property
    def database(self) -> Path | None:
        """The file of a local store, None for a server."""
        return Path(self.uri.removeprefix(SQLITE)) if self.uri.startswith(SQLITE) else None

    @property
    def lock(self) -> Path:
        """The file by which one process at a time sends."""
        path = self.database
        return path.with_name(f".{path.name}.lock") if path else self.outputs / FOLDER / ".lock"

    @property
    def is_own(self) -> bool:
        """Whether runs go to the store in their own outputs folder."""
        return self.database == self.outputs.absolute() / FOLDER / "mlflow.db"

    def look(self) -> str:
        """Return how to look at it: a command, or an address."""
        if not self.database:
            return self.uri
        database = self.database.relative_to(Path.cwd()) if self.database.is_relative_to(Path.cwd()) else self.database
        return shlex.join([python_name(), "-m", "mlflow", "server", "--backend-store-uri", f"{SQLITE}{database}"])

    def mark(self, folder: Path) -> None:
        """Note that a run's or sweep's folder is to be sent; a disk that takes no mark is no failure."""
        with suppress(OSError):
            write_json(self._mark_of(folder), self._facts(folder))

    def clear(self, folder: Path) -> None:
        """Note that a folder was sent."""
        with suppress(OSError):
            self._mark_of(folder).unlink(missing_ok=True)

    def list_marked(self) -> Iterator[Path]:
        """Yield the folders that are to be sent here; where one was removed, so is its mark."""
        for path in sorted((self.outputs / FOLDER / MARKS).glob("*.json")):
            try:
                facts = json.loads(path.read_text(encoding="utf-8"))
                folder = self.outputs / facts["folder"]
                is_ours = facts == self._facts(folder)
            except (OSError, ValueError, KeyError, TypeError):
                continue
            if is_ours:
                if folder.is_dir():
                    yield folder
                else:
                    self.clear(folder)

    def _facts(self, folder: Path) -> dict[str, str]:
        within = folder.absolute().relative_to(self.outputs.absolute()).as_posix()
        return {"folder": within, "uri": "" if self.is_own else self.uri, "experiment": self.experiment}

    def _mark_of(self, folder: Path) -> Path:
        return self.outputs / FOLDER / MARKS / f"{hash_json(self._facts(folder))[:20]}.json"


def check_mlflow() -> None:
    """Refuse to go on where nothing can be sent."""
    if importlib.util.find_spec("mlflow") is None:
        raise ConfigError(
            "tracking=mlflow: MLflow is not installed; type: pip install -e '.[tracking]', or leave tracking= out"
        )


def find_destination(outputs: str | Path, tracking: Tracking) -> Destination:
    """Return where runs go."""
    check_mlflow()
    outputs = Path(outputs)
    own = f"{SQLITE}{outputs.absolute() / FOLDER / 'mlflow.db'}"
    return Destination(outputs, tracking.uri or own, tracking.experiment)
