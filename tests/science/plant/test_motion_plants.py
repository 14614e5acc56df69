"""A joint between two muscles and a drive: where they rest, how they move, and what their records tell of them."""

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from stages.science.plant.record_plant import read_initial_state
from tests.science.discrepancy.simulated_records import configured, drive, joint
from tests.science.plant.machines import begin_surely, read_plant, simulate, solve

STEP_S = 0.01
JOINT = {"gain": 0.5, "bias": 1.0, "stiffness": 20.0, "stiffening": 0.1, "damping": 4.0, "input_delay_s": 0.0}
DRIVE = {"mass": 4.0, "force_offset": 0.5, "input_delay_s": 0.0}


def read_joint(**changes):
    return read_plant("pam_joint", **{"output_scale": 0.5, "time_scale_s": 0.13, **changes})


def turn(raising, lowering, effects=(), begun=None, **changes):
    signals = {"pressure_1_kpa": raising, "pressure_2_kpa": lowering}
    return simulate(read_joint(), signals, {**JOINT, **changes}, effects, begun)


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


def test_a_joint_that_rubs_agrees_with_an_adaptive_solver(generator):
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
        assert told.low <= JOINT[name] <= told.high


def test_a_belt_is_an_oscillator_behind_a_lag_and_is_known_by_its_records(generator):
    command = np.repeat(generator.choice([-1.0, 1.0], 200), 4)
    transfer = TransferFunction([1.8], np.polymul([0.13, 1.0], [1.0 / 21.0**2, 2.0 * 0.1 / 21.0, 1.0]))
    truth = np.append(0.0, lsim(transfer, np.repeat(command, 20), np.arange(800 * 20) * 0.001, interp=False)[1][20::20])
    sizes = {
        "static_gain": 1.8,
        "natural_frequency_hz": 21.0 / (2.0 * np.pi),
        "damping_ratio": 0.1,
        "drive_lag_s": 0.13,
    }
    constants = {**sizes, "input_offset": 0.0, "output_offset": 0.0, "input_delay_s": 0.0}
    belt = configured("belt_drive")
    plant = belt.model_copy(update={"output_scale": 1.0, "time_scale_s": 1.0 / 21.0})
    signals = {"drive_v": command, "response_v": truth}
    found = simulate(plant, {"drive_v": command}, constants, begun=begin_surely(0.0, 0.0), step_s=0.02)
    np.testing.assert_allclose(found, truth, atol=2e-3)
    starts = belt.resolve_from_data([signals], 0.02).starts
    assert {name: starts[name] for name in sizes} == pytest.approx(sizes, rel=0.2)


def read_drive(**changes):
    return read_plant("servo_drive", **{"output_scale": 0.3, "time_scale_s": 0.5, **changes})


def move(force, effects=(), begun=None, between="linear", **changes):
    return simulate(read_drive(between_samples=between), {"force_n": force}, {**DRIVE, **changes}, effects, begun)


def test_a_constant_force_draws_a_parabola_from_the_place_and_rate_in_which_a_record_begins():
    time = np.arange(200) * STEP_S
    begun = begin_surely(0.1, -0.3)
    np.testing.assert_allclose(move(np.full(200, 1.5), begun=begun), 0.1 - 0.3 * time + 0.25 * time**2, atol=1e-12)


def test_all_of_a_record_says_at_which_rate_a_drive_began():
    """The first samples tell it to .2 per second here, by which a free mass is 2 astray in the end."""
    time, noise = np.arange(1000) * STEP_S, 0.01
    measured = 0.1 - 0.3 * time + 0.25 * time**2 + noise * np.random.default_rng(3).standard_normal(1000)
    signals = {"force_n": np.full(1000, 1.5), "position_m": measured}
    begun = read_initial_state([measured[:50]], STEP_S)
    found = simulate(read_drive(), signals, DRIVE, (), begun)
    assert np.sqrt(np.mean((found - measured) ** 2)) == pytest.approx(noise, rel=0.1)
    without = simulate(read_drive(), {"force_n": signals["force_n"]}, DRIVE, (), begun)
    assert np.sqrt(np.mean((without - measured) ** 2)) > 5 * noise


