"""The real rig against an emulated device on a clock that is turned: trials, and every fault that ends one."""

import contextlib
import re
import signal

import numpy as np
import pandas as pd
import pytest

from pipeline.context import Record
from stages.science.rig import clock
from stages.science.rig.attendance import TrialDeclined
from stages.science.rig.contract import RECORDING_COLUMNS, RigError, TrialStopped, tidy
from stages.science.rig.festo import festo_cpx
from stages.science.rig.festo.supervision import Supervisor
from stages.science.rig.trial import Trial
from tests.cpx_e.rig import build_rig, describe_rig, emulate_rig
from tests.science.rig.watching import Watching, execute, wave

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
from pymodbus.client import ModbusTcpClient

WATCHDOG_S = 0.4
SHORT = "exoskeleton.trial_s=1.2", "rig.lead_in_s=0.4", f"rig.device.watchdog_s={WATCHDOG_S}", "rig.device.reply_s=0.15"
FAULT_S = 0.8
"""When something goes wrong: 0.4 s into the trial."""
LET_DOWN_S = 0.12
"""Time from the notice of a fault to commands of 0, where the link lives: the ramp and two samples."""
RETRIED_S = 0.15 + 0.01
"""Time for which a device that does not answer is tried."""


@pytest.fixture
def device():
    with emulate_rig(*SHORT) as device:
        yield device


@pytest.fixture
def emulator(device):
    return device[0]


@pytest.fixture
def rig(device):
    return device[1]


@pytest.fixture
def change(emulator):
    """Return the rig on the emulated device with changes to sections of it."""

    def change(port=emulator.port, **sections):
        section = describe_rig(*SHORT)
        for name, its in sections.items():
            section[name] = section[name] | its if isinstance(its, dict) else its
        return build_rig(section, port, emulator.control_port)

    return change


def stop(rig, emulator, folder, fault):
    """Execute a trial in which something goes wrong; return the error, what was kept, and the device's state then."""
    record = Record(folder / "parts" / "loop-0", {}, lambda: None)
    emulator.clock.after(FAULT_S, fault)
    with pytest.raises(TrialStopped) as caught:
        record.part((1,), lambda: execute(rig, wave(rig), watch=record.watch((1,))))
    (kept,) = (folder / "interrupted").glob("*")
    rows = pd.read_parquet(kept)
    assert list(rows.columns) == [*RECORDING_COLUMNS, "stopped_by"]
    assert set(rows["stopped_by"]) == {str(caught.value)}
    assert len(rows) > 4 * 70
    assert "find out why before anybody goes on" in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value, rows, emulator.state()


def wait_for_watchdog(emulator):
    clock.sleep(WATCHDOG_S + 0.01)
    return emulator.state()


def test_a_trial_is_recorded_as_commanded(rig, emulator):
    given = wave(rig)
    with rig:
        whole = rig.execute(given, np.random.default_rng(0))
        between = emulator.state()
    recording = whole.without_lead_in()
    np.testing.assert_array_equal(recording.pressure_command_kpa, given.pressure_command_kpa)
    assert set(recording.clipped_by.ravel()) == {""}
    assert set(recording.status.ravel()) == {"ok"}
    assert np.abs(recording.pressure_kpa[10:] - given.pressure_command_kpa[6:-4]).max() < 20.0
    assert (recording.late_s >= 0.0).all()
    assert recording.late_s.max() < 1e-6
    assert np.ptp(recording.joint_angle_rad, axis=0).min() > 0.05
    assert set(tidy(recording, rig)) == set(RECORDING_COLUMNS)
    assert between["outputs_kpa"] == [0.0] * 4
    assert between["watchdog_ms"] == 0
    assert between["watchdog_count"] == 0


