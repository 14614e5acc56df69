"""A textbook muscle, written here: nothing is missing in it, however it is driven, sampled and measured."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.signal import StateSpace, lsim

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.fitted_channel import prepare_all
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.search import search
from stages.science.recording.datasets import tabulate_session
from stages.science.signals.filtering import follow, smooth
from tests.science.discrepancy.searches import DISCREPANCY

TAU_S, DURATION_S, TRIALS = 0.05, 15.0, 10
STEP_S, JUMPS, RAMPS = 0.005, np.inf, 1000.0
DRIVEN = {
    "jumps": {"slew_kpa_per_s": JUMPS},
    "ramps": {"slew_kpa_per_s": RAMPS},
    "pulls little": {"slew_kpa_per_s": RAMPS, "most_kpa": 130.0},
    "is sampled often": {"slew_kpa_per_s": JUMPS, "step_s": 0.002, "noise_kpa": 0.05},
}
MUSCLE = {
    "joint": "elbow",
    "role": "agonist",
    "type": "MAS-40",
    "nominal_diameter_m": 0.04,
    "moment_arm_m": 0.036,
    "rest_length_m": 0.32,
    "contraction_at_angle_0": 0.02,
    "sign": 1,
}


def drive(rng, slew_kpa_per_s, step_s=STEP_S, most_kpa=250.0):
    """Return commands held for one to four seconds, (T, K), and the pressures of a lag of first order behind them."""
    samples, second = round(DURATION_S / step_s), round(1.0 / step_s)
    command = np.empty((samples, TRIALS))
    for column in command.T:
        ends = np.cumsum(rng.integers(second, 4 * second, samples // second))
        column[:] = rng.uniform(25.0, most_kpa, len(ends) + 1)[np.searchsorted(ends, np.arange(samples), side="right")]
    most = slew_kpa_per_s * step_s
    for before, now in pairwise(command):
        now[:] = before + np.clip(now - before, -most, most)
    pressure, kept = command.copy(), np.exp(-step_s / TAU_S)
    for k in range(1, samples):
        pressure[k] = command[k - 1] + kept * (pressure[k - 1] - command[k - 1])
    return command, pressure


def low_pass(signal, tau_s, step_s):
    """Return columns behind a filter of first order, settled at the first sample."""
    if not tau_s:
        return signal
    system, time_s = StateSpace([[-1.0 / tau_s]], [[1.0 / tau_s]], [[1.0]], [[0.0]]), step_s * np.arange(len(signal))
    return np.column_stack([lsim(system, column, time_s, column[:1])[1] for column in signal.T])


def make_session(
    rng, slew_kpa_per_s, step_s=STEP_S, most_kpa=250.0, noise_kpa=0.4, cell_s=0.0, slip_n=0.0, sensor_s=0.0, late=0
):
    """Return a session of the ideal braid (Chou and Hannaford 1996) with a linear skin and damper, and white noise.

    The load cell may be filtered, or slip once; the pressure's sensor may be filtered, or some samples late.
    """
    command, pressure = drive(rng, slew_kpa_per_s, step_s, most_kpa)
    time_s = step_s * np.arange(len(command))[:, None]
    quick, slow = rng.uniform(2.5, 5.5, TRIALS), rng.uniform(0.5, 1.3, TRIALS)
    angle = 0.6 + 0.4 * np.sin(slow * time_s) + 0.15 * np.sin(quick * time_s)
    contraction = 0.02 + 0.036 / 0.32 * angle
    velocity = 0.036 / 0.32 * (0.4 * slow * np.cos(slow * time_s) + 0.15 * quick * np.cos(quick * time_s))
    alpha, area = np.deg2rad(25.3), 1000.0 * np.pi * 0.02**2
    braid = 3.0 / np.tan(alpha) ** 2 * (1.0 - 1.28 * contraction) ** 2 - 1.0 / np.sin(alpha) ** 2
    force = np.maximum(area * pressure * braid - 1900.0 * contraction - 85.0 * velocity, 0.0)
    force, pressure = low_pass(force, cell_s, step_s), low_pass(pressure, sensor_s, step_s)
    force[len(force) // 2 :, 3] += slip_n
    pressure = np.vstack([*[pressure[:1]] * late, pressure[: len(pressure) - late]])
    columns = {
        "trial": np.broadcast_to(np.arange(TRIALS), angle.shape),
        "time_s": np.broadcast_to(time_s, angle.shape),
        "pressure_command_kpa": command,
        "pressure_kpa": pressure + noise_kpa * rng.standard_normal(angle.shape),
        "contraction": contraction,
        "contraction_velocity_per_s": velocity,
        "force_n": force + 2.0 * rng.standard_normal(angle.shape),
        "joint_angle_rad": angle,
        "joint_velocity_rad_per_s": velocity,
    }
    samples = pd.DataFrame({name: values.T.ravel() for name, values in columns.items()}).assign(muscle="pam1")
    nominal = {"valve_tau_s": 0.04, "braid_angle_deg": 25.0, "contraction_factor": 1.25, "damping_n_s": 90.0}
    meta = {"sampling_rate_hz": 1.0 / step_s, "load_cell_site": "muscle_tip", "nominal": nominal}
    return tabulate_session(samples, {**meta, "muscles": {"pam1": MUSCLE}}, "made up")


@pytest.mark.parametrize("slew_kpa_per_s", [JUMPS, RAMPS])
def test_what_smoothing_leaves_is_noise_also_where_a_command_jumps(slew_kpa_per_s, generator):
    command, pressure = drive(generator, slew_kpa_per_s)
    noise = 0.4 * generator.standard_normal(pressure.shape)
    told = follow(pressure + noise, command, STEP_S)
    left = told + smooth(pressure + noise - told, STEP_S, 0.044) - pressure
    noise_alone = smooth(noise, STEP_S, 0.044)
    assert np.sqrt(np.mean(left**2)) < 1.02 * np.sqrt(np.mean(noise_alone**2))
    assert np.abs(left).max() < 1.2 * np.abs(noise_alone).max()


def test_without_a_drive_nothing_follows(generator):
    assert not follow(generator.standard_normal((400, 3)), np.full((400, 3), 7.0), STEP_S).any()


@pytest.mark.slow
@pytest.mark.parametrize("driven", DRIVEN.values(), ids=DRIVEN)
def test_nothing_is_missing_in_a_textbook_muscle_that(driven, generator):
    states = prepare_all(build_muscle_channels(make_session(generator, **driven), DISCREPANCY))
    said = decide(search(states, DISCREPANCY.search, generator), DISCREPANCY, generator)
    assert (said.status, said.suspected) == ("no_discrepancy", [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "channel", "form"),
    [
        ({"cell_s": 0.03}, "force_n", "filtered_force"),
        ({"sensor_s": 0.02}, "pressure_kpa", "filtered_pressure"),
        ({"late": 4}, "pressure_kpa", "pressure"),
    ],
    ids=["force is filtered", "pressure is filtered", "pressure is late"],
)
def test_a_sensor_is_named_where_it_is_and_nothing_is_left(sensor, channel, form, generator):
    states = prepare_all(build_muscle_channels(make_session(generator, RAMPS, **sensor), DISCREPANCY))
    found = search(states, DISCREPANCY.search, generator)
    said = decide(found, DISCREPANCY, generator)
    (named,) = said.effects
    assert (named.name, named.channel, set(named.forms)) == ("channel_misalignment", channel, {form})
    assert named.probability > 0.9
    left = {state.output.channel: state.ratio(state.current.raw) for state in found.outputs}
    assert max(left.values()) < DISCREPANCY.search.smallest_gap, left


@pytest.mark.slow
@pytest.mark.parametrize(("slip_n", "status"), [(100.0, "unexplained"), (5.0, "no_discrepancy")])
def test_what_shows_in_one_trial_alone_is_neither_named_nor_called_nothing(slip_n, status, generator):
    states = prepare_all(build_muscle_channels(make_session(generator, RAMPS, slip_n=slip_n), DISCREPANCY))
    said = decide(search(states, DISCREPANCY.search, generator), DISCREPANCY, generator)
    assert (said.status, said.effects) == (status, [])
