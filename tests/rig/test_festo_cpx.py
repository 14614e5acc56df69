"""The real rig against an emulated device in another process: trials, and every fault that ends one."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pandas as pd
import pytest

from pipeline.context import Record
from stages.rig import festo_cpx
from stages.rig.attendance import TrialDeclined
from stages.rig.contract import RECORDING_COLUMNS, RigError, Trial, TrialStopped, tidy
from stages.rig.desk import Desk, DeskSettings
from stages.rig.supervision import Supervisor
from tests.cpx_e.emulator import ROOT, Emulator
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
from pymodbus.client import ModbusTcpClient

pytestmark = pytest.mark.realtime

WATCHDOG_S = 0.4
"""Longer than by default, as tests run beside each other; a stall of half of it ends a trial."""
SHORT = (
    "exoskeleton.trial_s=1.6",
    "rig.lead_in_s=1.0",
    f"rig.device.watchdog_s={WATCHDOG_S}",
    "rig.guard.missed_share=1.0",
    "rig.device.reply_s=0.15",
)
LET_DOWN_S = 0.2
"""Time from the notice of a fault to commands of 0, where the link lives."""
LATE_S = 0.1
"""How much later than its time a watchdog may vent."""


@pytest.fixture(scope="module")
def section():
    return describe_rig(*SHORT)


@pytest.fixture(scope="module")
def running(section):
    with Emulator(describe_machine(section)) as emulator:
        yield emulator


@pytest.fixture
def emulator(running):
    running.mend()
    yield running
    running.mend()
    running.end()


@pytest.fixture
def rig(emulator, section):
    return build_rig(section, emulator.port, emulator.control_port)


def trial(rig, kind="free", level=120.0):
    who = {"free": "experimenter", "passive": "nobody"}[kind]
    wave = 1.0 + 0.4 * np.sin(np.linspace(0.0, 6.0, rig.samples))[:, None]
    return Trial(kind, who, level * wave * [1.0, 2.0, 1.0, 2.0], label=f"{kind} 1")


def stop(rig, emulator, folder, fault, kind="free"):
    """Execute a trial in which something goes wrong; return the error, what was kept, and the device's state."""
    record = Record(folder / "parts" / "loop-0", {}, lambda: None)

    def make():
        with rig:
            timer = threading.Timer(1.8, fault)
            timer.start()
            try:
                rig.execute(trial(rig, kind), np.random.default_rng(0), record.watch((1,)))
            finally:
                timer.join()
        raise AssertionError("the trial was not stopped")

    with pytest.raises(TrialStopped) as caught:
        record.part((1,), make)
    (kept,) = (folder / "interrupted").glob("*")
    rows = pd.read_parquet(kept)
    assert list(rows.columns) == [*RECORDING_COLUMNS, "stopped_by"]
    assert set(rows["stopped_by"]) == {str(caught.value)}
    assert len(rows) > 4 * 60
    assert "find out why before anybody goes on" in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value, rows, emulator.state()


def assert_commanded_down(error, state):
    """The device was told to vent in time, and not by its watchdog alone."""
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - error.noticed_at_s <= LET_DOWN_S


def test_a_trial_is_recorded_as_commanded(rig, emulator):
    given = trial(rig)
    with rig:
        recording = rig.execute(given, np.random.default_rng(0))
        between = emulator.state()
    taken = ((recording.status == "ok") & (recording.clipped_by == "")).all(axis=1)
    assert taken.sum() > 20
    assert set(recording.clipped_by[recording.status == "ok"]) <= {"", "rate"}  # after a sample that was missed
    np.testing.assert_array_equal(recording.pressure_command_kpa[taken], given.pressure_command_kpa[taken])
    assert np.abs(recording.pressure_kpa[40:] - given.pressure_command_kpa[36:-4]).max() < 40.0
    assert set(recording.status.ravel()) <= {"ok", "missed", "late"}
    assert (recording.late_s >= 0.0).all()
    assert np.ptp(recording.joint_angle_rad, axis=0).min() > 0.05
    assert set(tidy(recording, rig)) == set(RECORDING_COLUMNS)
    assert between["outputs_kpa"] == [0.0] * 4
    assert between["watchdog_ms"] == 0
    assert between["watchdog_count"] == 0


