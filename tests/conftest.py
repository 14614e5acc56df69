"""Fixtures shared by all tests."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.stalls import RealTime, StallWatch
from tests.warm import run_warm

ROOT = Path(__file__).resolve().parent.parent


def pytest_configure(config):
    config.pluginmanager.register(RealTime(StallWatch()))


def pytest_collection_finish(session):
    """Let collections of garbage pass over what was imported: statsmodels asks for one at every family of p-values."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def generator():
    """A seeded generator."""
    return np.random.default_rng(20260701)


class Command:
    """`python -m pipeline` as a person types it, with its outputs in a folder of the test."""

    def __init__(self, outputs: Path, *fixed: str):
        self.outputs = outputs
        self.fixed = fixed
        self.environment = {**os.environ, "COLUMNS": "200"}
        self.root = ROOT
        self.warm = True

    @property
    def runs(self) -> list[Path]:
        """The run folders, oldest first."""
        folder = self.outputs / "runs"
        return sorted(folder.iterdir()) if folder.is_dir() else []

    @property
    def can_be_warm(self) -> bool:
        """Whether the command need not be started in full: no time of it counts, and this code is what it finds."""
        return self.warm and self.root == ROOT and self.environment.get("PYTHONPATH") == os.environ.get("PYTHONPATH")

    def line(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "pipeline", *self.fixed, f"outputs={self.outputs}", *arguments]

    def start(self, *arguments: str, before=None) -> subprocess.Popen:
        """Start the command; `before` is called in the new process first."""
        return subprocess.Popen(
            self.line(*arguments),
            cwd=self.root,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=before,
        )

    def __call__(self, *arguments: str, before=None) -> subprocess.CompletedProcess:
        if before is None and self.can_be_warm and not {"-m", "--multirun"} & {*self.fixed, *arguments}:
            return run_warm(self.line(*arguments), self.environment, ROOT, 300)
        process = self.start(*arguments, before=before)
        try:
            output, errors = process.communicate(timeout=300)
        finally:
            process.kill()
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)

    def review(self, *arguments: str, before=None) -> subprocess.CompletedProcess:
        line = [sys.executable, "-m", "pipeline.review", "--outputs", str(self.outputs), *arguments]
        if before is None and self.can_be_warm:
            return run_warm(line, self.environment, ROOT, 60)
        return subprocess.run(
            line, cwd=self.root, env=self.environment, capture_output=True, text=True, timeout=60, preexec_fn=before
        )


@pytest.fixture
def pamid(tmp_path):
    """The command with the project's own configuration."""
    return Command(tmp_path / "outputs")


@pytest.fixture
def toy(tmp_path):
    """The command with the toy workflow."""
    return Command(tmp_path / "outputs", "--config-dir", "tests/pipeline/conf", "workflow=toy")
