"""A calibration whose points a person sets, against a device whose channels mean other than is configured."""

import copy
import json
import re

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Command
from tests.cpx_e.emulator import Emulator
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")

TRUE = {
    "pam1.force": {"n_per_count": 0.11, "zero_count": 420.0, "sign": -1},
    "pam1.pressure": {"kpa_per_count": 0.0335, "zero_count": 310.0},
    "pam1.command": {"kpa_per_count": 0.0295, "zero_count": -150.0},
    "SFE.encoder": {"rad_per_count": 6.4e-4, "zero_count": 1234.0, "sign": -1},
}
SHORT = (
    "calibration.record_s=0.3",
    "calibration.settle_s=0.5",
    "calibration.ramp_s=0.2",
    "calibration.plausible_ratio=1.2",
)


@pytest.fixture(scope="module")
def section():
    return describe_rig()


@pytest.fixture(scope="module")
def machine(section):
    """A machine whose channels differ from what the configuration says."""
    told = copy.deepcopy(describe_machine(section))
    for name, values in TRUE.items():
        owner, _, kind = name.rpartition(".")
        place = told["encoders"][owner] if kind == "encoder" else told["channels"][owner][kind]
        place |= values
    return told


@pytest.fixture(scope="module")
def running(machine):
    with Emulator(machine) as emulator:
        yield emulator


@pytest.fixture
def emulator(running):
    running.mend()
    yield running
    running.mend()


class Person:
    """Does what the run asks for, until it is done."""

    def __init__(self, emulator, command):
        self.emulator, self.command = emulator, command
        self.asked = []
        self.reads = True

    def count(self, channel, value):
        owner, _, kind = channel.rpartition(".")
        place = (
            self.emulator.machine["encoders"][owner]
            if kind == "encoder"
            else (self.emulator.machine["channels"][owner][kind])
        )
        (per_count,) = (each for key, each in place.items() if key.endswith("_per_count"))
        return round(place["sign"] * value / per_count + place["zero_count"])

    def set(self, channel, value):
        self.emulator.fault("sensor", channel=channel, mode="counts", counts=self.count(channel, value))

    def read_gauge(self, line):
        label, path, muscle = re.search(r"echo (\S+),KPA >> (\S+)\)", line).groups() + (None,)
        with open(path, "a") as file:
            file.write(f"{label},{self.shown:.3f}\n")

    def obey(self):
        """Do what the run asks for now."""
        (run,) = self.command.runs
        asks = json.loads((run / "documents" / "asks.json").read_text())
        if "echo" in asks["do"]:
            self.read_gauge(asks["do"])
        self.emulator.mend()
        if asks["point"] is None:
            return
        (channel, *_), value = asks["channels"], asks["value"]
        if channel.endswith(("force", "encoder")):
            self.set(channel, value)

    def carry_out(self, *arguments, most=20):
        """Type the command until the run no longer asks."""
        for _ in range(most):
            begun = self.emulator.state()["now_s"]
            result = self.command(*arguments)
            held = [max(kpa) for at, kpa in self.emulator.state(log=2000)["log"] if at > begun]
            self.shown = max(held, default=0.0)
            if result.returncode != 3:
                return result
            assert len(result.stderr.strip().splitlines()) == 1
            self.asked.append(result.stderr)
            self.obey()
        raise AssertionError("asked for ever")


def calibrate(emulator, folder, points, *changed):
    """Carry a calibration out; return the person, the result, points and lines."""
    listed = ", ".join(f"{name}: {values}" for name, values in points.items())
    command = Command(
        folder / "outputs",
        "workflow=calibration",
        "rig=festo_cpx",
        "rig.device.host=127.0.0.1",
        f"rig.device.port={emulator.port}",
        f"calibration.points={{{listed}}}",
        f"calibration.only=[{','.join(points)}]",
        *SHORT,
        *changed,
    )
    person = Person(emulator, command)
    result = person.carry_out()
    assert result.returncode == 0, result.stderr
    (run,) = command.runs
    points, lines = (pd.read_parquet(run / "tables" / f"calibration_{each}.parquet") for each in ("points", "lines"))
    return person, result, points, lines.set_index("channel")


def test_a_rig_reads_the_truth_once_it_is_calibrated(emulator, section, tmp_path):
    points = {
        "pam1.force": [0.0, 100.0, 200.0, 0.0],
        "pam1.pressure": [0.0, 100.0, 200.0],
        "pam1.command": [100.0, 200.0],
        "SFE.encoder": [0.0, 1.0],
    }
    person, result, recorded, lines = calibrate(emulator, tmp_path, points)
    assert set(lines["status"]) == {"calibrated"}
    for name, true in TRUE.items():
        (per_count,) = (value for key, value in true.items() if key.endswith("_per_count"))
        assert lines.loc[name, "per_count"] == pytest.approx(per_count, rel=0.01)
        assert lines.loc[name, "zero_count"] == pytest.approx(true["zero_count"], abs=15.0)
        assert lines.loc[name, "sign"] == true.get("sign", 1)
    print(person.asked, result.stdout, lines.T, recorded)
