"""Equivalence against statsmodels; what its verdicts and its power mean is told by other tests here."""

import numpy as np
import pytest
from statsmodels.stats.weightstats import ttost_ind, ttost_paired

from stages.science.statistics.equivalence import judge_equivalence, judge_paired_equivalence
from stages.science.statistics.power import power_of_equivalence, power_of_paired_equivalence


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_groups_agree_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 9), generator.normal(1.2, 0.6, 6)
    told = judge_equivalence(first, second, margin)
    assert told.p_tost == pytest.approx(ttost_ind(first, second, -margin, margin, usevar="unequal")[0], rel=1e-9)
    spreads = first.std(ddof=1), second.std(ddof=1)
    assert told.power == pytest.approx(power_of_equivalence(margin, *spreads, 9, 6), abs=1e-12)
    assert told.margin == margin


@pytest.mark.parametrize("margin", [0.1, 0.5, 2.0])
def test_pairs_agree_with_statsmodels(generator, margin):
    first, second = generator.normal(1.0, 0.3, 8), generator.normal(1.2, 0.3, 8)
    told = judge_paired_equivalence(first, second, margin)
    assert told.p_tost == pytest.approx(ttost_paired(first, second, -margin, margin)[0], rel=1e-9)
    spread = np.std(first - second, ddof=1)
    assert told.power == pytest.approx(power_of_paired_equivalence(margin, spread, 8), abs=1e-12)


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
