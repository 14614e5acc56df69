"""A calibration whose points a person sets, against a device whose channels mean other than is configured."""

import json
import multiprocessing
import os
import re
import signal

import numpy as np
import pandas as pd
import pytest

from pipeline.config import read_study
from pipeline.config_files import read_choices
from pipeline.errors import ConfigError
from pipeline.files import write_json
from stages.science.rig import clock
from stages.science.rig.contract import RigError
from stages.science.rig.festo.known_points import PointRequested
from stages.sensor_calibration.calibration_summary import advise, describe_lines
from tests.composing import compose_values
from tests.conftest import Command
from tests.cpx_e.machine import Channel
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig
from tests.cpx_e.turned import emulate
from tests.studies import PickledContext, run_stage

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")

TRUE = {
    "pam1.force": {"n_per_count": 0.11, "zero_count": 24000.0, "sign": -1},
    "pam1.pressure": {"kpa_per_count": 0.0335, "zero_count": 310.0},
    "pam1.command": {"kpa_per_count": 0.0295, "zero_count": -150.0},
    "SFE.encoder": {"rad_per_count": 6.4e-4, "zero_count": 1234.0, "sign": -1},
}
REFUSED = {
    "pam2.force": "are the same at all points .* pam4.force follows them: are",
    "pam3.force": r"the counts are the same at all points \(512.0 to 512.0\); is the channel dead\?",
    "pam4.force": r"expected points of use at two known values at least, got 0 of 2, as the channel was at its end "
    r"\(count 32100, range -500 to 32000\)",
}


@pytest.fixture
def emulator():
    """A machine whose channels differ from what the configuration says."""
    machine = describe_machine(describe_rig())
    for name, values in TRUE.items():
        find_place(machine, name).update(values)
    with emulate(machine) as emulator:
        yield emulator


class Person:
    """Does what the stage asks for and runs it again, until it no longer asks."""

    def __init__(self, emulator, run, *overrides):
        self.emulator, self.run = emulator, run
        self.study, (self.stage, _) = read_study(compose_values(*list_overrides(emulator), *overrides))
        self.asked, self.told, self.tables, self.hands, self.shown_kpa = [], [], {}, {}, 0.0

    def type(self):
        """Run the stage as the command does; return its exit code."""
        begun_s = self.emulator.state()["now_s"]
        code = self.go_on()
        state = self.emulator.state(log=2000)
        self.shown_kpa = max((kpa[0] for at, kpa in state["log"] if at > begun_s), default=0.0)
        return code

    def go_on(self):
        try:
            self.tables = run_stage(self.study, self.stage, self.run, {}, context=PickledContext)
        except PointRequested as request:
            write_json(self.run / "documents" / "asks.json", request.asks)
            self.told.append(str(request))
            return 3
        return 0

    def obey(self):
        """Do what is asked for now, which takes a second."""
        asks = json.loads((self.run / "documents" / "asks.json").read_text())
        self.asked.append(asks)
        told = re.search(r"echo (\S+),KPA >> ([^\s;]+)", asks["do"])
        if told:
            with open(told[2], "a") as file:
                file.write(f"{told[1]},{self.shown_kpa:.3f}\n")
        self.emulator.ask("mend")
        for channel in asks.get("channels", []):
            owner, _, kind = channel.rpartition(".")
            if kind in ("force", "encoder"):
                other, count = self.hands.get(channel, (channel, None))
                self.load(other, asks["value"], count)
            elif asks["value"] == 0.0:
                self.emulator.fault("overpressure", muscle=owner, kpa=0.0)
        clock.sleep(1.0)

    def load(self, channel, value, count=None):
        """Bring a true value about on a channel of the emulated machine, or a count whatever the value."""
        if count is None:
            count = Channel.model_validate(find_place(self.emulator.machine, channel)).to_count(value)
        self.emulator.fault("sensor", channel=channel, mode="counts", counts=count)

    def carry_out(self):
        """Go on until the run no longer asks; return its exit code."""
        while (code := self.type()) == 3:
            self.obey()
        return code


class PersonAtTheCommand(Person):
    """Types the command again."""

    def __init__(self, emulator, outputs, *overrides):
        super().__init__(emulator, None, *overrides)
        self.command = Command(outputs, *list_overrides(emulator), *overrides)

    def go_on(self):
        result = self.command()
        (self.run,) = self.command.runs
        self.told += result.stderr.splitlines()
        self.tables = {each.stem: pd.read_parquet(each) for each in (self.run / "tables").glob("*.parquet")}
        return result.returncode


def list_overrides(emulator):
    chosen = ("workflow=calibration", "rig=festo_cpx", "rig.device.host=127.0.0.1", "figures=[png]")
    times = ("calibration.record_s=0.3", "calibration.settle_s=0.5", "calibration.ramp_s=0.2")
    return (*chosen, *times, f"rig.device.port={emulator.port}")


def choose(points):
    listed = ", ".join(f"{name}: {values}" for name, values in points.items())
    return f"calibration.points={{{listed}}}", f"calibration.only=[{','.join(points)}]"