def test_an_operators_stop_lets_the_muscles_down_and_the_trial_can_be_repeated(rig, emulator):
    desk = Desk(DeskSettings(countdown_s=0.0, result_s=0.0, lost_after_s=1.0, needed=[]))
    rig.be_attended(desk)
    stops, words = [], iter(["accept", "repeat", "accept", "keep"])

    def attend():
        word = next(words)
        while word:
            scene = desk.see()
            if word in scene["choices"]:
                desk.decide(word, "", scene["question"])
                word = next(words, None)
            elif not stops and desk.moment is not None and desk.moment.time_s > 0.5:
                stops.append(time.monotonic())
                desk.stop("the operator stopped it")
            time.sleep(0.002)

    operator = threading.Thread(target=attend, daemon=True)
    operator.start()
    handed = []
    with rig:
        with pytest.raises(TrialDeclined, match="to be repeated"):
            rig.execute(trial(rig), np.random.default_rng(0), handed.append)
        state = emulator.state()
        assert state["outputs_kpa"] == [0.0] * 4
        assert state["vented_at_s"] - stops[0] <= LET_DOWN_S
        assert state["watchdog_count"] == 0
        assert rig.connected
        measured = pd.concat([pd.DataFrame(rows) for rows in handed])
        assert measured["time_s"].max() > 0.5
        assert "ramp" in set(measured["status"])
        recording = rig.execute(trial(rig), np.random.default_rng(0))
    operator.join(timeout=5)
    assert len(recording.time_s) == rig.samples
    assert not operator.is_alive()


@pytest.mark.parametrize("where", ["in a write", "between a read and a write"])
def test_what_the_watchdog_vented_while_we_slept_is_not_filled_again(rig, emulator, monkeypatch, where):
    written, slept, before = [], [], emulator.state()["watchdog_count"]
    send, look = ModbusTcpClient.write_registers, Supervisor.look

    def sleep_once(calls):
        if len(written) > calls and not slept:
            time.sleep(1.6 * rig.device.watchdog_s)
            slept.append(len(written))

    def spy(client, address, values, **more):
        if address in range(40003, 40040):
            written.append(list(values))
        answer = send(client, address, values, **more)
        if where == "in a write":
            sleep_once(180)
        return answer

    def look_late(supervisor, *given):
        if where != "in a write":
            sleep_once(180)
        return look(supervisor, *given)

    monkeypatch.setattr(ModbusTcpClient, "write_registers", spy)
    monkeypatch.setattr(Supervisor, "look", look_late)
    with rig, pytest.raises(TrialStopped, match="watchdog"):
        rig.execute(trial(rig), np.random.default_rng(0))
    assert any(any(values) for values in written[: slept[0]])
    assert not any(any(values) for values in written[slept[0] :])
    assert emulator.state()["watchdog_count"] == before + 1


def test_somebody_who_drives_the_device_too_is_noticed(rig, emulator):
    def meddle():
        with contextlib.closing(ModbusTcpClient("127.0.0.1", port=emulator.port)) as other:
            assert other.connect()
            other.write_registers(46100, [0])

    with rig:
        meddling = threading.Timer(1.2, meddle)
        meddling.start()
        with pytest.raises(TrialStopped, match="somebody else drives the device too: its watchdog was set to"):
            rig.execute(trial(rig), np.random.default_rng(0))
        meddling.join()


def test_a_load_cell_that_tells_nothing_is_told(rig, emulator, caplog):
    emulator.fault("sensor", channel="pam1.force", mode="counts", counts=0)
    with rig, caplog.at_level("WARNING", logger="pamid"):
        rig.execute(trial(rig), np.random.default_rng(0))
    (told,) = caplog.messages
    assert "pam1.force was 0 N throughout, at up to 1" in told
    assert "its load cell is not connected" in told


def test_a_command_beyond_the_limits_is_clipped_and_recorded_as_such(rig):
    command = np.full((rig.samples, 4), 100.0)
    command[80:, 0], command[120:, 3] = 400.0, 900.0
    with rig:
        recording = rig.execute(Trial("passive", "nobody", command), np.random.default_rng(0))
    assert recording.pressure_command_kpa[:, 0].max() == 250.0
    assert recording.pressure_command_kpa[:, 3].max() == 700.0
    assert "rate" in recording.clipped_by[80:90, 0]
    assert set(recording.clipped_by[100:, 0]) == {"pressure"}
    assert set(recording.clipped_by[:80].ravel()) == {""}


