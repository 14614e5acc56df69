"""run.json: what ran, from what, with which code and versions, on which machine, how it ended.

A run's facts flow in as they happen; each `save` leaves a whole file. The ledgers of all runs together are the index by
which fresh tables are found again: there is no database beside the folders.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter
from typing_extensions import TypedDict

from pipeline.command import command_line
from pipeline.files import hash_file, write_json

FORMAT = 1
FILE_NAME = "run.json"


class FileFacts(TypedDict):
    """A file as it was when its stage was done; further facts may stand beside."""

    sha256: str
    bytes: int


class StageRecord(TypedDict):
    """What is relied on of a stage's record."""

    status: Literal["running", "done", "failed", "interrupted", "paused"]
    fingerprint: str
    origin: str
    reason: str
    config: dict[str, Any]
    inputs: dict[str, str]
    code: dict[str, str]
    libraries: dict[str, str]
    tables: dict[str, FileFacts]
    files: dict[str, FileFacts]


class RunFacts(TypedDict):
    """What is relied on of run.json."""

    format: Literal[1]
    status: Literal["running", "done", "failed", "interrupted", "paused"]
    sequence: int
    identity: str
    command: str
    started: str
    ended: str | None
    error: dict[str, str] | None
    stages: dict[str, StageRecord]


SHAPE = TypeAdapter(RunFacts)


@dataclass
class Ledger:
    """The record of one run.

    Parameters
    ----------
    folder : Path
        The run's folder.
    facts : dict
        What run.json holds.
    """

    folder: Path
    facts: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def begin(cls, folder: Path, identity: str, sequence: int, arguments: list[str]) -> Ledger:
        """Start the ledger of a new run; nothing is written yet."""
        facts = {
            "format": FORMAT,
            "status": "running",
            "sequence": sequence,
            "identity": identity,
            "command": command_line(arguments),
            "started": now(),
            "ended": None,
            "error": None,
            "git": git_state(),
            "machine": machine(),
            "stages": {},
        }
        return cls(folder, facts)

    @classmethod
    def read(cls, folder: Path) -> Ledger | None:
        """Read a run's ledger, or return None where there is none, or one of another shape or format."""
        try:
            facts = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
            SHAPE.validate_python(facts, strict=True)
        except (OSError, ValueError, RecursionError):
            return None
        return cls(folder, facts)

    def save(self) -> None:
        """Write run.json atomically."""
        write_json(self.folder / FILE_NAME, self.facts)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return self.folder.name

    @property
    def status(self) -> str:
        """One of running, done, failed, interrupted, paused."""
        return str(self.facts["status"])

    @property
    def age(self) -> tuple[int, str]:
        """Sort key: runs in the order in which they began, whatever the clock did."""
        return int(self.facts["sequence"]), self.name

    @property
    def records(self) -> dict[str, dict[str, Any]]:
        """Record of each stage, by name."""
        return self.facts["stages"]  # type: ignore[no-any-return]

    def finished(self, stage: str) -> dict[str, Any] | None:
        """Return a stage's record if the stage is done in this run."""
        record = self.records.get(stage)
        return record if record and record["status"] == "done" else None

    def end(self, status: str, error: dict[str, str] | None = None) -> None:
        """Note how the run ended and save."""
        self.facts.update(status=status, ended=now(), error=error)
        self.save()

    def damage(self, record: dict[str, Any]) -> str | None:
        """Return which of a stage's files is no longer what the ledger says, or None if all are."""
        for file, facts in files_of(record).items():
            path = self.folder / file
            try:
                if not path.is_file():
                    return f"{file} of run {self.name} is missing"
                if path.stat().st_size != facts["bytes"] or hash_file(path) != facts["sha256"]:
                    return f"{file} of run {self.name} is damaged"
            except OSError as error:
                return f"{file} of run {self.name} cannot be read ({error.strerror})"
        return None


def files_of(record: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return every file that a stage's record names, relative to the run's folder, with size and hash."""
    tables = {f"tables/{name}.parquet": facts for name, facts in record["tables"].items()}
    return {**tables, **record["files"]}


def now() -> str:
    """Return the present time, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def machine() -> dict[str, Any]:
    """Return what is worth knowing of the machine that runs this."""
    return {
        "host": platform.node(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "executable": sys.executable,
        "processor": platform.machine(),
        "cores": os.cpu_count(),
    }


@cache
def git_state() -> dict[str, Any] | None:
    """Return commit and cleanliness of the checkout that this code lies in, or None outside of one."""
    root = Path(__file__).resolve().parent.parent
    try:
        commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, timeout=10)
        status = subprocess.run(["git", "status", "--porcelain"], cwd=root, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    if commit.returncode:
        return None
    return {"commit": commit.stdout.strip(), "clean": not status.stdout.strip()}
