"""What a person waits for before anything is done, against a bare Hydra application with the same configuration."""

import subprocess
import sys

import pytest

from tests.conftest import ROOT, Command

BARE = """
import hydra

@hydra.main(version_base="1.3", config_path={conf!r}, config_name="config")
def application(config):
    pass

application()
"""


@pytest.fixture
def bare(tmp_path):
    """Return the command line of the bare application."""
    script = tmp_path / "bare.py"
    script.write_text(BARE.format(conf=str(ROOT / "conf")))
    return [sys.executable, str(script)]


def run(line):
    subprocess.run(line, cwd=ROOT, check=True, capture_output=True)


def test_help(bare, against, tell):
    ours = [sys.executable, "-m", "pipeline", "--help"]
    tell("--help / bare Hydra's", against(lambda: run(ours), lambda: run([*bare, "--help"]), 10, 2))


def test_run_where_all_is_fresh(bare, tmp_path, against, tell):
    command = Command(tmp_path / "outputs", "budget=tiny")
    first = command()
    assert first.returncode == 0, first.stderr
    assert "everything is fresh" in command().stdout
    quiet = [*bare, "hydra.run.dir=.", "hydra.output_subdir=null"]
    tell("run where all is fresh / bare Hydra's", against(lambda: run(command.line()), lambda: run(quiet), 10, 2))