def test_a_reference_beyond_the_limits_is_refused_before_anything_moves(rig, emulator):
    reference = np.full((rig.samples, 2), 0.5)
    reference[70:, 1] = 1.5
    given = Trial("tracked", "p1", np.full((rig.samples, 4), 50.0), reference, label="p1 trial 3")
    before = emulator.state()["log"][-1:]
    told = r"p1 trial 3 asks for joint EFE at 1.5 rad, permitted -0.25 to 1.45, at 0.70 s"
    with rig, pytest.raises(ValueError, match=told):
        rig.execute(given, np.random.default_rng(0))
    assert emulator.state()["log"][-1:] == before


def test_a_cut_link_is_told_and_the_watchdog_vents(rig, emulator, tmp_path):
    error, _, _ = stop(rig, emulator, tmp_path, lambda: emulator.fault("cut"))
    time.sleep(WATCHDOG_S + LATE_S)
    state = emulator.state()
    assert "does not answer" in str(error)
    assert "the muscles could not be let down (" in str(error)
    assert "): the watchdog does, 0.4 s after the last request" in str(error)
    assert state["watchdog_fired_at_s"] - state["last_request_at_s"] <= WATCHDOG_S + LATE_S
    assert state["outputs_kpa"] == [0.0] * 4


def test_a_link_that_is_cut_and_comes_back_is_used_to_let_the_muscles_down(rig, emulator, tmp_path):
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("cut", for_s=0.02))
    assert "does not answer" in str(error)
    assert "the muscles were let down" in str(error)
    assert_commanded_down(error, state)


def test_a_device_that_is_frozen_vents_on_thawing(rig, emulator, tmp_path):
    def freeze():
        emulator.freeze()
        time.sleep(0.3)
        emulator.thaw()

    error, _, state = stop(rig, emulator, tmp_path, freeze)
    assert "does not answer" in str(error)
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["watchdog_count"] >= 1 or state["vented_at_s"] is not None


def test_a_device_that_is_killed_is_told(section, tmp_path):
    with Emulator(describe_machine(section)) as emulator:
        rig = build_rig(section, emulator.port, emulator.control_port)
        record = Record(tmp_path / "parts" / "loop-0", {}, lambda: None)
        timer = threading.Timer(1.8, emulator.kill)
        timer.start()
        with pytest.raises(TrialStopped, match="does not answer") as caught, rig:
            record.part((1,), lambda: rig.execute(trial(rig), np.random.default_rng(0), record.watch((1,))))
        timer.join()
    assert "the watchdog does" in str(caught.value)
    assert list((tmp_path / "interrupted").glob("*.parquet"))


@pytest.mark.parametrize("variant", ["random", "length", "transaction", "function"])
def test_garbage_is_told_and_the_muscles_are_let_down(rig, emulator, tmp_path, variant):
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("garbage", variant=variant))
    assert "does not answer" in str(error)
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - error.noticed_at_s <= LET_DOWN_S + 0.15


@pytest.mark.parametrize(
    ("fault", "status", "message"),
    [
        ({"channel": "pam1.pressure", "mode": "frozen"}, "frozen", r"pam1.pressure has not changed for 0.3\d s"),
        ({"channel": "pam3.force", "mode": "frozen"}, "frozen", r"pam3.force has not changed for 0.3\d s"),
        ({"channel": "pam2.pressure", "mode": "counts", "counts": -32768}, "invalid", "pam2.pressure tells no value"),
        ({"channel": "pam4.force", "mode": "counts", "counts": 32000}, "saturated", "pam4.force is at its end"),
        ({"channel": "pam1.force", "mode": "counts", "counts": -900}, "saturated", "pam1.force is at its end"),
        ({"channel": "pam1.pressure", "mode": "counts", "counts": 15000}, "over", "pam1 at 469 kPa, ceiling 300.0 kPa"),
        ({"channel": "pam3.force", "mode": "counts", "counts": 30000}, "over", "pam3 at 3000 N, ceiling 2500.0 N"),
    ],
)
def test_a_failing_sensor_ends_the_trial(rig, emulator, tmp_path, fault, status, message):
    error, rows, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("sensor", **fault))
    assert_commanded_down(error, state)
    assert status in set(rows.loc[rows["muscle"] == fault["channel"][:4], "status"])
    assert re.search(message, str(error))
    ramp = rows[rows["clipped_by"] == "ramp"].query("time_s > 0")
    assert ramp.groupby("muscle")["pressure_command_kpa"].apply(lambda each: each.is_monotonic_decreasing).all()


