"""Why runs did not get to their end, and what to type so that they do: ledgers, logs and launches flow in, text out."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from pipeline.files import read_end
from pipeline.ledger import Ledger
from pipeline.sweeps.launch import list_launches

MOST_LISTED = 20
END_OF_LOG = 400_000
"""Bytes at the end of a log that are looked at."""
ATTEMPT = re.compile(r"^\S+ \S+ INFO (?:begun|resumed): ", re.MULTILINE)
LINE = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", re.MULTILINE)
POINTER = re.compile(r" \(traceback: .*log\.txt\)$")
REASONS = {
    "unreadable": "run.json cannot be read, or is of another version",
    "no ledger": "there is no run.json in its folder",
    "killed": "its process ended without a word; no reason was noted",
}


def describe_reason(ledger: Ledger | None, status: str) -> str:
    """Return in one line why a run is not done."""
    if ledger and (error := ledger.facts["error"]):
        message = POINTER.sub("", " ".join(str(error.get("message", "-")).split()))
        return f"{error.get('stage', '-')}: {message}"
    return REASONS.get(status, "no reason was noted")


def list_reasons(sweep: Path, statuses: Mapping[str, str]) -> Iterator[str]:
    """Yield in lines why jobs of a sweep are not done, of many the first; their names and statuses flow in."""
    for job, status in list(statuses.items())[:MOST_LISTED]:
        yield f"  {job} {status}: {describe_reason(Ledger.look(sweep / job), status)}"
    if len(statuses) > MOST_LISTED:
        yield f"  ... and {len(statuses) - MOST_LISTED} more"


def read_traceback(folder: Path) -> str:
    """Return the last traceback of a run's last attempt from its log; empty where there is none."""
    try:
        with (folder / "log.txt").open("rb") as handle:
            log = read_end(handle, END_OF_LOG)
    except OSError:
        return ""
    log = ATTEMPT.split(log)[-1]
    _, mark, rest = log.rpartition("\nTraceback (most recent call last):")
    if not mark:
        return ""
    end = LINE.search(rest)
    return (mark + rest[: end.start() if end else None]).strip()


def list_commands(sweep: Path, unfinished: Iterable[str]) -> list[tuple[str, int]]:
    """Return what to type to finish a sweep, with how many of the unfinished jobs each command finishes."""
    left = set(unfinished)
    commands: Counter[str] = Counter()
    for launch in reversed(list(list_launches(sweep))):
        if of_it := left & {str(job["job"]) for job in launch["jobs"]}:
            commands[str(launch.get("command", "-"))] += len(of_it)
            left -= of_it
    for job in sorted(left):
        if ledger := Ledger.look(sweep / job):
            commands[str(ledger.facts["command"])] = 1
    return list(commands.items())
