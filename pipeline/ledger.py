"""run.json: what ran, from what, with which code and versions, on which machine, how it ended.

A run's facts flow in as they happen; each `save` leaves a whole file. The ledgers of all runs together are the index by
which fresh tables are found again: there is no database beside the folders.
"""

from __future__ import annotations

import marshal
import os
import platform
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NotRequired

from pydantic import TypeAdapter
from pydantic_core import from_json
from typing_extensions import TypedDict

from pipeline.checkout import git_state
from pipeline.command import command_line
from pipeline.files import hash_file, write_json
from pipeline.renames import update_facts

FORMAT = 3
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
    measured: NotRequired[bool]
    parts: NotRequired[str]


class RunFacts(TypedDict):
    """What is relied on of run.json."""

    format: Literal[1, 2, 3]
    status: Literal["running", "done", "failed", "interrupted", "paused", "killed"]
    sequence: int
    identity: str
    command: str
    started: str
    ended: str | None
    error: dict[str, str] | None
    stages: dict[str, StageRecord]


SHAPE = TypeAdapter(RunFacts)
_LOOKED_AT: dict[str, tuple[tuple[int, int, int], dict[str, Any] | None]] = {}
"""Facts of ledgers by path, with time, size and inode of the file that they were read from."""
_SHARED: dict[bytes, Any] = {}
"""What the records of many ledgers have in common, kept once: it is nine tenths of them."""


@dataclass
class Ledger:
    """The record of one run: what run.json in its folder holds.

    `since_s` is when this process began to work on the run, by its own clock; None where it only looks at it.
    """

    folder: Path
    facts: dict[str, Any] = field(default_factory=dict)
    since_s: float | None = None

    @classmethod
    def begin(cls, folder: Path, identity: str, sequence: int, arguments: list[str]) -> Ledger:
        """Start the ledger of a new run; nothing is written yet."""
        facts = {
            "format": FORMAT,
            "status": "running",
            "sequence": sequence,
            "identity": identity,
            "command": command_line(arguments),
            "directory": str(Path.cwd()),
            "started": now(),
            "ended": None,
            "seconds": 0.0,
            "peak_memory_mb": None,
            "error": None,
            "metrics": {},
            "git": git_state(),
            "machine": {
                "host": platform.node(),
                "system": platform.platform(),
                "python": platform.python_version(),
                "executable": sys.executable,
                "processor": platform.machine(),
                "model": _processor_model(),
                "cores": os.cpu_count(),
            },
            "stages": {},
        }
        return cls(folder, facts, time.monotonic())

    @classmethod
    def read(cls, folder: Path) -> Ledger | None:
        """Read a run's ledger, or return None where there is none, or one of another shape or format."""
        try:
            facts = from_json((folder / FILE_NAME).read_bytes())
            SHAPE.validate_python(facts, strict=True)
        except (OSError, ValueError, RecursionError):
            return None
        return cls(folder, facts if facts["format"] == FORMAT else update_facts(facts, FORMAT))

    @classmethod
    def look(cls, folder: Path) -> Ledger | None:
        """Read a run's ledger to look at: of one that did not change since, what was read before."""
        path = str(folder / FILE_NAME)
        try:
            with open(path, "rb") as handle:  # an open file tells what another machine wrote, a path perhaps not yet
                found = os.fstat(handle.fileno())
        except OSError:
            return None
        stamp = (found.st_mtime_ns, found.st_size, found.st_ino)
        if path not in _LOOKED_AT or _LOOKED_AT[path][0] != stamp:
            read = cls.read(folder)
            for record in read.records.values() if read else ():
                _share(record)
            _LOOKED_AT[path] = (stamp, read.facts if read else None)
        facts = _LOOKED_AT[path][1]
        return None if facts is None else cls(folder, facts)

    def save(self) -> None:
        """Write run.json atomically."""
        write_json(self.folder / FILE_NAME, self.facts)

    @property
    def sweep(self) -> str:
        """Name of the sweep that the run is a job of, empty for another run."""
        return self.folder.parent.name if self.folder.parent.parent.name == "sweeps" else ""

    @property
    def name(self) -> str:
        """Name of the run's folder; for a job of a sweep, with the sweep's."""
        return "/".join(filter(None, (self.sweep, self.folder.name)))

    @property
    def status(self) -> str:
        """One of running, done, failed, interrupted, paused, killed."""
        return str(self.facts["status"])

    @property
    def seconds(self) -> float:
        """What the run took, all attempts together; of one that could not note its end, until its last file."""
        spent_s = float(self.facts.get("seconds") or 0.0)
        if self.facts["ended"]:
            return spent_s
        begun_s, seen_s = None, 0.0  # both by the clock of the file system
        for each in self.folder.rglob("*"):
            with suppress(OSError):
                changed_s = each.stat().st_mtime
                seen_s = max(seen_s, changed_s)
                if each.name == "config.yaml" and each.parent == self.folder:
                    begun_s = changed_s
        return spent_s if begun_s is None else round(spent_s + seen_s - begun_s, 3)

    @property
    def age(self) -> tuple[int, str]:
        """Sort key: runs in the order in which they began, whatever the clock did."""
        return int(self.facts["sequence"]), self.name

    @property
    def records(self) -> dict[str, dict[str, Any]]:
        """Record of each stage, by name."""
        return self.facts["stages"]  # type: ignore[no-any-return]

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """The numbers that tell the run, by name; none before its end."""
        return self.facts.get("metrics") or {}

    def finished(self, stage: str) -> dict[str, Any] | None:
        """Return a stage's record if the stage is done in this run."""
        record = self.records.get(stage)
        return record if record and record["status"] == "done" else None

    def end(self, status: str, error: dict[str, str] | None = None) -> None:
        """Note how the run ended, what it took, and save."""
        self.facts.update(status=status, ended=now(), error=error)
        if self.since_s is not None:
            spent_s = float(self.facts.get("seconds", 0.0)) + time.monotonic() - self.since_s
            self.facts.update(seconds=round(spent_s, 3), peak_memory_mb=peak_memory_mb())
            self.since_s = time.monotonic()
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


def _share(record: dict[str, Any]) -> None:
    """Replace what other ledgers' records may have, too, by the same objects."""
    sections = {name: _find_shared(section) for name, section in record["config"].items()}
    record.update({name: _find_shared(record[name]) for name in ("code", "libraries", "inputs")}, config=sections)


def _find_shared(value: Any) -> Any:
    return _SHARED.setdefault(marshal.dumps(value, 2), value)  # which version tells no two equal ones apart


def files_of(record: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return every file that a stage's record names, relative to the run's folder, with size and hash."""
    tables = {f"tables/{name}.parquet": facts for name, facts in record["tables"].items()}
    return {**tables, **record["files"]}


def peak_memory_mb() -> float | None:
    """Return the most memory that this process, or one that it started and that ended, held, MB."""
    try:
        import resource
    except ImportError:
        return None
    return to_mb(max(resource.getrusage(each).ru_maxrss for each in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def to_mb(maxrss: float) -> float:
    """Return in MB what the system says of the largest resident set, which has another unit on another system."""
    return round(maxrss * (1e-6 if sys.platform == "darwin" else 1024e-6), 1)


def _processor_model() -> str | None:
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)
    except OSError:
        return platform.processor() or None


def now() -> str:
    """Return the present time, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
