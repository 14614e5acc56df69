"""What is said of trials that are opened once, in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from stages.science.discrepancy.verification import bound_ratio
from tests.science.discrepancy.searches import DISCREPANCY

TRIALS, SAMPLES = 3, 10


def channel(name, gap, floor):
    """An output of a channel with the same squared gap and floor in every trial."""
    return SimpleNamespace(
        output=SimpleNamespace(channel=name, present=np.ones((SAMPLES, TRIALS), dtype=bool)),
        floor=SAMPLES * np.full(TRIALS, floor**2),
        steps=[SAMPLES * np.full(TRIALS, gap**2)],
        squares=lambda step: step,
    )


@pytest.mark.parametrize("order", [1, -1])
def test_the_gap_over_the_floor_is_that_of_the_channel_where_it_is_largest(order):
    found = [channel("force_n", 0.03, 0.01), channel("pressure_kpa", 0.08, 0.04)][::order]
    ratio = bound_ratio(found, 0, range(TRIALS), DISCREPANCY, np.random.default_rng(0))
    assert ratio == {name: pytest.approx(3.0) for name in ("value", "low", "high")}