def test_a_frozen_encoder_ends_a_trial_with_a_person(emulator, section, tmp_path):
    longer = section | {
        "exoskeleton": section["exoskeleton"] | {"trial_s": 4.0},
        "guard": section["guard"] | {"frozen_encoder_s": 0.5},
    }
    rig = build_rig(longer, emulator.port, emulator.control_port)
    fault = {"channel": "SFE.encoder", "mode": "frozen"}
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("sensor", **fault))
    assert "SFE.encoder has not changed for 0.5" in str(error)
    assert_commanded_down(error, state)


def test_a_device_that_refuses_outputs_is_left_to_its_watchdog(rig, emulator, tmp_path):
    """It answers, so whatever it is asked keeps its watchdog from acting: it is asked for nothing more."""
    before = emulator.state(log=0)["watchdog_count"]
    error, _, _ = stop(rig, emulator, tmp_path, lambda: emulator.fault("refuse", after_s=0.0))
    assert "could not be let down" in str(error)
    time.sleep(WATCHDOG_S + LATE_S)
    state = emulator.state()
    assert state["watchdog_count"] == before + 1
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["watchdog_fired_at_s"] - error.noticed_at_s <= LET_DOWN_S + 0.15 + WATCHDOG_S + LATE_S


def test_muscles_that_stay_up_are_told(emulator, section, tmp_path):
    """The device confirms commands that it does not carry out."""
    hasty = section | {"guard": section["guard"] | {"vented_within_s": 0.4}}
    rig = build_rig(hasty, emulator.port, emulator.control_port)
    error, _, _ = stop(rig, emulator, tmp_path, lambda: emulator.fault("deaf"))
    assert re.search(r"pam\d at \d+ kPa 0.4 s after all were commanded 0: close the air", str(error))


def test_a_pressure_that_does_not_follow_ends_the_trial(rig, emulator, tmp_path):
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("overpressure", muscle="pam2", kpa=0.0))
    assert re.search(r"pam2 at -?\d+ kPa while \d+ kPa are commanded, for 0.5 s \(rig.guard.follow_kpa", str(error))
    assert_commanded_down(error, state)


def test_answers_that_take_too_long_together_end_the_trial(rig, emulator, tmp_path):
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("slow", delay_s=0.09))
    assert "it answers slowly" in str(error)
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - error.noticed_at_s <= LET_DOWN_S + 0.1  # a connection and an answer of 90 ms


def test_overpressure_ends_the_trial(rig, emulator, tmp_path):
    error, rows, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("overpressure", muscle="pam1", kpa=400.0))
    assert "ceiling 300.0 kPa" in str(error)
    assert "over" in set(rows["status"])
    assert_commanded_down(error, state)


def test_overspeed_ends_the_trial(rig, emulator, tmp_path):
    error, _, state = stop(rig, emulator, tmp_path, lambda: emulator.fault("overspeed", joint="EFE", rad_per_s=20.0))
    assert "EFE at" in str(error)
    assert "limit" in str(error)
    assert_commanded_down(error, state)


def test_a_sensor_that_fails_for_a_moment_is_borne_and_marked(rig, emulator):
    emulator.fault("sensor", channel="pam2.force", mode="counts", counts=32767, after_s=1.8, for_s=0.015)
    with rig:
        recording = rig.execute(trial(rig), np.random.default_rng(0))
    failed = recording.status[:, 1] == "invalid"
    assert 1 <= failed.sum() <= 3
    assert (recording.force_n[failed, 1] < 700.0).all()
    assert "invalid" not in recording.status[:, [0, 2, 3]]


RUN = (
    "bank.trajectories=3",
    "subsampling.initial_trials=1",
    "active_loop.trials=1",
    "stages=[bank]",
    "rig=festo_cpx",
    "rig._target_=tests.cpx_e.rig.ToldFestoCpx",
    "rig.device.host=127.0.0.1",
    *SHORT,
)


def run(emulator, outputs):
    ports = f"rig.device.port={emulator.port}", f"+rig.control_port={emulator.control_port}"
    command = [sys.executable, "-m", "pipeline", *RUN, *ports, f"outputs={outputs}"]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for_pressure(emulator, process, after_s):
    begun = time.monotonic()
    since = None
    while since is None or time.monotonic() - since < after_s:
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() - begun < 60.0
        if since is None and max(emulator.state(log=0)["outputs_kpa"]) > 5.0:
            since = time.monotonic()
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "word", "code"), [(signal.SIGINT, "Ctrl-C", 130), (signal.SIGTERM, "SIGTERM", 143)])
def test_a_signal_lets_the_muscles_down_and_keeps_what_was_measured(emulator, tmp_path, number, word, code):
    process = run(emulator, tmp_path)
    wait_for_pressure(emulator, process, 1.0)
    sent = time.monotonic()
    os.kill(process.pid, number)
    told, _ = process.communicate(timeout=30.0)
    state = emulator.state()
    assert process.returncode == code
    assert f"bank interrupted: stopped by {word}; what was measured until then: " in told
    assert "to continue, type:" in told
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - sent <= LET_DOWN_S + 0.05
    (kept,) = tmp_path.glob("runs/*/interrupted/*.parquet")
    assert len(pd.read_parquet(kept)) > 200


