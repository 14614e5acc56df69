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


REST = np.where(np.arange(5000) < 400, 500.0, SMOOTH)


@pytest.mark.parametrize("count", [3.7, 20.0])
def test_a_signal_in_counts_shows_their_size_and_others_neither_levels_nor_counts(count):
    counted = np.round(SMOOTH / count) * count
    assert find_count(counted, LIMITS) == pytest.approx(count, rel=1e-6)
    for values in (SMOOTH, counted, REST, np.zeros(0), np.full(100, 3.0)):
        assert find_levels(values, LIMITS) == (None, None)
    for values in (SMOOTH, np.minimum(SMOOTH, 520.0), np.repeat(SMOOTH[:100], 50)):
        assert find_count(values, LIMITS) is None
