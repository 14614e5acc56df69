"""Levels and counts that values give away, and those that they do not."""

import numpy as np
import pytest

from stages.discrepancy.exact_values import find_count, find_level

SMOOTH = np.random.default_rng(1).normal(500.0, 120.0, 5000)


def test_a_clipped_signal_shows_its_level():
    assert find_level(np.minimum(SMOOTH, 650.0)) == 650.0


@pytest.mark.parametrize("values", [SMOOTH, np.round(SMOOTH / 20.0) * 20.0, np.zeros(0), np.zeros(100)])
def test_others_have_none(values):
    assert find_level(values) is None


@pytest.mark.parametrize("count", [3.7, 20.0])
def test_a_signal_in_counts_shows_their_size(count):
    assert find_count(np.round(SMOOTH / count) * count) == pytest.approx(count, rel=1e-6)


@pytest.mark.parametrize("values", [SMOOTH, np.minimum(SMOOTH, 520.0), np.repeat(SMOOTH[:100], 50)])
def test_others_have_no_count(values):
    assert find_count(values) is None
