"""Where runs are copied to: a tracking section flows in; an address, and how to look at it, flow out."""

from __future__ import annotations

import importlib.util
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.command import python_name
from pipeline.errors import ConfigError

if TYPE_CHECKING:
    from pipeline.config import Tracking

FOLDER = "tracking"
"""In the outputs folder: the local store, and marks of what was not sent."""
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

    def facts(self) -> dict[str, str]:
        """Return what tells this destination from others of the same runs."""
        return {"uri": "" if self.is_own else self.uri, "experiment": self.experiment}

    def look(self) -> str:
        """Return how to look at it: a command, or an address."""
        if not self.database:
            return self.uri
        database = self.database.relative_to(Path.cwd()) if self.database.is_relative_to(Path.cwd()) else self.database
        return shlex.join([python_name(), "-m", "mlflow", "server", "--backend-store-uri", f"{SQLITE}{database}"])


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