def test_an_operators_stop_lets_the_muscles_down_and_the_trial_can_be_repeated(rig, emulator):
    watching, handed = Watching(stop_at_s=0.5), []
    rig.connect_interface(watching)
    with rig:
        with pytest.raises(TrialDeclined, match="to be repeated"):
            rig.execute(wave(rig), np.random.default_rng(0), handed.append)
        state = emulator.state()
        assert state["outputs_kpa"] == [0.0] * 4
        assert 0.08 < state["vented_at_s"] - watching.starts_at_s - 0.5 <= LET_DOWN_S
        assert state["watchdog_count"] == 0
        assert rig.connected
        measured = pd.concat([pd.DataFrame(rows) for rows in handed])
        assert measured["time_s"].max() > 0.5
        assert "ramp" in set(measured["status"])
        watching.stop_at_s = np.inf
        recording = rig.execute(wave(rig), np.random.default_rng(0))
    assert len(recording.without_lead_in().time_s) == rig.samples


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_lets_the_muscles_down_first(rig, emulator, number):
    heard = []
    before = signal.signal(number, lambda *_: heard.append(emulator.state()))
    try:
        emulator.clock.after(FAULT_S, lambda: signal.raise_signal(number))
        with pytest.raises(TrialStopped, match=r"0.4\d s into the trial: (Ctrl-C|SIGTERM); the muscles were let down"):
            execute(rig, wave(rig))
    finally:
        signal.signal(number, before)
    (state,) = heard
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - emulator.begun_s - FAULT_S <= LET_DOWN_S


@pytest.mark.parametrize(
    ("where", "told"),
    [
        ("in a write", "watchdog"),
        ("between a read and a write", "watchdog"),
        ("before a turn", r"the loop came 64\d ms late \(half the watchdog's time is borne\)"),
    ],
)
def test_what_the_watchdog_vented_while_we_slept_is_not_filled_again(rig, emulator, monkeypatch, where, told):
    written, slept = [], []
    send, look, pace = ModbusTcpClient.write_registers, Supervisor.look, festo_cpx.pace

    def sleep_once(place):
        if place == where and len(written) > 80 and not slept:
            clock.sleep(1.6 * WATCHDOG_S)
            slept.append(len(written))

    def write(client, address, values, **more):
        if address in range(40003, 40040):
            written.append(list(values))
        answer = send(client, address, values, **more)
        sleep_once("in a write")
        return answer

    def look_late(supervisor, *given):
        sleep_once("between a read and a write")
        return look(supervisor, *given)

    def pace_sleepily(count, period_s):
        for tick in pace(count, period_s):
            sleep_once("before a turn")
            yield tick

    monkeypatch.setattr(ModbusTcpClient, "write_registers", write)
    monkeypatch.setattr(Supervisor, "look", look_late)
    monkeypatch.setattr(festo_cpx, "pace", pace_sleepily)
    with pytest.raises(TrialStopped, match=told):
        execute(rig, wave(rig))
    state = emulator.state()
    assert any(any(values) for values in written[: slept[0]])
    assert written[slept[0] :]  # it is told to vent all the same
    assert not any(any(values) for values in written[slept[0] :])
    assert state["watchdog_count"] == 1
    assert max(max(outputs) for at_s, outputs in state["log"] if at_s >= state["watchdog_fired_at_s"]) == 0.0


def test_somebody_who_drives_the_device_too_is_noticed(rig, emulator):
    def meddle():
        with contextlib.closing(ModbusTcpClient("127.0.0.1", port=emulator.port)) as other:
            assert other.connect()
            other.write_registers(46100, [0])

    emulator.clock.after(FAULT_S, meddle)
    with pytest.raises(TrialStopped, match="somebody else drives the device too: its watchdog was set to"):
        execute(rig, wave(rig))


def test_a_dead_load_cell_is_told_and_one_that_fails_for_a_moment_is_borne_and_marked(rig, emulator, caplog):
    emulator.fault("sensor", channel="pam1.force", mode="counts", counts=0)
    emulator.fault("sensor", channel="pam2.force", mode="counts", counts=32767, after_s=FAULT_S, for_s=0.015)
    with caplog.at_level("WARNING", logger="pamid"):
        recording = execute(rig, wave(rig))
    (told,) = caplog.messages
    assert "pam1.force was 0 N throughout, at up to 1" in told
    assert "its load cell is not connected" in told
    failed = recording.status[:, 1] == "invalid"
    assert 1 <= failed.sum() <= 2
    assert (recording.force_n[failed, 1] < 700.0).all()
    assert "invalid" not in recording.status[:, [0, 2, 3]]