def find_place(machine, channel):
    owner, _, kind = channel.rpartition(".")
    return machine["encoders"][owner] if kind == "encoder" else machine["channels"][owner][kind]


def test_a_rig_reads_the_truth_once_it_is_calibrated_and_else_stays_as_configured(emulator, tmp_path):
    points = {
        "pam1.force": [0.0, 100.0, 0.0],
        "pam1.pressure": [0.0, 100.0, 200.0],
        "pam1.command": [100.0, 200.0],
        "SFE.encoder": [0.0, 1.0],
        **{name: [0.0, 100.0] for name in REFUSED},
    }
    chosen = "calibration.plausible_ratio=1.2", "calibration.attempts=1"
    person = Person(emulator, tmp_path, *choose(points), *chosen)
    person.hands = {"pam2.force": ("pam4.force", None)}
    person.hands |= {"pam3.force": ("pam3.force", 512), "pam4.force": ("pam4.force", 32100)}
    assert person.carry_out() == 0
    assert [each["point"] for each in person.asked] == [*range(1, 15)]
    assert len(person.told) == 14
    lines, changes = (person.tables[f"calibration_{each}"].set_index("channel") for each in ("lines", "changes"))
    assert lines["status"].to_dict() == dict.fromkeys(TRUE, "calibrated") | dict.fromkeys(REFUSED, "refused")
    for name, told in REFUSED.items():
        assert re.search(told, lines.loc[name, "told"])
    for name in TRUE:
        true, line = Channel.model_validate(find_place(emulator.machine, name)), lines.loc[name]
        assert line["sign"] * line["per_count"] == pytest.approx(true.per_count, rel=0.005)
        assert line["zero_count"] == pytest.approx(true.zero_count, abs=10.0)
    assert "the sign is -1, configured 1" in lines.loc["pam1.force", "told"]
    assert list(changes.index[changes["plausible"]]) == ["pam1.pressure", "pam1.command"]
    overrides, _ = read_choices([f"rig={tmp_path / 'documents' / 'calibrated.yaml'}"], ["rig"])
    rig = read_study(compose_values(*overrides))[0].build("rig")
    assert rig.exoskeleton.sampling_rate_hz == 100.0
    assert rig.channels["pam2"].force.n_per_count == 0.025  # as configured
    person.load("pam1.force", 80.0)
    person.load("SFE.encoder", 0.6)
    with rig:
        begun_s = emulator.state()["now_s"]
        recording = rig.hold("pam1", 150.0, 0.3, ramp_s=0.2, settle_s=0.4)
        held = [kpa[0] for at, kpa in emulator.state(log=2000)["log"] if at > begun_s]
    pressure, force, angle = rig.map_channels().to_values(recording.counts.mean(axis=0).to_numpy())
    assert max(held) == pytest.approx(150.0, abs=0.1)
    assert pressure[0] == pytest.approx(150.0, abs=0.5)
    assert force[0] == pytest.approx(80.0, abs=0.2)
    assert angle[0] == pytest.approx(0.6, abs=0.002)
    assert emulator.state()["outputs_kpa"] == [0.0] * 4


@pytest.mark.parametrize(
    ("status", "plausible", "found", "advised"),
    [
        (("calibrated", "calibrated"), True, ["2 of 2 channels are calibrated. The point"], ["rig=FOLDER/documents"]),
        (
            ("calibrated", "refused"),
            False,
            ["1 of 2", "Far from what was", "b.force stays"],
            ["rig=", "only=[b.force]"],
        ),
        (("refused", "refused"), False, ["0 of 2 channels", "a.force stays", "b.force stays"], ["only=[a.force,b.f"]),
    ],
)
def test_the_summary_says_which_lines_are_good_which_are_strange_and_what_to_do(status, plausible, found, advised):
    lines = pd.DataFrame({"channel": ["a.force", "b.force"], "status": status, "unit": "N", "points": 4})
    lines = lines.assign(residual_largest=[0.25, 0.5], told="is the channel dead?")
    changes = pd.DataFrame(
        {"channel": lines["channel"], "plausible": plausible, "ratio": 1.1, "at_zero": 2.0, "unit": "N"}
    )
    told = [*describe_lines(lines, changes)]
    assert [words for words, each in zip(found, told, strict=True) if words not in each] == []
    assert ("0.5 N of force (b.force, 4 points)" in told[0]) == (status[1] == "calibrated")
    assert ("1.1 times the value per count" in " ".join(told)) == (status[0] == "calibrated" and not plausible)
    assert [words for words, each in zip(advised, advise(lines), strict=True) if words not in each] == []


