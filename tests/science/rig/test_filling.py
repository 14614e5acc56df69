"""Every trial begins by filling the muscles over most of the lead-in, on every rig that has one."""

import numpy as np
import pytest

from stages.science.plant.interaction import interact
from stages.science.rig import sim
from stages.science.rig.attendance import TrialDeclined
from stages.science.rig.filling import fill
from stages.science.rig.sim import SimulatedRig
from stages.science.rig.trial import Trial
from tests.cpx_e.rig import emulate_rig
from tests.science.plant.machines import configured
from tests.science.rig.watching import Watching, execute, execute_whole

FIRST = np.array([240.0, 600.0, 0.0, 430.0])
"""First commands, with large ones on both joints."""
RATE_HZ, LEAD_S, SHARE = 100.0, 1.0, 0.8
PROFILE = FIRST * np.minimum(np.arange(100) / 80, 1.0)[:, None]
STEEPEST = np.diff(PROFILE, axis=0, prepend=0.0).max(axis=0)
LET_DOWN_S = 0.12
"""The 0.1 s in which muscles are let down, and two samples."""


def trial(rig, first=FIRST, who="nobody"):
    reference = np.full((rig.samples, 2), 0.6) if who == "p1" else None
    command = np.repeat(first[None], rig.samples, axis=0)
    return Trial("passive" if who == "nobody" else "tracked", who, command, reference)


def simulate(**changed):
    values = configured().model_dump()
    values["exoskeleton"] |= {"sampling_rate_hz": RATE_HZ, "trial_s": 1.6}
    return SimulatedRig.model_validate(values | changed)


def attend(rig, given, watching):
    rig.connect_interface(watching)
    return execute_whole(rig, given)


@pytest.fixture
def emulator():
    with emulate_rig("exoskeleton.trial_s=1.2") as (emulator, rig):
        emulator.rig = rig
        yield emulator


@pytest.mark.parametrize(("samples", "share"), [(100, 0.8), (60, 0.5), (37, 1.0), (1, 0.8)])
def test_the_profile_rises_evenly_and_then_rests(samples, share):
    filling = fill(FIRST, samples, share)
    rising = round(share * samples)
    assert filling.shape == (samples, 4)
    assert not filling[0].any()
    steps = np.diff(filling, axis=0, append=FIRST[None])
    np.testing.assert_allclose(steps[:rising], FIRST / rising + np.zeros((rising, 1)))
    np.testing.assert_allclose(steps[rising:], 0.0)


def test_no_lead_in_begins_filled():
    assert fill(FIRST, 0, SHARE).shape == (0, 4)
    rig = simulate(lead_in_s=0.0)
    pressure = execute(rig, trial(rig)).pressure_kpa
    np.testing.assert_allclose(pressure, FIRST + 0 * pressure, atol=2.5)


@pytest.mark.parametrize("pointed", [False, True])
def test_a_simulated_rig_fills_over_most_of_the_lead_in(turned, pointed):
    rig = simulate(realtime=True, pointer="p1" if pointed else None)
    watching = Watching(points_at=np.array([0.6, 0.6]))
    whole = attend(rig, trial(rig, who="p1"), watching)
    recording = whole.without_lead_in()
    time_s, command, pressure = watching.collect()
    before = time_s < 0.0
    np.testing.assert_allclose(whole.pressure_command_kpa[:100], PROFILE)
    assert set(whole.clipped_by[:100].ravel()) == {"ramp"}
    np.testing.assert_allclose(command[before], PROFILE[np.round(100 * (time_s[before] + LEAD_S)).astype(int)])
    rates = np.diff(pressure, axis=0) / np.diff(time_s)[:, None]
    assert (rates <= 1.02 * STEEPEST * RATE_HZ + 10 * 0.4 * RATE_HZ).all()
    np.testing.assert_allclose(recording.pressure_kpa[0], FIRST, atol=4.0)
    np.testing.assert_allclose(recording.pressure_command_kpa[0], FIRST)


def test_the_simulated_person_holds_the_first_posture_while_the_muscles_are_filled(monkeypatch):
    seen = []

    def spy(*given):
        seen.append((given[2], interact(*given)))
        return seen[-1][1]

    monkeypatch.setattr(sim, "interact", spy)
    rig = simulate()
    execute(rig, trial(rig, who="p1"))
    ((command, motion),) = seen
    np.testing.assert_allclose(command[:100], PROFILE)
    assert np.abs(motion.joint_angle_rad[:100] - motion.joint_angle_rad[0]).max() < 0.2
    assert not motion.pressure_kpa[0].any()
    assert (np.diff(motion.pressure_kpa[:100], axis=0) <= 1.001 * STEEPEST).all()


def test_the_emulated_device_is_filled_over_most_of_the_lead_in_on_both_joints(emulator):
    rig, watching = emulator.rig, Watching()
    whole = attend(rig, trial(rig), watching)
    recording = whole.without_lead_in()
    log = emulator.state(log=2000)["log"]
    at_s, outputs = np.array([at for at, _ in log]), np.array([kpa for _, kpa in log])
    lead = outputs.any(axis=1) & (at_s < watching.starts_at_s)
    sample = np.round(RATE_HZ * (at_s[lead] - watching.starts_at_s + LEAD_S)).astype(int)
    count_kpa = 0.03125
    np.testing.assert_allclose(outputs[lead], PROFILE[sample], atol=0.51 * count_kpa)
    assert (np.diff(outputs[lead], axis=0) <= STEEPEST + 1.01 * count_kpa).all()
    assert sample.max() >= SHARE * LEAD_S * RATE_HZ - 2
    time_s, _, pressure = watching.collect()
    for m in (0, 1, 3):  # on both joints
        risen = pressure[time_s < 0.0, m] / FIRST[m]
        np.testing.assert_allclose(whole.pressure_kpa[:100, m], pressure[time_s < 0.0, m])
        assert ((risen > 0.05) & (risen < 0.95)).sum() > 0.85 * SHARE * LEAD_S * RATE_HZ
        assert (risen[90:] > 0.98).all()
    np.testing.assert_allclose(recording.pressure_kpa[:10].mean(axis=0), FIRST, atol=3.0)


@pytest.mark.parametrize("stop_at_s", [-0.7, -0.3, 0.2])
def test_a_stop_lets_the_muscles_down_as_fast_while_they_are_filled(emulator, stop_at_s):
    watching = Watching(stop_at_s)
    with pytest.raises(TrialDeclined, match="enough; the muscles were let down") as caught:
        attend(emulator.rig, trial(emulator.rig), watching)
    assert ("while the muscles were being filled" in str(caught.value)) == (stop_at_s < 0.0)
    state = emulator.state()
    assert state["outputs_kpa"] == [0.0] * 4
    assert 0.08 < state["vented_at_s"] - watching.starts_at_s - stop_at_s < LET_DOWN_S