def test_kill_9_has_the_watchdog_vent_and_leaves_what_was_measured(emulator, tmp_path):
    process = run(emulator, tmp_path)
    wait_for_pressure(emulator, process, 1.0)
    before = emulator.state(log=0)["watchdog_count"]
    process.kill()
    process.wait()
    process.stdout.close()
    time.sleep(WATCHDOG_S + 0.4)
    state = emulator.state()
    assert state["watchdog_count"] == before + 1
    assert state["outputs_kpa"] == [0.0] * 4
    assert WATCHDOG_S - 0.05 <= state["watchdog_fired_at_s"] - state["last_request_at_s"] <= WATCHDOG_S + LATE_S
    again = run(emulator, tmp_path)
    told, _ = again.communicate(timeout=60.0)
    assert again.returncode == 0, told
    kept = [*tmp_path.glob("runs/*/interrupted/*.parquet")]
    assert len(kept) == 1
    rows = pd.read_parquet(kept[0])
    assert set(rows["stopped_by"]) == {"the process ended"}
    assert len(rows) > 200


def test_the_device_is_taken_by_one_process_alone(rig, emulator, section):
    with rig, pytest.raises(RigError, match=r"is driven by another process .*n_jobs=1"):
        build_rig(section, emulator.port).connect()
    with build_rig(section, emulator.port) as other:
        assert other.connected


def test_other_modules_and_nobody_there_are_told(emulator, section):
    fewer = section | {"device": section["device"] | {"modules": ["EP", "4AO", "4AI", "4AI", "1CI", "1CI", "1CI"]}}
    with pytest.raises(RigError, match=r"expected the 6 modules that 127.0.0.1:.* tells of, got 7"):
        build_rig(fewer, emulator.port).connect()
    with pytest.raises(RigError, match=r"expected a CPX-E that answers Modbus .*check its power"):
        build_rig(section, 1).connect()


def sleep_once(at, for_s, pace=festo_cpx.pace):
    """A loop that sleeps before one of its turns."""

    def pace_sleepily(count, period_s):
        for tick in pace(count, period_s):
            if tick.index == at:
                time.sleep(for_s)
            yield tick

    return pace_sleepily


def test_a_command_after_missed_samples_is_no_larger_a_step(emulator, section, monkeypatch):
    limits = {name: its | {"slew_kpa_per_s": 800.0} for name, its in section["limits"].items()}
    rig = build_rig(section | {"limits": limits, "lead_in_s": 2.0}, emulator.port, emulator.control_port)
    monkeypatch.setattr(festo_cpx, "pace", sleep_once(230, 0.055))
    command = np.full((rig.samples, 4), 100.0)
    command[20:, 1] = 500.0
    with rig:
        recording = rig.execute(Trial("passive", "nobody", command), np.random.default_rng(0))
    assert (recording.status[30:40, 1] == "missed").any()
    steps = np.abs(np.diff(recording.pressure_command_kpa[:, 1]))
    assert steps.max() == pytest.approx(8.0)
    assert set(recording.clipped_by[40:60, 1]) == {"rate"}


def test_muscles_that_the_watchdog_vented_are_not_filled_anew_on_the_way_down(rig, emulator, monkeypatch):
    """As when the computer slept for longer than the watchdog's time."""
    monkeypatch.setattr(festo_cpx, "pace", sleep_once(160, 0.7))
    before = emulator.state(log=0)["watchdog_count"]
    with pytest.raises(TrialStopped, match=r"the loop came \d+ ms late"), rig:
        rig.execute(trial(rig), np.random.default_rng(0))
    state = emulator.state()
    assert state["watchdog_count"] == before + 1
    later = [outputs for at_s, outputs in state["log"] if at_s >= state["watchdog_fired_at_s"]]
    assert np.max(later) == 0.0
