"""Levels and counts that values give away, and those that they do not."""

import numpy as np
import pytest

from stages.science.output_channels.exact_values import find_count, find_levels
from tests.science.discrepancy.searches import DISCREPANCY

LIMITS = DISCREPANCY.detection
SMOOTH = np.random.default_rng(1).normal(500.0, 120.0, 5000)


@pytest.mark.parametrize(("lowest", "highest"), [(None, 650.0), (350.0, None), (350.0, 600.0)])
@pytest.mark.parametrize("offset", [0.0, -600.0, -350.0])
def test_a_clipped_signal_shows_its_levels(lowest, highest, offset):
    found = find_levels(np.clip(SMOOTH, lowest, highest) + offset, LIMITS)
    assert found == tuple(None if each is None else each + offset for each in (lowest, highest))


@pytest.mark.parametrize("count", [0.5, 2.0])
def test_a_clipped_signal_in_counts_finer_than_its_noise_shows_its_end(count):
    generator = np.random.default_rng(2)
    slow = 500.0 + 200.0 * np.sin(np.arange(20000.0).reshape(10, 2000).T / 300.0)
    noisy = np.round((slow + 5.0 * generator.standard_normal(slow.shape)) / count) * count
    assert find_levels(np.minimum(noisy, 450.0), LIMITS) == (None, 450.0)
    noisy[:3, 2] = np.nan
    assert find_levels(np.minimum(noisy, 450.0), LIMITS) == (None, 450.0)
    assert find_levels(noisy, LIMITS) == (None, None)
    coarse = np.round(np.clip(slow, 350.0, 650.0) / 20.0) * 20.0  # which rests at its ends
    assert find_levels(coarse, LIMITS) == (None, None)


REST = np.where(np.arange(5000) < 400, 500.0, SMOOTH)


@pytest.mark.parametrize("count", [3.7, 20.0])
def test_a_signal_in_counts_shows_their_size_and_others_neither_levels_nor_counts(count):
    counted = np.round(SMOOTH / count) * count
    assert find_count(counted, LIMITS) == pytest.approx(count, rel=1e-6)
    for values in (SMOOTH, counted, REST, np.zeros(0), np.full(100, 3.0)):
        assert find_levels(values, LIMITS) == (None, None)
    for values in (SMOOTH, np.minimum(SMOOTH, 520.0), np.repeat(SMOOTH[:100], 50)):
        assert find_count(values, LIMITS) is None
