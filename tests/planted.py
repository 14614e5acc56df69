"""Error rates around planted means, and what SciPy, statsmodels and the definition say of a comparison of them."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.weightstats import ttost_paired


def make_curve(
    generator, arms, experiments=4, sd=0.001, tests=("bank",), people=("p1", "p2"), start=0.07, offsets=None
):
    """Return error rates that fall from `start`, before the first trial, to a mean of each arm's own."""
    names = ["participant", "experiment", "arm", "trial", "tested_on", "muscle"]
    keys = product(people, range(1, experiments + 1), arms, range(3), tests, ("pam1", "pam2"))
    curve = pd.DataFrame(list(keys), columns=names)
    means = np.where(curve["trial"] == 0, start, curve["arm"].map(arms))
    noise = sd * generator.standard_normal(len(curve)) * (curve["trial"] > 0)
    return curve.assign(error_rate=means + noise + curve["participant"].map(offsets or {}).fillna(0.0))


def values_of(curve, measure="final"):
    """Return each experiment's error rate, averaged over muscles: after the last trial, or over all designed ones."""
    its = curve[curve["trial"] == 2] if measure == "final" else curve[curve["trial"] > 0]
    return its.groupby(["participant", "experiment"])["error_rate"].mean().to_numpy()


def assert_paired(row, first, second, margin=None):
    """Check a row of a paired comparison against SciPy, and its equivalence against statsmodels."""
    expected, difference = stats.ttest_rel(first, second), first - second
    assert (row["n"], row["wins"]) == (len(first), (first < second).sum())
    assert row["p_t"] == pytest.approx(expected.pvalue, rel=1e-9)
    assert (row["low"], row["high"]) == pytest.approx(tuple(expected.confidence_interval(0.95)), rel=1e-9)
    assert row["p_wilcoxon"] == pytest.approx(stats.wilcoxon(difference).pvalue, rel=1e-9)
    assert row["d_z"] == pytest.approx(difference.mean() / difference.std(ddof=1), rel=1e-9)
    if margin is not None:
        assert row["p_tost"] == pytest.approx(ttost_paired(first, second, -margin, margin)[0], rel=1e-9)


def assert_holm(family, count, p_value="p_t"):
    """Check that a family of so many rows is adjusted by Holm's rule over all of them."""
    assert len(family) == count
    steps = np.maximum.accumulate(np.sort(family[p_value]) * np.arange(count, 0, -1))
    np.testing.assert_allclose(np.sort(family["p_holm"]), np.minimum(1.0, steps), rtol=1e-12)
