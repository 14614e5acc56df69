"""A planted oscillation is found at its frequency and taken out; noise and motion hold none."""

import numpy as np
import pytest
from scipy.signal import lfilter

from stages.science.output_channels.spectral_line import find_line, remove_line
from tests.science.discrepancy.searches import DISCREPANCY

STEP_S = 0.004


def find(residual, known=True):
    return find_line(residual, np.full(residual.shape, known), STEP_S, DISCREPANCY.detection)


def make_noise(seed, colour=0.0, trials=10, samples=1000):
    return lfilter([1.0], [1.0, -colour], np.random.default_rng(seed).standard_normal((samples, trials)), axis=0)


def ring(frequency_hz, shape, seed=0):
    time = np.arange(shape[0])[:, None] * STEP_S
    return np.sin(2.0 * np.pi * frequency_hz * time + np.random.default_rng(seed).uniform(0.0, 6.0, shape[1]))


@pytest.mark.parametrize("frequency_hz", [8.0, 23.4, 50.0, 99.0])
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_planted_line_is_found_at_its_frequency(frequency_hz, colour):
    noise = make_noise(1, colour)
    found = find(noise + 0.5 * noise.std() * ring(frequency_hz, noise.shape))
    assert found == pytest.approx(frequency_hz, abs=0.15)


def test_noise_of_any_colour_rings_by_chance_as_seldom_as_said():
    found = [find(make_noise(seed, colour)) for seed in range(40) for colour in (0.0, 0.5, 0.98)]
    assert sum(each is not None for each in found) <= 1


def test_motion_below_the_least_frequency_and_short_or_empty_trials_show_none():
    noise = make_noise(2)
    assert find(noise + 3.0 * ring(2.0, noise.shape)) is None
    assert find(make_noise(4, samples=50)) is None
    assert find(make_noise(4), known=False) is None


def test_what_is_left_without_the_line_is_the_noise():
    noise = make_noise(3)
    known = np.ones(noise.shape, dtype=bool)
    known[200:300, 4] = False
    residual = np.where(known, noise + 2.0 * ring(31.0, noise.shape), 0.0)
    left = remove_line(residual, known, STEP_S, 31.0)
    assert (left[~known] == 0.0).all()
    np.testing.assert_allclose(left[known].std(), noise[known].std(), rtol=0.01)
    np.testing.assert_allclose(left[known], noise[known], atol=0.35)


def test_noise_keeps_its_size_where_a_line_is_taken_out_of_few_samples():
    noise = make_noise(3, trials=4000, samples=12)
    left = remove_line(noise, np.ones(noise.shape, dtype=bool), STEP_S, 50.0)
    assert np.mean(left**2) == pytest.approx(np.mean(noise**2), rel=0.02)


@pytest.mark.parametrize(("high", "found"), [(0.05, False), (0.4, True)])
def test_a_trace_in_the_spectrum_of_a_slow_motion_is_no_line(high, found):
    time_s, phases = STEP_S * np.arange(1000)[:, None], np.linspace(0.0, 6.0, 10)
    motion = np.sin(2.0 * np.pi * 0.5 * time_s + phases) + 1e-3 * make_noise(7)
    hz = find(motion + high * np.sin(2.0 * np.pi * 15.5 * time_s + 2.0 * phases))
    assert (hz is not None) == found
    assert not found or hz == pytest.approx(15.5, abs=0.1)