def test_a_reference_beyond_the_limits_is_refused_before_anything_moves(rig, emulator):
    reference = np.full((rig.samples, 2), 0.5)
    reference[70:, 1] = 1.5
    given = Trial("tracked", "p1", np.full((rig.samples, 4), 50.0), reference, label="p1 trial 3")
    before = emulator.state()["log"][-1:]
    told = r"p1 trial 3 asks for joint EFE at 1.5 rad, permitted -0.25 to 1.45, at 0.70 s"
    with pytest.raises(ValueError, match=told):
        execute(rig, given)
    assert emulator.state()["log"][-1:] == before


@pytest.mark.parametrize("fault", ["cut", "silent", "refuse", "killed"])
def test_a_device_that_cannot_be_told_to_vent_is_left_to_its_watchdog(rig, emulator, tmp_path, fault):
    """One that refuses outputs answers, so that whatever it is asked keeps its watchdog from acting."""
    error, _, _ = stop(rig, emulator, tmp_path, emulator.kill if fault == "killed" else lambda: emulator.fault(fault))
    assert "does not answer" in str(error)
    assert "the muscles could not be let down (" in str(error)
    assert "): the watchdog does, 0.4 s after the last request" in str(error)
    if fault != "killed":
        state = wait_for_watchdog(emulator)
        assert state["watchdog_count"] == 1
        assert 0.0 <= state["watchdog_fired_at_s"] - state["last_request_at_s"] - WATCHDOG_S <= 0.005
        assert state["watchdog_fired_at_s"] - error.noticed_at_s <= 0.1 + RETRIED_S + 0.01 + WATCHDOG_S
        assert state["outputs_kpa"] == [0.0] * 4


def sensor(channel, mode, counts=None):
    return {"name": "sensor", "channel": channel, "mode": mode, "counts": counts}


FOLLOWS = r"pam2 at -?\d+ kPa while \d+ kPa are commanded, for 0.5 s \(rig.guard.follow_kpa"
QUICK = r"EFE at [\d.]+ rad(/s, limit 8.0 rad/s|, limits)"
FAULTS = [
    *(
        ({"name": "garbage", "variant": each}, "", "does not answer")
        for each in ("random", "length", "transaction", "function")
    ),
    ({"name": "cut", "for_s": 0.02}, "", "does not answer.*the muscles were let down"),
    ({"name": "slow", "delay_s": 0.09}, "", "it answers slowly"),
    ({"name": "overpressure", "muscle": "pam2", "kpa": 0.0}, "over", FOLLOWS),
    ({"name": "overpressure", "muscle": "pam1", "kpa": 400.0}, "over", r"pam1 at \d+ kPa, ceiling 300.0 kPa"),
    ({"name": "overspeed", "joint": "EFE", "rad_per_s": 20.0}, "over", QUICK),
    (sensor("pam1.pressure", "frozen"), "frozen", r"pam1.pressure has not changed for 0.3\d s"),
    (sensor("pam3.force", "frozen"), "frozen", r"pam3.force has not changed for 0.3\d s"),
    (sensor("SFE.encoder", "frozen"), "frozen", "SFE.encoder has not changed for 0.5"),
    (sensor("pam2.pressure", "counts", -32768), "invalid", "pam2.pressure tells no value"),
    (sensor("pam4.force", "counts", 32000), "saturated", "pam4.force is at its end"),
    (sensor("pam1.force", "counts", -900), "saturated", "pam1.force is at its end"),
    (sensor("pam1.pressure", "counts", 15000), "over", "pam1 at 469 kPa, ceiling 300.0 kPa"),
    (sensor("pam3.force", "counts", 30000), "over", "pam3 at 3000 N, ceiling 2500.0 N"),
]
LONGER_S = {"garbage": 0.15, "slow": 0.1}
"""By how much longer it takes where the device is asked anew: for a connection and an answer."""