def test_pressure_is_there_only_while_its_point_is_recorded(emulator):
    with build_rig(describe_rig(), emulator.port) as rig:
        begun_s, states = emulator.state()["now_s"], []
        emulator.clock.after(0.5, lambda: states.append(emulator.state()))
        recording = rig.hold("pam2", 300.0, 0.3, ramp_s=0.3, settle_s=0.2)
        ended = emulator.state(log=2000)
        with pytest.raises(ValueError, match=r"pam1: expected 0.0 to 250.0 kPa \(rig.limits.MAS-40\), got 260.0"):
            rig.hold("pam1", 260.0, 0.3, ramp_s=0.3, settle_s=0.2)
        with pytest.raises(ValueError, match="no muscle 'pam9'"):
            rig.hold("pam9", 100.0, 0.3, ramp_s=0.3, settle_s=0.2)
    assert recording.command_count == 9600
    assert recording.stopped == ""
    assert states[0]["watchdog_ms"] == 250
    assert ended["watchdog_ms"] == 0
    assert ended["outputs_kpa"][1:] == [0.0] * 3
    way = np.array([kpa for at, kpa in ended["log"] if at > begun_s])
    assert way[:, 1].max() == pytest.approx(300.0)
    assert np.abs(np.diff(way[:, 1])).max() < 60.0
    assert (way[:, 2:] == 0.0).all()
    assert emulator.state(log=0)["watchdog_count"] == 0
    with pytest.raises(RigError, match="is not connected"):
        rig.read_counts(0.1)


def test_a_ceiling_or_a_sensor_at_its_end_lets_the_muscle_down(emulator):
    with build_rig(describe_rig(), emulator.port) as rig:
        emulator.fault("sensor", channel="pam2.pressure", mode="counts", counts=25000, after_s=0.3)
        stopped = rig.hold("pam2", 300.0, 0.3, ramp_s=0.2, settle_s=0.4).stopped
        assert stopped == "pam2.pressure at 781 kPa, ceiling 780.0 kPa"
        emulator.ask("mend")
        emulator.fault("sensor", channel="pam2.pressure", mode="counts", counts=32767)
        recording = rig.hold("pam2", 300.0, 0.3, ramp_s=0.2, settle_s=0.4)
        assert emulator.state()["outputs_kpa"][1] == 0.0
    assert recording.stopped == "pam2.pressure cannot tell the pressure (count 32767)"
    assert recording.counts.empty


def test_a_point_of_no_use_is_asked_for_again_by_the_same_command(emulator, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.runner.try_report", lambda *_: None)
    person = PersonAtTheCommand(emulator, tmp_path, *choose({"pam1.force": [0.0, 100.0]}))
    person.type()
    person.obey()
    emulator.fault("sensor", channel="pam1.force", mode="counts", counts=32767)
    assert person.type() == 3
    told = person.told[-1]
    assert "of no use: the channel told no value (count 32767); point 1 of 2, pam1.force at 0 N: take every" in told
    person.obey()
    assert person.carry_out() == 0
    assert re.search(
        r"calibration paused: recorded pam1.force at 0 N \(24000.0 counts, spread 0.0\); point 2 of 2, pam1.force at "
        r"100 N: hang 100 N on the load cell of pam1 and let it come to rest .* when that is done, type: ",
        person.told[2],
    )
    points = person.tables["calibration_points"]
    assert list(points["attempt"]) == [1, 2, 1]
    assert list(points["problem"].eq("")) == [False, True, True]
    assert list(person.tables["calibration_lines"]["status"]) == ["calibrated"]
    assert [each.name for each in (person.run / "figures").iterdir()] == ["lines_force.png"]
    assert (person.run / "documents" / "calibrated.yaml").exists()


def test_a_run_that_is_killed_goes_on_at_the_point_it_was_recording(emulator, tmp_path):
    chosen = choose({"SFE.encoder": [0.0, 1.0], "pam2.pressure": [0.0, 300.0]})
    person = Person(emulator, tmp_path, *chosen, "calibration.settle_s=2.0")
    for _ in range(4):
        assert person.type() == 3
        person.obey()

    def die_under_pressure():
        return os.kill(os.getpid(), signal.SIGKILL) if emulator.state()["outputs_kpa"][1] > 250.0 else 0.02

    def run_and_die():
        emulator.clock.at(emulator.clock.now_s(), die_under_pressure)
        person.type()

    process = multiprocessing.get_context("fork").Process(target=run_and_die)
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert person.carry_out() == 0
    points = person.tables["calibration_points"]
    assert list(points["channel"]) == ["SFE.encoder"] * 2 + ["pam2.pressure"] * 2
    assert points["problem"].eq("").all()


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("+calibration.points={pam7.force: [0.0]}", "calibration.points: no channel 'pam7.force'; did you mean 'pam"),
        ("calibration.points={pam1.command: [0.0]}", "expected pressures above 0, as a vented regulator is at its end"),
        ("calibration.points={pam1.pressure: [260.0]}", r"pam1.pressure: expected 0.0 to 250.0 kPa, which pam1 may be"),
        ("calibration.only=[pam1.forc]", "calibration.only: no points of 'pam1.forc'; did you mean 'pam1.force'?"),
        ("calibration.attempts=0", "calibration.attempts: input should be greater than 0"),
    ],
)
def test_what_does_not_fit_the_rig_is_refused_before_anything_is_asked(override, told):
    with pytest.raises(ConfigError) as caught:
        read_study(compose_values("workflow=calibration", "rig.device.host=127.0.0.1", override))
    assert told in str(caught.value)
