"""Equivalence against statsmodels; what its power means is told by other tests here."""

import numpy as np
import pytest
from statsmodels.stats.weightstats import ttost_ind, ttost_paired

from stages.science.statistics.equivalence import judge_equivalence, judge_paired_equivalence
from stages.science.statistics.power import power_of_equivalence, power_of_paired_equivalence


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_agrees_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 8), generator.normal(1.2, 0.6, 6)
    groups, pairs = judge_equivalence(first, second, margin), judge_paired_equivalence(first[:6], second, margin)
    assert groups.p_tost == pytest.approx(ttost_ind(first, second, -margin, margin, usevar="unequal")[0], rel=1e-9)
    assert pairs.p_tost == pytest.approx(ttost_paired(first[:6], second, -margin, margin)[0], rel=1e-9)
    power = power_of_equivalence(margin, first.std(ddof=1), second.std(ddof=1), 8, 6)
    assert groups.power == pytest.approx(power, abs=1e-12)
    power = power_of_paired_equivalence(margin, np.std(first[:6] - second, ddof=1), 6)
    assert pairs.power == pytest.approx(power, abs=1e-12)
    assert groups.margin == pairs.margin == margin


@pytest.mark.parametrize("spread", [0.5, 1.0])
def test_the_smallest_n_is_the_first_with_enough_power(spread):
    values = np.array([-1.0, -0.2, 0.3, 1.4])
    told = judge_equivalence(values, values * spread, 1.0)
    sds = values.std(ddof=1), values.std(ddof=1) * spread
    powers = [power_of_equivalence(1.0, *sds, n, n) for n in range(2, 60)]
    assert told.n_needed == 2 + int(np.argmax(np.array(powers) >= 0.8))
    assert (np.diff(powers) > -1e-12).all()
    told = judge_paired_equivalence(values, 0.0 * values, 0.7)
    powers = [power_of_paired_equivalence(0.7, sds[0], n) for n in range(2, 60)]
    assert told.n_needed == 2 + int(np.argmax(np.array(powers) >= 0.8))
