"""The wheel, installed beside the libraries, works from any folder."""

import os
import subprocess
import sys
from zipfile import ZipFile

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return the wheel, and ``run(command, *arguments)``, which runs an installed command in an empty folder."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip"]
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder, ROOT], check=True)
    (wheel,) = folder.glob("pamid-*.whl")
    subprocess.run([*pip, "install", "-q", "--no-deps", "--target", folder / "site", wheel], check=True)
    (folder / "empty").mkdir()

    def run(command, *arguments):
        line = [sys.executable, folder / "site" / "bin" / command, *arguments]
        environment = {**os.environ, "PYTHONPATH": str(folder / "site")}
        return subprocess.run(line, cwd=folder / "empty", env=environment, capture_output=True, text=True)

    return wheel, run


def test_the_wheel_holds_the_configuration_and_no_tests(installed):
    wheel, _ = installed
    names = ZipFile(wheel).namelist()
    assert {"pipeline/conf/config.yaml", "stages/science/operator_ui/pages/operator.js"} <= set(names)
    assert {each.partition("/")[0] for each in names} == {
        "pipeline",
        "stages",
        f"pamid-{wheel.name.split('-')[1]}.dist-info",
    }


def test_the_commands_run_and_look_at_a_study(installed):
    wheel, run = installed
    assert run("pamid", "--version").stdout == f"pamid {wheel.name.split('-')[1]}\n"
    assert "bank" in run("pamid", "plan=true", "rig=festo_cpx", "rig.device.host=127.0.0.1").stdout
    assert "blinded_session" in run("pamid", "plan=true", "experiment=hidden_effect").stdout
    done = run("pamid", "budget=tiny", "figures=[]", "participant=p1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "report: outputs/runs/" in done.stdout
    listed = run("pamid-review", "list")
    assert listed.returncode == 0
    assert "done" in listed.stdout
