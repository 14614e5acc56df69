"""The command with toy workflows, and runs that are made once for all tests, to be looked at or copied."""

import shutil
import subprocess
import time
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

import pytest

from tests.conftest import Command
from tests.faults import find_parts, tables_of, wait_until

CONFIG = ("--config-dir", "tests/pipeline/conf")
TOY = (*CONFIG, "workflow=toy", "figures=[]", "workers=1")
SLOWLY = "doubling.pause_s=0.15"
ALONE = ("-m", "hydra.launcher.n_jobs=1")
"""A sweep whose jobs follow each other, begun by the command's own process."""


class Toy(Command):
    """The command with the toy workflow, which pauses only where it is started and not waited for."""

    def __init__(self, outputs, *fixed):
        super().__init__(outputs, *(fixed or TOY))

    def _run(self, *line, **how):
        with patch.dict(self.environment, TOY_UNDISTURBED="yes"):
            return super()._run(*line, **how)


def end(process, timeout=60):
    """Return what a started command printed until it ended."""
    output, errors = process.communicate(timeout=timeout)
    return CompletedProcess(process.args, process.returncode, output, errors)


def kill(process):
    """Kill a started command; return what it had printed."""
    process.kill()
    return end(process)


def the_only_line(result, code=2):
    """Return what a command that failed said, in one line."""
    assert result.returncode == code, result.stderr
    (line,) = result.stderr.strip().splitlines()
    return line


def success(command, *arguments, **how):
    """Return what a command that ends well printed."""
    result = command(*arguments, **how)
    assert result.returncode == 0, result.stderr
    return result.stdout


def refusal(command, *arguments, **how):
    """Return the line by which a command refuses before anything is written."""
    line = the_only_line(command(*arguments, **how))
    assert not command.outputs.exists()
    return line


def command_of(process_id):
    """Return the command line of a process, empty where it has ended."""
    try:
        return Path(f"/proc/{process_id}/cmdline").read_text()
    except OSError:
        return ""


def children_of(process_id):
    """Return the command line of each process that a living one started."""
    found = subprocess.run(["pgrep", "-P", str(process_id)], capture_output=True, text=True).stdout.split()
    return {each: command_of(each) for each in map(int, found)}


def wait_for_the_end_of(processes, within_s=20):
    deadline = time.monotonic() + within_s
    while any(command_of(each) == line for each, line in processes.items()):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture
def toy(tmp_path):
    """The command with the toy workflow."""
    return Toy(tmp_path / "outputs")


@pytest.fixture
def own_package(tmp_path):
    """A copy of the toy's package, ``workflow.package=copied_toy``, for commands whose path has the folder it is in."""
    return shutil.copytree("tests/pipeline/toy", tmp_path / "copied_toy", ignore=shutil.ignore_patterns("__pycache__"))


@pytest.fixture(scope="session")
def finished_toy(make_once):
    """The same with a finished run, made once for all and not to be changed."""

    def run(folder):
        result = Toy(folder / "outputs")("figures=[png]")
        assert result.returncode == 0, result.stderr

    return Toy(make_once("toy", run) / "outputs")


@pytest.fixture(scope="session")
def reference(finished_toy):
    """The tables of a run that nothing happened to."""
    return tables_of(finished_toy.runs[0])


@pytest.fixture
def done(finished_toy, tmp_path):
    """The command with the toy workflow and a finished run."""
    return finished_toy.copy(tmp_path / "outputs")


@pytest.fixture(scope="session")
def killed_toy(make_once):
    def break_off(folder):
        toy = Toy(folder / "outputs")
        process = toy.start(SLOWLY)
        wait_until(process, lambda: len(find_parts(toy)) >= 2)
        kill(process)

    return Toy(make_once("killed toy", break_off) / "outputs")


@pytest.fixture
def killed(killed_toy, tmp_path):
    """The command with the toy workflow and a run of it, `SLOWLY`, that was killed after two parts or more."""
    return killed_toy.copy(tmp_path / "outputs")