@pytest.mark.parametrize(("fault", "status", "message"), FAULTS, ids=range(len(FAULTS)))
def test_a_failing_device_machine_or_sensor_ends_the_trial(change, emulator, tmp_path, fault, status, message):
    rig = change(guard={"frozen_encoder_s": 0.5})
    error, rows, state = stop(rig, emulator, tmp_path, lambda: emulator.fault(**fault))
    assert re.search(message, str(error))
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - error.noticed_at_s <= LET_DOWN_S + LONGER_S.get(fault["name"], 0.0)
    if status:
        owner = fault.get("channel", "").partition(".")[0]
        its = rows[rows["muscle"] == {"SFE": "pam1"}.get(owner, owner)] if owner else rows
        assert status in set(its["status"])
        assert state["vented_at_s"] - error.noticed_at_s > 0.08
        ramp = rows[rows["clipped_by"] == "ramp"].query("time_s > 0")
        assert ramp.groupby("muscle")["pressure_command_kpa"].apply(lambda each: each.is_monotonic_decreasing).all()


def test_a_device_that_is_frozen_vents_on_thawing(rig, emulator, tmp_path):
    def freeze():
        emulator.freeze()
        emulator.clock.after(0.3, lambda: emulator.freeze(False))

    error, _, state = stop(rig, emulator, tmp_path, freeze)
    assert "does not answer" in str(error)
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["watchdog_count"] >= 1 or state["vented_at_s"] is not None


def test_muscles_that_stay_up_are_told(change, emulator, tmp_path):
    """The device confirms commands that it does not carry out; until pressures are low, its watchdog is armed."""
    states = []
    for after_s in np.arange(FAULT_S, 3.0, 0.05):
        emulator.clock.after(after_s, lambda: states.append(emulator.state(log=0)))
    error, _, _ = stop(change(guard={"vented_within_s": 0.4}), emulator, tmp_path, lambda: emulator.fault("deaf"))
    assert re.search(r"pam\d at \d+ kPa 0.4 s after all were commanded 0: close the air", str(error))
    waiting = [each["watchdog_ms"] for each in states if 0.12 < each["now_s"] - error.noticed_at_s < 0.48]
    assert waiting == [1000 * WATCHDOG_S] * 7


def test_the_device_is_taken_by_one_process_alone(rig, change):
    with rig, pytest.raises(RigError, match=r"is driven by another process .*n_jobs=1"):
        change().connect()
    with change() as other:
        assert other.connected


def test_other_modules_and_nobody_there_are_told(change):
    with pytest.raises(RigError, match=r"expected the 6 modules that 127.0.0.1:.* tells of, got 7"):
        change(device={"modules": ["EP", "4AO", "4AI", "4AI", "1CI", "1CI", "1CI"]}).connect()
    with pytest.raises(RigError, match=r"expected a CPX-E that answers Modbus .*check its power"):
        change(port=1).connect()


def test_the_range_of_every_analogue_channel_is_set_where_it_is_stated(emulator, change):
    with change(device={"signal_range": "B_10V"}):
        pass
    numbers = [4828 + 64 * module + each for module in (1, 2, 3) for each in ((11, 12) if module == 1 else (13, 14))]
    assert emulator.emulation.device.parameters == dict.fromkeys(numbers, 0x22)  # of two channels each


def test_a_command_after_missed_samples_is_no_larger_a_step(change, monkeypatch):
    pace = festo_cpx.pace

    def pace_sleepily(count, period_s):
        for tick in pace(count, period_s):
            if tick.index in (40, 230):
                clock.sleep(0.055)
            yield tick

    limits = {name: its | {"slew_kpa_per_s": 800.0} for name, its in describe_rig()["limits"].items()}
    rig, watching = change(limits=limits, lead_in_s=2.0), Watching()
    rig.connect_interface(watching)
    monkeypatch.setattr(festo_cpx, "pace", pace_sleepily)
    command = np.full((rig.samples, 4), 100.0)
    command[20:, 1] = 500.0
    recording = execute(rig, Trial("passive", "nobody", command))
    assert (recording.status[30:40, 1] == "missed").sum() == 4
    steps = np.abs(np.diff(recording.pressure_command_kpa[:, 1]))
    assert steps.max() == pytest.approx(8.0)
    assert set(recording.clipped_by[40:60, 1]) == {"rate"}
    filling = np.diff([each.command_kpa for each in watching.moments if each.time_s < 0.0], axis=0)
    assert len(filling) == 200 - 1 - 4
    assert filling.max() == pytest.approx(100.0 / 160.0)
