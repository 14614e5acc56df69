"""Schedules of pressures and postures, noise of a band, delays and scalings, each by a law of its own."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import savgol_filter

from stages.science.plant.filters import respond
from stages.science.signals.filtering import choose_window, decimate, white_share, window_length
from stages.science.signals.measures import find_delay
from stages.science.signals.noise import band_noise
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT, Scaling
from stages.science.signals.trajectories import connect_points, minimum_jerk, pressure_profiles, reach_postures

TIMES = {"hold_s": (0.3, 1.0), "transition_s": (0.2, 0.6)}
RATE_HZ = 100.0


def test_profiles_fill_their_range(generator):
    profiles = pressure_profiles(generator, [20, 50], [200, 600], 50000, 250.0, step_share=0.3, **TIMES)
    assert (profiles.min(axis=0) < [30, 75]).all()
    assert (profiles.max(axis=0) > [190, 575]).all()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_share_of_steps_is_kept(generator, share):
    profile = pressure_profiles(generator, 100, 700, 250 * 400, 250.0, step_share=share, **TIMES)[:, 0]
    steps = (np.abs(np.diff(profile)) > 20.0).sum()
    moving = np.abs(np.diff(profile)) > 0.0
    changes = (np.diff(moving.astype(int)) == 1).sum() + moving[0]
    assert steps / changes == pytest.approx(share, abs=0.08)


def test_ramps_are_smooth_and_muscles_have_schedules_of_their_own(generator):
    profiles = pressure_profiles(generator, [0, 0], [100, 100], 2000, 250.0, step_share=0.0, **TIMES)
    moved = np.diff(profiles, axis=0)
    assert np.abs(moved).max() * 250 <= 1.875 * 100 / 0.2 * 1.001
    assert ((moved[:, 0] == 0.0) != (moved[:, 1] == 0.0)).mean() > 0.1


def test_minimum_jerk_is_the_polynomial_of_flash_and_hogan_held_at_its_ends():
    share = np.linspace(-0.5, 1.5, 201)
    inside = np.clip(share, 0.0, 1.0)
    assert minimum_jerk(share) == pytest.approx(10 * inside**3 - 15 * inside**4 + 6 * inside**5, abs=1e-12)


def test_points_are_passed_at_their_times():
    points = np.array([[0.0], [2.0], [-1.0]])
    way = connect_points(points, np.array([1.0, 3.0]), np.array([1.0, 0.0]), np.arange(0.0, 5.0, 0.5))
    assert way[:, 0] == pytest.approx([0, 0, 0, 1, 2, 2, -1, -1, -1, -1])


def test_reaches_move_no_faster_than_the_shortest_move_and_differ():
    def draw(seed):
        source = np.random.default_rng(seed)
        return reach_postures(source, [0.1, -0.5], [1.0, 0.5], 1000, 250.0, (0.6, 1.4), (0.0, 0.5))

    way = draw(1)
    assert np.ptp(way, axis=0).min() > 0.1
    assert np.abs(np.diff(way, axis=0)).max() * 250 <= 1.875 * 1.0 / 0.6
    assert way.tobytes() != draw(2).tobytes()


def test_noise_has_unit_variance_in_its_band_and_columns_are_independent(generator):
    noise = np.stack([band_noise(generator, 1000, 2, 250.0, 6.0, 12.0) for _ in range(200)])
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1] == pytest.approx(0.0, abs=0.03)
    noise = band_noise(generator, 5000, 1, 250.0, 8.0, 12.0)[:, 0]
    power = np.abs(np.fft.rfft(noise * np.hanning(5000))) ** 2
    frequencies = np.fft.rfftfreq(5000, 1 / 250)
    inside = (frequencies > 7.8) & (frequencies < 12.2)
    assert power[inside].sum() > 0.999 * power.sum()
    with pytest.raises(ValueError, match="widen the band"):
        band_noise(generator, 100, 1, 100.0, 60.0, 70.0)


def wander(generator, time_s):
    parts = [(generator.uniform(0.2, 1.5), generator.uniform(0.0, 6.3), generator.uniform(0.2, 1.0)) for _ in range(5)]
    return sum(size * np.sin(2 * np.pi * hz * time_s + phase) for hz, phase, size in parts)


@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.163, 0.3, 0.457])
@pytest.mark.parametrize("seed", range(3))
def test_a_delay_is_found_to_a_fraction_of_a_sample_and_noise_moves_it_little(seed, delay_s):
    time_s = np.arange(800) / RATE_HZ
    shown, followed = (wander(np.random.default_rng(seed), at_s) for at_s in (time_s, time_s - delay_s))
    assert find_delay(shown, 0.3 + 0.8 * followed, RATE_HZ, 1.0) == pytest.approx(delay_s, abs=0.003)
    noisy = followed + 0.1 * followed.std() * np.random.default_rng(2).standard_normal(800)
    assert find_delay(shown, noisy, RATE_HZ, 1.0) == pytest.approx(delay_s, abs=0.02)


@pytest.mark.parametrize(("high", "scale"), [(0.0, 1.0), (1e5, 1.0), (0.0, 1e-60)])
def test_a_step_is_found_to_be_late_high_up_and_however_small(high, scale):
    time_s = np.arange(800) / RATE_HZ
    shown, followed = (high + scale * (time_s >= at_s) for at_s in (6.0, 6.25))
    assert find_delay(shown, followed, RATE_HZ, 1.0) == pytest.approx(0.25, abs=0.003)


def test_what_does_not_follow_has_no_delay(generator):
    time_s = np.arange(800) / RATE_HZ
    shown = wander(generator, time_s)
    assert np.isnan(find_delay(shown, np.full(800, 0.4), RATE_HZ, 1.0))
    assert np.isnan(find_delay(shown, generator.standard_normal(800), RATE_HZ, 1.0))
    assert np.isnan(find_delay(np.sin(time_s / 3), np.sin((time_s - 2.0) / 3), RATE_HZ, 1.0))


def test_what_was_standardised_is_restored(generator):
    samples = pd.DataFrame(100.0 * generator.standard_normal((20, 4)), columns=[*MODEL_INPUTS, MODEL_OUTPUT])
    scaling = Scaling(MODEL_INPUTS, np.array([90.0, 0.1, 0.0]), np.array([40.0, 0.05, 2.0]), 100.0, 300.0)
    restored = scaling.restore_inputs(scaling.inputs_of(samples))
    np.testing.assert_allclose(restored, samples[list(MODEL_INPUTS)], rtol=1e-12)
    np.testing.assert_allclose(scaling.restore_force(scaling.output_of(samples)), samples[MODEL_OUTPUT], rtol=1e-12)
    np.testing.assert_allclose(scaling.restore_inputs(np.ones((1, 3))), [[130.0, 0.15, 2.0]])


@pytest.mark.parametrize("factor", [2, 4, 5])
def test_a_decimated_signal_is_not_late_and_has_no_alias(factor):
    time_s = np.arange(2000) / 500.0
    slow, fast = np.sin(2.0 * np.pi * 1.5 * time_s), np.sin(2.0 * np.pi * (500.0 / factor - 1.5) * time_s)
    kept = decimate(np.stack([slow, fast], axis=1), factor)[5:-5]
    assert kept[:, 0] == pytest.approx(slow[::factor][5:-5], abs=2e-3)
    assert np.abs(kept[:, 1]).max() < 2e-3


@pytest.mark.parametrize("factor", [2, 4, 5])
def test_a_lag_of_a_decimated_command_is_the_decimated_lag(factor):
    """The command is held from sample to sample, so its mean until the next kept one drives the lag."""
    step_s, tau_s = 0.002, np.array([0.04])
    command = 300.0 + 100.0 * np.sin(2.0 * np.pi * 1.3 * step_s * np.arange(4000))[:, None]
    fine = decimate(respond(command, tau_s, tau_s, step_s), factor)
    coarse = respond(decimate(command, factor, held=True), tau_s, tau_s, factor * step_s)
    late = respond(decimate(command, factor), tau_s, tau_s, factor * step_s)
    inside = slice(200, -5)
    error, without = (np.abs(fine - each)[inside].max() for each in (coarse, late))
    assert error < 5.0 * (factor * step_s / tau_s[0]) ** 2  # of an amplitude of 100; of second order in the step
    assert without > 5.0 * error


@pytest.mark.parametrize("factor", [1, 2, 5])
def test_the_share_of_white_noise_that_is_left_is_told(generator, factor):
    noise = generator.standard_normal((20000, 4))
    assert decimate(noise, factor).var() == pytest.approx(white_share(factor), rel=0.05)


@pytest.mark.parametrize(
    ("noise", "count"), [(1e-4, 0.0), (1e-3, 0.0), (1e-2, 0.0), (1e-1, 0.0), (0.0, 0.02), (0.0, 0.2)]
)
@pytest.mark.parametrize("derivative", [0, 1])
def test_a_window_is_chosen_that_errs_little_more_than_the_best(noise, count, derivative):
    """The best is known here, where the signal is; the choice sees noise alone."""
    generator, time = np.random.default_rng(5), np.arange(0.0, 20.0, 0.01)
    phases = 2.0 * np.pi * generator.random(5)
    told = [np.sin(rate * time + phase) for rate, phase in zip((0.7, 1.3, 2.1, 3.4, 5.5), phases, strict=True)]
    turned = [rate * np.cos(rate * time + p) for rate, p in zip((0.7, 1.3, 2.1, 3.4, 5.5), phases, strict=True)]
    truth, measured = np.sum(turned if derivative else told, axis=0), np.sum(told, axis=0)
    measured += noise * generator.standard_normal(len(time))
    if count:  # of an encoder
        measured = count * np.round(measured / count)

    def err(window_s):
        length = window_length(100.0, window_s, 3)
        return np.sqrt(np.mean((savgol_filter(measured, length, 3, derivative, 0.01) - truth)[200:-200] ** 2))

    chosen = choose_window([measured], 100.0, 0.6, 3, derivative)
    assert err(chosen) < 2.0 * min(err(each) for each in np.geomspace(0.04, 0.6, 40))


def test_a_signal_without_noise_is_not_smoothed():
    assert choose_window([np.repeat(np.arange(40.0), 25)], 100.0, 1.6, 3, 0) == 0.0
