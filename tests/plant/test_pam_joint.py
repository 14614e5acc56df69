"""A joint between two muscles: where pressures hold it, how it swings there, and what its records tell of it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stages.discrepancy.whole_record_cell import build_whole_records
from stages.plant.effect import find_effect
from stages.plant.record_plant import read_beginning
from tests.discrepancy.simulated_records import joint, tabulate
from tests.plant.machines import begin_surely, read_plant

STEP_S = 0.01
CONSTANTS = {"gain": 0.5, "bias": 1.0, "stiffness": 20.0, "stiffening": 0.1, "damping": 4.0, "timing_s": 0.0}


def read_joint(**changes):
    return read_plant("pam_joint", **{"output_scale": 0.5, "pace_s": 0.13, **changes})


def turn(raising, lowering, effects=(), begun=None, **changes):
    plant = read_joint()
    signals = {"pressure_1_kpa": np.asarray(raising, dtype=float), "pressure_2_kpa": np.asarray(lowering, dtype=float)}
    signals = plant.refine({name: values[:, None] for name, values in signals.items()}, STEP_S)
    return plant.simulate(signals, STEP_S, np.zeros(1), {**CONSTANTS, **changes}, effects, begun)[:, 0]


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


RUBBING = [
    (("coulomb_friction", "slider"), {"share": 0.1, "sliding": 0.2}, lambda x, v: np.tanh(v * 0.13 / 0.1) * 0.05),
    (("cubic_stiffness", "duffing"), {"share": 0.8}, lambda x, v: 0.8 * x**3 / 0.25),
]


@pytest.mark.parametrize(("named", "values", "more"), RUBBING, ids=["slider", "cubic"])
def test_motion_agrees_with_an_adaptive_solver(named, values, more, generator):
    time = np.arange(300) * STEP_S
    up, down = 200.0 + np.cumsum(4.0 * generator.standard_normal((2, 300)), axis=1)

    def rates(now, state):
        a, b, (x, v) = np.interp(now, time, up), np.interp(now, time, down), state
        return [v, 0.5 * (a - b) + 1.0 - (20.0 + 0.1 * (a + b)) * x - 4.0 * v - more(x, v) / 0.13**2]

    solved = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=STEP_S / 2)
    found = turn(up, down, [(find_effect(*named), values)])
    assert np.abs(found).max() > 0.1
    np.testing.assert_allclose(found, solved.y[0], atol=2e-4 * np.abs(found).max())


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_constants_are_guessed_from_a_noisy_record(seed):
    signals, step_s = joint(seed)
    starts = read_joint(output_scale=None, pace_s=None).settle([signals], step_s).starts
    assert starts == {name: pytest.approx(true, rel=0.25, abs=1e-9) for name, true in CONSTANTS.items()}


def test_where_the_sum_of_pressures_never_changes_the_stiffness_is_shared_out():
    signals, step_s = joint(5)
    differ = 0.5 * (signals["pressure_1_kpa"] - signals["pressure_2_kpa"])
    held = {**signals, "pressure_1_kpa": 200.0 + differ, "pressure_2_kpa": 200.0 - differ}
    starts = read_joint(output_scale=None, pace_s=None).settle([held], step_s).starts
    assert starts["stiffness"] == pytest.approx(400.0 * starts["stiffening"])


def test_it_forgets_as_its_damping_says_and_a_gap_is_not_judged_until_then():
    signals, step_s = joint(5, samples=1600)
    signals["pressure_2_kpa"][400:410] = np.nan
    cell = build_whole_records(*tabulate(signals, step_s), read_joint(output_scale=None, pace_s=None))
    memory = np.log(1e3) / (0.5 * cell.plant.starts["damping"])
    assert cell.plant.memory_s == pytest.approx(memory)
    judged = cell.present.T.ravel()
    assert judged[: round(4.0 / cell.step_s)].all()
    again = np.flatnonzero(judged & (np.arange(judged.size) * cell.step_s > 4.0))[0] * cell.step_s
    assert again == pytest.approx(4.1 + memory, abs=3 * cell.step_s)


def test_a_record_that_begins_in_mid_swing_is_taken_up_there():
    signals, step_s = joint(5, samples=1600)
    plant = read_joint().settle([signals], step_s)
    late = {name: values[700:, None] for name, values in signals.items()}
    begun = read_beginning([late["angle_rad"][:50, 0]], step_s)
    found = plant.simulate(plant.refine(late, step_s), step_s, np.zeros(1), CONSTANTS, (), begun)
    at_rest = plant.simulate(plant.refine(late, step_s), step_s, np.zeros(1), CONSTANTS)
    truth = late["angle_rad"]
    assert np.sqrt(((found - truth)[:50] ** 2).mean()) < 2.0 * 5e-4
    assert np.sqrt(((at_rest - truth)[:50] ** 2).mean()) > 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_rubs_and_is_moved_slowly_is_known_for_as_quick_as_it_is(seed):
    generator = np.random.default_rng(seed)
    time = np.arange(6000) * STEP_S
    waves = [(60.0, 0.04), (30.0, 0.11), (15.0, 0.19)]
    up, down = (
        200.0 + sum(size * np.sin(2.0 * np.pi * hertz * time + generator.uniform(0.0, 6.0)) for size, hertz in waves)
        for _ in range(2)
    )
    slider = (find_effect("coulomb_friction", "slider"), {"share": 0.1, "sliding": 0.02})
    angle = turn(up, down, [slider]) + 1e-4 * generator.standard_normal(len(time))
    signals = {"pressure_1_kpa": up, "pressure_2_kpa": down, "angle_rad": angle}
    settled = read_joint(output_scale=None, pace_s=None).settle([signals], STEP_S)
    assert 0.5 < settled.pace_s * np.sqrt(20.0 + 0.1 * 400.0) < 2.5
    for name, told in settled.nominal.items():
        assert told.low <= CONSTANTS[name] <= told.high
