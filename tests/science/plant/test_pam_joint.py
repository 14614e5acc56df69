"""A joint between two muscles: where pressures hold it, how it swings there, and what its records tell of it."""

import numpy as np
import pytest

from tests.science.discrepancy.simulated_records import joint
from tests.science.plant.machines import begin_surely, read_plant, simulate, solve

STEP_S = 0.01
CONSTANTS = {"gain": 0.5, "bias": 1.0, "stiffness": 20.0, "stiffening": 0.1, "damping": 4.0, "input_delay_s": 0.0}


def read_joint(**changes):
    return read_plant("pam_joint", **{"output_scale": 0.5, "time_scale_s": 0.13, **changes})


def turn(raising, lowering, effects=(), begun=None, **changes):
    signals = {"pressure_1_kpa": raising, "pressure_2_kpa": lowering}
    return simulate(read_joint(), signals, {**CONSTANTS, **changes}, effects, begun)


@pytest.mark.parametrize(("raising", "lowering"), [(260.0, 140.0), (130.0, 70.0), (150.0, 150.0)])
def test_it_rests_where_the_pressures_say(raising, lowering):
    found = turn(np.full(600, raising), np.full(600, lowering))
    rest = (0.5 * (raising - lowering) + 1.0) / (20.0 + 0.1 * (raising + lowering))
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(rest, abs=1e-4)


@pytest.mark.parametrize("total", [100.0, 400.0, 1600.0])
def test_the_sum_of_pressures_makes_it_swing_more_quickly(total):
    time = np.arange(200) * STEP_S
    found = turn(np.full(200, total / 2), np.full(200, total / 2), bias=0.0, begun=begin_surely(0.2, 0.0))
    omega = np.sqrt(20.0 + 0.1 * total - 4.0)
    truth = 0.2 * np.exp(-2.0 * time) * (np.cos(omega * time) + 2.0 / omega * np.sin(omega * time))
    np.testing.assert_allclose(found, truth, atol=2e-5)


def test_motion_agrees_with_an_adaptive_solver(generator):
    time = np.arange(300) * STEP_S
    up, down = 200.0 + np.cumsum(4.0 * generator.standard_normal((2, 300)), axis=1)
    rubbing = [
        ("coulomb_friction", "slider", {"share": 0.1, "sliding": 0.2}),
        ("cubic_stiffness", "duffing", {"share": 0.8}),
    ]

    def rates(now, state):
        a, b, (x, v) = np.interp(now, time, up), np.interp(now, time, down), state
        more = np.tanh(v * 0.13 / 0.1) * 0.05 + 0.8 * x**3 / 0.25
        return [v, 0.5 * (a - b) + 1.0 - (20.0 + 0.1 * (a + b)) * x - 4.0 * v - more / 0.13**2]

    found = turn(up, down, rubbing)
    assert np.abs(found).max() > 0.1
    np.testing.assert_allclose(found, solve(rates, [0.0, 0.0], time)[0], atol=2e-4 * np.abs(found).max())


def test_where_the_sum_of_pressures_never_changes_the_stiffness_is_shared_out():
    signals, step_s = joint(5)
    differ = 0.5 * (signals["pressure_1_kpa"] - signals["pressure_2_kpa"])
    held = {**signals, "pressure_1_kpa": 200.0 + differ, "pressure_2_kpa": 200.0 - differ}
    starts = read_joint(output_scale=None, time_scale_s=None).resolve_from_data([held], step_s).starts
    assert starts["stiffness"] == pytest.approx(400.0 * starts["stiffening"])


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_rubs_and_is_moved_slowly_is_known_for_as_quick_as_it_is(seed):
    generator = np.random.default_rng(seed)
    time = np.arange(6000) * STEP_S
    size, hertz = np.array([[60.0, 30.0, 15.0], [0.04, 0.11, 0.19]])
    phase = generator.uniform(0.0, 6.0, (2, 3, 1))
    up, down = 200.0 + size @ np.sin(2.0 * np.pi * hertz[:, None] * time + phase)
    slider = ("coulomb_friction", "slider", {"share": 0.1, "sliding": 0.02})
    angle = turn(up, down, [slider]) + 1e-4 * generator.standard_normal(len(time))
    signals = {"pressure_1_kpa": up, "pressure_2_kpa": down, "angle_rad": angle}
    settled = read_joint(output_scale=None, time_scale_s=None).resolve_from_data([signals], STEP_S)
    assert 0.5 < settled.time_scale_s * np.sqrt(20.0 + 0.1 * 400.0) < 2.5
    for name, told in settled.nominal.items():
        assert told.low <= CONSTANTS[name] <= told.high
