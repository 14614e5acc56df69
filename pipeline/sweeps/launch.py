"""One launch of a sweep: which jobs it has, where they lie, and what became of each so far.

A launch flows from the process that was typed to its workers, and is a folder beside the jobs' own: what was typed, the
jobs, an outcome for each that ended, and a word that asks the others to stop. A sweep may have had many launches.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pipeline.files import hash_json, read_mapping, write_json, write_text
from pipeline.flat import INCIDENTAL
from pipeline.lease import Lease, name_process
from pipeline.ledger import now

FOLDER = ".launches"
FACTS = "launch.json"
OUTCOMES = "outcomes"
LOCK_NAME = ".lock"
LONGEST_NAME = 140
STRANGE = re.compile(r"[^\w.,=+\[\]()-]")
STOPPED_BY_FAILURE, STOPPED_BY_SIGNAL = "failure", "signal"


@dataclass(frozen=True)
class Outcome:
    """What became of a job in a launch, its exit code, the seconds that it took, and why it is so.

    The word is ``done``, ``kept`` (done in an earlier launch), ``failed``, ``killed``, ``interrupted``, ``paused``,
    ``elsewhere`` (another process has it at work) or ``not begun``.
    """

    word: str
    code: int = 0
    seconds: float = 0.0
    told: str = ""


@dataclass(frozen=True)
class Launch:
    """What every job of a launch has to know.

    The launch is of the `process` that was typed (a name of `pipeline.lease`); its jobs are names in order; `files`
    gave options of config groups; `options` of the command line, such as a folder of configurations, are those that a
    job by itself needs too.
    """

    sweep: Path
    name: str
    process: str
    jobs: tuple[str, ...]
    on_failure: Literal["continue", "stop"]
    on_finished: Literal["keep", "refresh"]
    files: Mapping[str, dict[str, str]]
    options: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Where what is known of the launch lies."""
        return self.sweep / FOLDER / self.name

    @property
    def is_own(self) -> bool:
        """Whether this process is the one that was typed."""
        return self.process == name_process()

    @property
    def lease(self) -> Lease:
        """What the process that was typed holds as long as it lives."""
        return Lease(self.folder / LOCK_NAME)

    def begin(self, command: str, arguments: Sequence[str], overrides: Sequence[Sequence[str]]) -> None:
        """Write down what was typed, and the jobs that came of it."""
        jobs = [{"job": job, "overrides": list(each)} for job, each in zip(self.jobs, overrides, strict=True)]
        facts = {"command": command, "arguments": list(arguments), "started": now(), "jobs": jobs}
        write_json(self.folder / FACTS, facts)

    def note(self, job: str, outcome: Outcome) -> None:
        """Write down what became of a job."""
        write_json(self._outcome_path(job), asdict(outcome))

    def outcome(self, job: str) -> Outcome | None:
        """Return what became of a job in this launch, or None where it has not ended."""
        with suppress(TypeError):
            return Outcome(**read_mapping(self._outcome_path(job)))
        return None

    @property
    def ended(self) -> set[str]:
        """The jobs that ended in this launch."""
        with suppress(OSError):
            return {each.removesuffix(".json") for each in os.listdir(self.folder / OUTCOMES) if each[0] != "."}
        return set()

    def forget(self, job: str) -> None:
        """Let a job be looked at again."""
        self._outcome_path(job).unlink(missing_ok=True)

    def ask_to_stop(self, why: str) -> None:
        """Let no further job begin; where a signal asks for it, end those that run."""
        write_text(self.folder / "stop", why)

    @property
    def stop(self) -> str | None:
        """Why no further job is to begin, or None."""
        with suppress(OSError):
            return (self.folder / "stop").read_text(encoding="utf-8")
        return None

    def _outcome_path(self, job: str) -> Path:
        return self.folder / OUTCOMES / f"{job}.json"


def new_launch_name() -> str:
    """Return a name that no other launch takes, nor a later one of this process; names are in the order of time."""
    return f"{datetime.now(UTC):%Y-%m-%dT%H-%M-%S.%f}_{os.getpid()}"


def list_launches(sweep: Path) -> Iterator[dict[str, Any]]:
    """Yield what was written down of each launch of a sweep, the oldest first."""
    for path in sorted((sweep / FOLDER).glob(f"*/{FACTS}")):
        facts = read_mapping(path)
        jobs = facts.get("jobs")
        if isinstance(jobs, list) and all(isinstance(each, dict) and {"job", "overrides"} <= {*each} for each in jobs):
            yield facts


def is_launched(sweep: Path) -> bool:
    """Return whether a process that launched the sweep lives, on this machine or another."""
    return any(Lease(each).is_held() for each in (sweep / FOLDER).glob(f"*/{LOCK_NAME}"))


def name_job(overrides: Sequence[str]) -> str:
    """Return the name of a job's folder: its overrides by key, but those that say nothing of what it computes.

    Where that is no name for a folder, or too long, it is as near to it as can be, and a hash: of each override as much
    of the end, where its value stands, as all have room for.
    """
    telling = sorted(each for each in overrides if is_meaningful(each))
    plain = ",".join(telling) or "defaults"
    name = STRANGE.sub("_", plain)
    if name == plain and len(name) <= LONGEST_NAME:
        return name
    fits = {room: sum(min(len(each), room) + 1 for each in telling) <= LONGEST_NAME for room in range(1, LONGEST_NAME)}
    room = max((each for each in fits if fits[each]), default=1)
    name = STRANGE.sub("_", ",".join(each[-room:].lstrip(".") for each in telling))
    return f"{name[:LONGEST_NAME]}-{hash_json(plain)[:8]}"


def is_meaningful(override: str) -> bool:
    """Return whether an override says something of what a job computes."""
    key = override.partition("=")[0].lstrip("+~")
    return key.partition(".")[0] not in INCIDENTAL and not key.startswith("hydra")
