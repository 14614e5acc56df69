"""A lag: steps in closed form for the textbook and each effect, and what its records tell of it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stages.discrepancy.whole_record_cell import build_whole_records
from stages.plant.effect import DynamicEffect, find_effect, list_effects, list_forms
from stages.plant.machines.first_order import SITE
from stages.plant.record_plant import read_beginning
from tests.discrepancy.simulated_records import lag, tabulate
from tests.plant.machines import read_plant

STEP_S, LAG_S, SCALE, PACE_S = 0.01, 0.2, 50.0, 0.1
CONSTANTS = {"gain": 100.0, "offset": 20.0, "time_constant_s": LAG_S, "timing_s": 0.0}
FORMS = [
    form
    for name in list_effects()
    for form in list_forms(name)
    if isinstance(form, DynamicEffect) and form.site == SITE
]


def read_lag(**changes):
    return read_plant("first_order", **{"output_scale": SCALE, "pace_s": PACE_S, **changes})


def fill(command, *effects, begun=None, **changes):
    signals = {"command_v": np.asarray(command, dtype=float)[:, None]}
    placed = [(find_effect(name, form), values) for name, form, values in effects]
    return read_lag().simulate(signals, STEP_S, np.zeros(1), {**CONSTANTS, **changes}, placed, begun)[:, 0]


def step(height=1.0, samples=300, at=20):
    """A command that steps, within one sample, and the time since then."""
    return np.where(np.arange(samples) < at, 0.0, height), np.maximum(np.arange(samples) - at + 1, 0) * STEP_S


def fade(since, lag_s=LAG_S):
    """Return what is still missing: the mean of all steps within the sample."""
    return np.where(since > 0.0, np.exp(-since / lag_s) * lag_s / STEP_S * np.expm1(STEP_S / lag_s), 1.0)


@pytest.mark.parametrize("height", [1.0, -0.4])
def test_a_step_is_answered_by_an_exponential(height):
    command, since = step(height)
    np.testing.assert_allclose(fill(command), 20.0 + 100.0 * height * (1.0 - fade(since)), atol=0.01)
    assert fill(command)[-1] == pytest.approx(20.0 + 100.0 * height, abs=1e-4)


def test_the_way_is_that_of_an_adaptive_solver(generator):
    time = np.arange(400) * STEP_S
    command = np.cumsum(generator.standard_normal(400)) / 10.0
    solved = solve_ivp(
        lambda now, y: [(100.0 * np.interp(now, time, command) + 20.0 - y[0]) / LAG_S],
        (0.0, time[-1]),
        [20.0 + 100.0 * command[0]],
        t_eval=time,
        rtol=1e-8,
        max_step=STEP_S / 2,
    )
    np.testing.assert_allclose(fill(command), solved.y[0], atol=1e-4 * np.ptp(solved.y[0]))


def test_a_delay_answers_late_and_then_as_it_should():
    command, _ = step()
    np.testing.assert_allclose(
        fill(command, ("transport_delay", "lag", {"paces": 0.7}))[7:], fill(command)[:-7], atol=1e-9
    )


@pytest.mark.parametrize("share", [0.5, -0.6])
def test_a_command_recorded_early_or_late_acts_in_time(share):
    time = np.arange(400) * STEP_S
    plain = fill(np.sin(4.0 * time))
    shifted = fill(np.sin(4.0 * (time + share * STEP_S)), timing_s=share * STEP_S)
    np.testing.assert_allclose(shifted[100:], plain[100:], atol=0.05)


def test_an_asymmetric_lag_rises_and_falls_with_two_time_constants():
    uneven = ("valve_asymmetry", "lag", {"asymmetry": 0.5})
    command, since = step()
    np.testing.assert_allclose(fill(command, uneven), 20.0 + 100.0 * (1.0 - fade(since, LAG_S / 1.5)), atol=0.02)
    np.testing.assert_allclose(fill(-command, uneven), 20.0 - 100.0 * (1.0 - fade(since, LAG_S * 1.5)), atol=0.02)


def test_a_limited_rate_climbs_straight_and_then_settles():
    command, since = step(2.0)
    fastest = SCALE / PACE_S / 1.25
    since = since - 0.5 * STEP_S
    straight_s = 200.0 / fastest - LAG_S
    left = 200.0 - fastest * straight_s
    truth = np.where(since < straight_s, fastest * since, 200.0 - left * np.exp(-(since - straight_s) / LAG_S))
    found = fill(command, ("valve_rate_limit", "lag", {"slowness": 1.25}))
    np.testing.assert_allclose(found[21:], 20.0 + truth[21:], atol=1.5)
    assert np.diff(found).max() <= fastest * STEP_S * (1.0 + 1e-9)


def test_a_second_lag_stands_in_series():
    command, since = step()
    first, second = LAG_S, 0.08
    missing = (first * fade(since, first) - second * fade(since, second)) / (first - second)
    np.testing.assert_allclose(
        fill(command, ("valve_lag", "lag", {"paces": 0.8})), 20.0 + 100.0 * (1.0 - missing), atol=0.1
    )


def test_a_play_holds_what_fills_within_its_width():
    slow = np.concatenate([np.linspace(0.0, 2.0, 2000), np.linspace(2.0, 0.0, 2000)])
    found = fill(slow, ("hysteresis", "lag", {"half_width": 0.3}), time_constant_s=0.01)
    assert found[1500] == pytest.approx(20.0 + 100.0 * slow[1500] - 0.3 * SCALE, abs=0.2)
    assert found[3000] == pytest.approx(20.0 + 100.0 * slow[3000] + 0.3 * SCALE, abs=0.2)
    assert np.ptp(found[2020:2250]) < 0.2


def test_drive_and_reading_end_at_their_levels():
    command = np.linspace(0.0, 2.0, 201)
    drive = fill(command, ("saturation", "lag_drive", {"scale_over_level": 0.5}))
    np.testing.assert_allclose(drive, fill(np.minimum(command, 1.0)), atol=1e-9)
    reading = fill(command, ("saturation", "lag_reading", {"share": 1.0, "lowest": 0.8, "highest": 2.4}))
    np.testing.assert_allclose(reading, np.clip(fill(command), 40.0, 120.0), atol=1e-9)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: f"{form.name}-{form.form}")
def test_zero_magnitude_is_absence_and_each_start_is_not(form, generator):
    command = np.repeat(generator.uniform(0.0, 5.0, 20), 25)
    starts = {each.name: each.starts[0] for each in form.parameters}
    first = form.parameters[0]
    np.testing.assert_array_equal(fill(command, (form.name, form.form, {**starts, first.name: 0.0})), fill(command))
    for start in first.starts:
        present = fill(command, (form.name, form.form, {**starts, first.name: start}))
        assert np.isfinite(present).all()
        assert np.abs(present - fill(command)).max() > 0.1


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_constants_are_guessed_from_a_noisy_record(noise):
    signals, step_s = lag(5, noise=noise)
    plant = read_lag(output_scale=None, pace_s=None).settle([signals], step_s)
    assert plant.starts["gain"] == pytest.approx(100.0, rel=0.01)
    assert plant.starts["offset"] == pytest.approx(20.0, abs=2.0)
    assert plant.starts["time_constant_s"] == pytest.approx(0.35, rel=0.02)
    assert plant.constants.timing_s.high == pytest.approx(step_s)


def test_a_record_that_begins_unsettled_is_taken_up_there():
    signals, step_s = lag(5, samples=400)
    late = {name: values[83:, None] for name, values in signals.items()}
    constants = {**CONSTANTS, "time_constant_s": 0.35}
    begun = read_beginning([late["pressure_kpa"][:50, 0]], step_s)
    plant = read_lag()
    found, at_rest = (plant.simulate(late, step_s, np.zeros(1), constants, (), each) for each in (begun, None))
    assert np.abs(found - late["pressure_kpa"])[:30].max() < 5 * 0.3
    assert np.abs(at_rest - late["pressure_kpa"])[:30].max() > 20.0


def test_after_a_gap_nothing_is_judged_until_it_is_forgotten():
    signals, step_s = lag(5, samples=1600)
    signals["command_v"][500:520] = np.nan
    cell = build_whole_records(*tabulate(signals, step_s), read_lag(output_scale=None, pace_s=None))
    memory = np.log(1e3) * cell.plant.starts["time_constant_s"]
    assert cell.plant.memory_s == pytest.approx(memory)
    lost = np.flatnonzero(~cell.present.T.ravel()) * cell.step_s
    assert lost[0] == pytest.approx(500 * step_s, abs=2 * cell.step_s)
    assert lost[-1] == pytest.approx(520 * step_s + memory, abs=2 * cell.step_s)
