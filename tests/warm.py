"""Commands in processes that need not import everything first: each is forked off one that has.

Such a process runs what a command line runs, from its first line to its exit code. One that is to be killed, limited or
measured, or that finds other code than this, is started in full instead.
"""

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path

PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(
    [
        "tests.warm",
        "matplotlib.pyplot",
        "pyarrow.dataset",
        "statsmodels.api",
        "pipeline.review.listing",
        "pipeline.runner",
    ]
)


def run_warm(line: list[str], environment: dict[str, str], folder: Path, timeout_s: float):
    """Run ``python -m MODULE ...``; return what `subprocess.run` would."""
    with tempfile.TemporaryDirectory() as scratch:
        printed = [f"{scratch}/output", f"{scratch}/errors"]
        process = PROCESSES.Process(target=_run_module, args=(line[2], line[3:], str(folder), environment, printed))
        process.start()
        process.join(timeout_s)
        if process.exitcode is None:
            process.kill()
            raise subprocess.TimeoutExpired(line, timeout_s)
        return subprocess.CompletedProcess(line, process.exitcode, *(Path(each).read_text() for each in printed))


def _run_module(name: str, arguments: list[str], folder: str, environment: dict[str, str], printed: list[str]) -> None:
    for number, path in enumerate(printed, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path.insert(0, folder)
    sys.argv = [name, *arguments]
    try:
        runpy.run_module(name, run_name="__main__", alter_sys=True)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
