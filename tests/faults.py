"""Ways to break a run, and what an unbroken one looks like."""

import ctypes
import hashlib
import json
import os
import resource
import signal
import time

import pyarrow.parquet

from pipeline.files import TEMPORARY_SUFFIX

DROP_FROM_BOUNDING_SET = 24
CAPABILITY_VERSION, EFFECTIVE, PERMITTED = 0x20080522, 0, 1
OVERRIDING = (1, 2, 3)
"""Capabilities to write, to read and to change what bits of permission forbid."""
STOPPING = {signal.SIGINT: (130, "Ctrl-C"), signal.SIGTERM: (143, "SIGTERM")}
"""Signals by which a run is stopped, with its exit code and what it calls them."""


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
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        found = arrived()
        if found:
            return found
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    process.kill()
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


def slow_down_disk():
    """Have a process wait for the disk so long that what it writes can be seen under its temporary name."""
    sync = os.fsync
    os.fsync = lambda handle: (time.sleep(0.05), sync(handle))


def obey_permissions():
    """Let permission bits bind a process even of root's, and what it executes."""
    if os.geteuid() == 0:
        library = ctypes.CDLL(None, use_errno=True)
        held, sets = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION, 0), (ctypes.c_uint32 * 6)()
        refused = [library.prctl(DROP_FROM_BOUNDING_SET, each, 0, 0, 0) for each in OVERRIDING]
        refused.append(library.capget(held, sets))
        for kind in (EFFECTIVE, PERMITTED):
            sets[kind] &= ~sum(1 << each for each in OVERRIDING)
        if any(refused) or library.capset(held, sets):
            raise OSError(ctypes.get_errno(), "cannot drop a capability")