@pytest.mark.parametrize("hertz", [0.5, 2.0])
def test_a_sine_of_force_is_a_sine_of_motion(hertz):
    wave = np.sin(2 * np.pi * hertz * np.arange(300) * STEP_S)
    begun = begin_surely(0.0, -0.75 / (2 * np.pi * hertz))
    found = move(3.0 * wave, force_offset=0.0, begun=begun, between="averaged")
    np.testing.assert_allclose(found, -0.75 / (2 * np.pi * hertz) ** 2 * wave, atol=2e-5)


RUBBING = {
    "viscous_friction-quadratic_drag": ({"share": 0.4}, lambda v: 0.4 * v * abs(v) / 0.3),
    "coulomb_friction-slider": ({"share": 0.2, "sliding": 0.3}, lambda v: 0.24 * np.tanh(v * 0.5 / 0.09)),
}


@pytest.mark.parametrize("form", RUBBING)
def test_friction_of_a_drive_agrees_with_an_adaptive_solver(form, generator):
    time, begun, (values, slowed) = np.arange(300) * STEP_S, begin_surely(0.0, 0.0), RUBBING[form]
    force = np.cumsum(generator.standard_normal(300)) / 3.0

    def rates(now, state):
        return [state[1], (np.interp(now, time, force) + 0.5) / 4.0 - slowed(state[1])]

    found = move(force, [(*form.split("-"), values)], begun=begun)
    assert np.abs(found - move(force, begun=begun)).max() > 0.05
    np.testing.assert_allclose(found, solve(rates, [0.0, 0.0], time)[0], atol=2e-4 * np.ptp(found))


@pytest.mark.parametrize("share", [0.4, -0.7, 1.0])
def test_a_force_recorded_early_or_late_acts_in_time(share):
    def push(now):
        return 1.0 - np.cos(3.0 * now) - 0.6 * np.sin(2.0 * now) ** 3

    time = np.arange(400) * STEP_S
    begun, shifted = begin_surely(0.0, 0.0), push(time + share * STEP_S)
    truth = move(push(time), begun=begun)
    late = move(shifted, begun=begun, input_delay_s=share * STEP_S)
    assert np.abs(late - truth).max() < 0.02 * np.abs(move(shifted, begun=begun) - truth).max()


def test_samples_that_are_means_move_it_as_the_force_itself():
    """Straight lines through the means of each twenty samples would lie beside a bent force."""
    fine = np.arange(8000) * STEP_S / 20
    curves = 2.0 * np.sin(4.0 * fine), -0.03125 * np.sin(4.0 * fine), -0.125 * np.cos(4.0 * fine)
    means, truth, speed = (each.reshape(-1, 20).mean(axis=1) for each in curves)
    begun = begin_surely(truth[0], speed[0])
    averaged, straight = (
        np.abs(move(means, begun=begun, between=how, force_offset=0.0) - truth).max() for how in ("averaged", "linear")
    )
    assert averaged < 0.1 * straight


def test_values_of_the_configuration_are_kept_and_it_never_forgets_how_it_began():
    mass = {"unit": "kg", "start": 30.0, "low": 10.0, "high": 90.0, "sd": 5.0}
    told = read_drive().model_dump()["constants"] | {"mass": mass}
    signals, step_s = drive(5)
    plant = read_drive(constants=told, output_scale=None).resolve_from_data([signals], step_s)
    assert plant.starts["mass"] == 30.0
    assert plant.memory_s == np.inf
    assert plant.drifts


def test_the_mass_is_guessed_although_friction_takes_up_most_of_the_force(generator):
    """A slow drive rests most of the time, whatever pulls at it; only while it moves does it show its mass."""
    time = np.arange(6000) * STEP_S
    force = 12.0 * np.sin(2 * np.pi * 0.2 * time) + 0.5 * generator.standard_normal(len(time))
    place, velocity, places = 0.0, 0.0, []
    for each in force:
        places.append(place)
        for _ in range(20):
            free = velocity + STEP_S / 20 * each / 4.0
            velocity = np.sign(free) * max(abs(free) - STEP_S / 20 * 10.0 / 4.0, 0.0)
            place += STEP_S / 20 * velocity
    record = {"force_n": force, "position_m": np.array(places) + 1e-6 * generator.standard_normal(len(force))}
    settled = read_plant("servo_drive").resolve_from_data([record], STEP_S)
    assert settled.constants.mass.start == pytest.approx(4.0, rel=0.4)
