"""A lag: steps in closed form for the textbook and each effect."""

import numpy as np
import pytest

from tests.science.plant.machines import read_plant, simulate, solve

STEP_S, LAG_S, SCALE, PACE_S = 0.01, 0.2, 50.0, 0.1
CONSTANTS = {"gain": 100.0, "offset": 20.0, "time_constant_s": LAG_S, "input_delay_s": 0.0}


def fill(command, *effects, **changes):
    plant = read_plant("first_order", output_scale=SCALE, time_scale_s=PACE_S)
    return simulate(plant, {"command_v": command}, {**CONSTANTS, **changes}, effects)


def step(height=1.0, samples=300, at=20):
    """A command that steps, within one sample, and the time since then."""
    return np.where(np.arange(samples) < at, 0.0, height), np.maximum(np.arange(samples) - at + 1, 0) * STEP_S


def fade(since, lag_s=LAG_S):
    """Return what is still missing: the mean of all steps within the sample."""
    return np.where(since > 0.0, np.exp(-since / lag_s) * lag_s / STEP_S * np.expm1(STEP_S / lag_s), 1.0)


UNEVEN = ("valve_asymmetry", "lag", {"asymmetry": 0.5})
SECOND = ("valve_lag", "lag", {"paces": 0.8})
STEPS = [
    # height, effects, what is still missing, how near
    (1.0, [], fade, 0.01),
    (-0.4, [], fade, 0.01),
    (1.0, [UNEVEN], lambda since: fade(since, LAG_S / 1.5), 0.02),
    (-1.0, [UNEVEN], lambda since: fade(since, LAG_S * 1.5), 0.02),
    (1.0, [SECOND], lambda since: (LAG_S * fade(since) - 0.08 * fade(since, 0.08)) / (LAG_S - 0.08), 0.1),
]


@pytest.mark.parametrize(("height", "effects", "missing", "near"), STEPS)
def test_a_step_is_answered_by_exponentials(height, effects, missing, near):
    command, since = step(height)
    found = fill(command, *effects)
    np.testing.assert_allclose(found, 20.0 + 100.0 * height * (1.0 - missing(since)), atol=near)
    assert found[-1] == pytest.approx(20.0 + 100.0 * height, abs=0.01 if effects else 1e-4)


def test_the_way_is_that_of_an_adaptive_solver(generator):
    time = np.arange(400) * STEP_S
    command = np.cumsum(generator.standard_normal(400)) / 10.0
    start = [20.0 + 100.0 * command[0]]
    truth = solve(lambda now, y: [(100.0 * np.interp(now, time, command) + 20.0 - y[0]) / LAG_S], start, time)[0]
    np.testing.assert_allclose(fill(command), truth, atol=1e-4 * np.ptp(truth))


def test_a_delay_answers_late_and_then_as_it_should():
    command, _ = step()
    late = fill(command, ("transport_delay", "lag", {"paces": 0.7}))
    np.testing.assert_allclose(late[7:], fill(command)[:-7], atol=1e-9)


@pytest.mark.parametrize("share", [0.5, -0.6])
def test_a_command_recorded_early_or_late_acts_in_time(share):
    time = np.arange(400) * STEP_S
    shifted = fill(np.sin(4.0 * (time + share * STEP_S)), input_delay_s=share * STEP_S)
    np.testing.assert_allclose(shifted[100:], fill(np.sin(4.0 * time))[100:], atol=0.05)


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


RUB = ("coulomb_friction", "lag_friction", {"share": 0.2})
"""A velocity of 10."""


@pytest.mark.parametrize("height", [1.0, -1.0, 0.09, -0.09])
def test_dry_friction_takes_as_much_of_every_velocity_and_holds_at_rest(height):
    """It rests at 20, which is where the sensor reads no velocity."""
    command, since = step(height)
    ends = np.sign(height) * max(abs(100.0 * height) - 10.0, 0.0)
    np.testing.assert_allclose(fill(command, RUB), 20.0 + ends * (1.0 - fade(since)), atol=0.3)


def test_what_dry_friction_slows_stops_and_stays():
    command = np.where(np.arange(300) < 150, 1.0, 0.05) * (np.arange(300) >= 20)
    found = fill(command, RUB)
    slowing = -5.0 + 95.0 * np.exp(-(np.arange(150) + 0.5) * STEP_S / LAG_S)
    np.testing.assert_allclose(found[150:], 20.0 + np.maximum(slowing, 0.0), atol=0.3)
    assert found[-1] == 20.0


def test_a_drag_that_grows_with_the_square_is_that_of_an_adaptive_solver(generator):
    time = np.arange(400) * STEP_S
    command = np.cumsum(generator.standard_normal(400)) / 10.0

    def change(now, y):
        level = (y[0] - 20.0) / SCALE
        return [(100.0 * np.interp(now, time, command) - SCALE * (level + 0.3 * level * abs(level))) / LAG_S]

    truth = solve(change, [20.0 + 100.0 * command[0]], time)[0]
    found = fill(command, ("viscous_friction", "lag_quadratic_drag", {"share": 0.3}))
    np.testing.assert_allclose(found, truth, atol=0.01 * np.ptp(truth))
