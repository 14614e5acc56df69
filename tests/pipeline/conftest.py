"""The command with toy workflows, and runs that are made once for all tests, to be looked at or copied."""

import shutil
from unittest.mock import patch

import pytest

from tests.conftest import Command
from tests.faults import find_parts, tables_of, wait_until

CONFIG = ("--config-dir", "tests/pipeline/conf")
TOY = (*CONFIG, "workflow=toy", "figures=[]")
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
    def kill(folder):
        toy = Toy(folder / "outputs")
        process = toy.start(SLOWLY)
        wait_until(process, lambda: len(find_parts(toy)) >= 2)
        process.kill()
        process.communicate()

    return Toy(make_once("killed toy", kill) / "outputs")


@pytest.fixture
def killed(killed_toy, tmp_path):
    """The command with the toy workflow and a run of it, `SLOWLY`, that was killed after two parts or more."""
    return killed_toy.copy(tmp_path / "outputs")
