"""Ways to break a run, and what an unbroken one looks like."""

import ctypes
import hashlib
import json
import os
import resource
import time

import pyarrow.parquet

from pipeline.files import TEMPORARY_SUFFIX

DROP_FROM_BOUNDING_SET = 24
DAC_OVERRIDE, DAC_READ_SEARCH, FOWNER = 1, 2, 3


def tables_of(run):
    return {path.name: path.read_bytes() for path in sorted((run / "tables").glob("[!.]*.parquet"))}


def ledger_of(run):
    return json.loads((run / "run.json").read_text())


def overwrite(path, content):
    """Damage a finished file, which is read-only."""
    path.chmod(0o644)
    path.write_bytes(content)


def wait_until(process, arrived):
    """Wait for something that a living process is about to do; return what it was."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        found = arrived()
        if found:
            return found
        assert process.poll() is None, process.communicate()
    raise TimeoutError("it did not happen")


def find_parts(command, stage="doubling"):
    return [part for run in command.runs for part in run.glob(f"parts/{stage}-*/[!.]*")]


def find_temporaries(command):
    return [path for run in command.runs for path in run.rglob(f".*{TEMPORARY_SUFFIX}*")]


def check_wholeness(run):
    """Whatever has a final name is whole, and what the ledger calls done is as the ledger says."""
    for path in run.rglob("*.parquet"):
        if TEMPORARY_SUFFIX not in str(path.relative_to(run)):
            pyarrow.parquet.read_table(path)
    for path in run.rglob("*.json"):
        if TEMPORARY_SUFFIX not in path.name:
            json.loads(path.read_text())
    if not (run / "run.json").exists():
        return
    for record in ledger_of(run)["stages"].values():
        for name, facts in record["tables"].items() if record["status"] == "done" else []:
            content = (run / "tables" / f"{name}.parquet").read_bytes()
            assert hashlib.sha256(content).hexdigest() == facts["sha256"]


def limit_file_size(size):
    """Return what makes the system refuse larger files to a process, as a full disk does."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def obey_permissions():
    """Let permission bits bind a process even of root's."""
    if os.geteuid() == 0:
        library = ctypes.CDLL(None, use_errno=True)
        for capability in (DAC_OVERRIDE, DAC_READ_SEARCH, FOWNER):
            if library.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0):
                raise OSError(ctypes.get_errno(), "cannot drop a capability")
