"""The comparison of participants against SciPy and statsmodels, with verdicts that planted data turn either way."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.weightstats import ttost_ind

from stages.identification.participant_differences import compare_participants
from stages.science.muscle_models.error_rates import add_average
from tests import planted
from tests.planted import assert_holm

MUSCLES = ["mean", "pam1", "pam2"]


def make_curve(generator, means, experiments=8, sd=0.002):
    """Return error rates of each participant around a mean of their own, with their average over muscles."""
    curve = planted.make_curve(generator, {"y_y": 0.0}, experiments, sd, people=tuple(means), start=0.05, offsets=means)
    return add_average(curve)


def compared(curve, margin=0.01, sizes=(None,)):
    people = list(curve["participant"].unique())
    return compare_participants(curve, people, MUSCLES, margin, sizes).set_index(["first", "second", "muscle"])


def test_agrees_with_scipy_and_statsmodels_on_the_last_trial(generator):
    curve = make_curve(generator, {"p1": 0.036, "p2": 0.039})
    told = compared(curve)
    row = told.loc[("p1", "p2", "pam1")]
    last = curve[(curve["trial"] == 2) & (curve["muscle"] == "pam1")]
    first, second = (last.loc[last["participant"] == who, "error_rate"].to_numpy() for who in ("p1", "p2"))
    expected = stats.ttest_ind(first, second, equal_var=False)
    assert row["p_welch"] == pytest.approx(expected.pvalue, rel=1e-9)
    assert (row["low"], row["high"]) == pytest.approx(tuple(expected.confidence_interval(0.95)), rel=1e-9)
    assert row["p_tost"] == pytest.approx(ttost_ind(first, second, -0.01, 0.01, usevar="unequal")[0], rel=1e-9)
    assert (row["n_first"], row["n_second"]) == (8, 8)
    its = curve[(curve["trial"] == 2) & (curve["muscle"] != "mean") & (curve["participant"] == "p1")]
    assert told.loc[("p1", "p2", "mean"), "first_mean"] == pytest.approx(its["error_rate"].mean(), rel=1e-12)


@pytest.mark.parametrize(
    ("means", "sd", "margin", "verdict"),
    [
        ({"p1": 0.03, "p2": 0.06}, 0.002, 0.01, "different"),
        ({"p1": 0.03, "p2": 0.03}, 0.002, 0.01, "equivalent"),
        ({"p1": 0.030, "p2": 0.036}, 0.001, 0.01, "different within the margin"),
        ({"p1": 0.03, "p2": 0.03}, 0.03, 0.01, "undecided"),
    ],
)
def test_planted_data_turn_the_verdict(means, sd, margin, verdict, generator):
    told = compared(make_curve(generator, means, sd=sd), margin)
    assert (told["verdict"] == verdict).all()


def test_each_size_and_test_set_is_a_family_of_its_own(generator):
    curve = make_curve(generator, {"p1": 0.036, "p2": 0.037, "p3": 0.038})
    both = pd.concat([curve, curve.assign(tested_on="unseen_bank", error_rate=curve["error_rate"] + 0.01)])
    told = compared(both, sizes=(4, None, 50))
    assert told.groupby(["tested_on", "n_first"]).size().to_dict() == {
        (name, n): 9 for name in ("bank", "unseen_bank") for n in (4, 8)
    }
    for _, family in told.groupby(["tested_on", "n_first"]):
        assert_holm(family, 9, "p_welch")
    few = compared(curve[curve["experiment"] <= 4])
    its = told[(told["tested_on"] == "bank") & (told["n_first"] == 4)]
    pd.testing.assert_frame_equal(its, few)
    seen, unseen = (told[(told["tested_on"] == name) & (told["n_first"] == 8)] for name in ("bank", "unseen_bank"))
    np.testing.assert_allclose(unseen["first_mean"], seen["first_mean"] + 0.01)
    np.testing.assert_allclose(unseen["p_welch"], seen["p_welch"])


def test_one_experiment_decides_nothing_and_one_person_has_no_row(generator):
    told = compared(make_curve(generator, {"p1": 0.03, "p2": 0.06}, experiments=1))
    assert (told["verdict"] == "undecided").all()
    assert told[["low", "p_welch", "p_tost", "power", "n_needed"]].isna().all(axis=None)
    assert compared(make_curve(generator, {"p1": 0.03})).empty
