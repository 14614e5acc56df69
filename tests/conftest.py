"""Fixtures shared by all tests."""

import gc
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported, whose threads wait for each other busily

import numpy as np
import pytest
from filelock import FileLock
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hypothesis import HealthCheck, settings

from tests.composed_once import composing_once
from tests.stalls import RealTime, StallWatch
from tests.turned import turned  # noqa: F401 (a fixture)
from tests.within import load_once, run_within, start_forked

ROOT = Path(__file__).resolve().parent.parent
TINY = ("budget=tiny", "figures=[png,pdf]")
"""The main job's smallest study, of `shared_run`."""
SEQUENTIALLY = {"hydra/launcher=basic", "hydra.launcher.n_jobs=1"}
"""Ways to have the jobs of a sweep begun by the command's own process."""


settings.register_profile("busy machines", suppress_health_check=[HealthCheck.too_slow])  # a pause proves nothing
settings.load_profile("busy machines")


def pytest_configure(config):
    config.pluginmanager.register(RealTime(StallWatch()))


def pytest_collection_finish(session):
    """Let collections of garbage pass over what was imported."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _files_of_the_configuration_are_parsed_and_composed_once():
    with patch.object(FileConfigSource, "load_config", load_once), composing_once():
        yield


@pytest.fixture(scope="session", autouse=True)
def _garbage_is_collected_when_python_finds_it_due():
    """Keep statsmodels from asking for it at every family of p-values."""
    with patch.object(gc, "collect", return_value=0):
        yield


@pytest.fixture
def generator():
    """A seeded generator."""
    return np.random.default_rng(20260701)


@pytest.fixture(scope="session")
def make_once(tmp_path_factory):
    """Return ``make_once(name, maker)``, by which one of all workers makes something that all look at.

    ``maker(folder)`` fills a new folder of that name, which is returned, to be read or copied and never changed. It
    may be slow: the other workers wait for it. If it raises, nothing stays, and the next one that asks makes it anew.
    """
    folder = tmp_path_factory.getbasetemp()
    shared = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "made-once"
    shared.mkdir(exist_ok=True)

    def make(name, maker):
        place, made = shared / name, shared / f"{name}.made"
        with FileLock(shared / f"{name}.lock"):
            if not made.exists():
                shutil.rmtree(place, ignore_errors=True)
                place.mkdir()
                maker(place)
                made.touch()
        return place

    return make


class Command:
    """`python -m pipeline` as a person types it, with its outputs in a folder of the test.

    It runs in this process where that makes no difference, else or `apart` in one that is forked off, which calls
    `before` first. Where it is to be started `anew`, it is started in full.
    """

    def __init__(self, outputs: Path, *fixed: str):
        self.outputs = outputs
        self.fixed = fixed
        self.environment = {**os.environ, "COLUMNS": "200"}
        self.root = ROOT
        self.anew = False

    @property
    def runs(self) -> list[Path]:
        """The run folders, oldest first."""
        folder = self.outputs / "runs"
        return sorted(folder.iterdir()) if folder.is_dir() else []

    def line(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "pipeline", *self.fixed, f"outputs={self.outputs}", *arguments]

    def review_line(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "pipeline.review", "--outputs", str(self.outputs), *arguments]

    def start(self, *arguments: str, before=None, anew: bool = False) -> subprocess.Popen[str]:
        """Start the command in a process of its own."""
        return self._start(self.line(*arguments), before, anew)

    def __call__(self, *arguments: str, before=None, apart: bool | None = None) -> subprocess.CompletedProcess[str]:
        return self._run(self.line(*arguments), before, apart)

    def retype(self, line: str) -> subprocess.CompletedProcess[str]:
        """Run a command as it was printed."""
        return self._run(shlex.split(line))

    def review(self, *arguments: str, before=None) -> subprocess.CompletedProcess[str]:
        return self._run(self.review_line(*arguments), before)

    def copy(self, folder: Path, ignore=None) -> "Command":
        """Return the same command with a copy of its outputs, which have the same files in common."""
        made = type(self)(folder, *self.fixed)
        copies: dict[int, str] = {}

        def copy(source: str, target: str) -> None:
            number = os.stat(source).st_ino
            os.link(copies[number], target) if number in copies else shutil.copy2(source, target)
            copies.setdefault(number, target)

        shutil.copytree(self.outputs, folder, ignore=ignore, copy_function=copy)
        return made

    def _run(self, line: list[str], before=None, apart: bool | None = None) -> subprocess.CompletedProcess[str]:
        if apart is None:
            spreads = {"-m", "--multirun"} & {*line[3:]} and not SEQUENTIALLY & {*line}
            adds_code = self.environment.get("PYTHONPATH") != os.environ.get("PYTHONPATH")
            apart = bool(spreads or adds_code or before or self.anew)
        if not apart:
            return run_within(line, self.environment, self.root)
        with self._start(line, before) as process:
            try:
                output, errors = process.communicate(timeout=300)
            finally:
                process.kill()
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)

    def _start(self, line: list[str], before=None, anew: bool = False) -> subprocess.Popen[str]:
        if not anew and not self.anew:
            return start_forked(line, self.environment, self.root, before)
        pipe = subprocess.PIPE
        return subprocess.Popen(
            line, cwd=self.root, env=self.environment, stdout=pipe, stderr=pipe, text=True, preexec_fn=before
        )


@pytest.fixture
def pamid(tmp_path):
    """The command with the project's own configuration."""
    return Command(tmp_path / "outputs")


@pytest.fixture(scope="session")
def shared_run(make_once):
    """The command with one finished run of the main job, tiny, made once for all; copy it to change anything.

    What it printed lies in `printed.txt` beside its outputs.
    """

    def run(folder):
        result = Command(folder / "outputs", *TINY)()
        assert (result.returncode, result.stderr) == (0, "")
        (folder / "printed.txt").write_text(result.stdout)

    return Command(make_once("main run", run) / "outputs", *TINY)
