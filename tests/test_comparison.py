"""The comparison of arms against SciPy, with verdicts and advice that planted data turn either way."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from stages.comparison import keep_common, pair_arms, recommend, summarise, tell_final_errors

ARMS = ["y_y", "variance", "random"]
KEYS = ["participant", "experiment", "arm", "trial", "tested_on", "muscle"]


def make_curve(generator, means, experiments=4, sd=0.001, tests=("bank",)):
    """Return error rates of each arm around a mean of its own after the first trial."""
    rows = [
        (who, experiment, arm, trial, tested_on, muscle, 0.07 if trial == 0 else mean + sd * generator.normal())
        for who in ("p1", "p2")
        for experiment in range(1, experiments + 1)
        for arm, mean in means.items()
        for trial in range(3)
        for tested_on in tests
        for muscle in ("pam1", "pam2")
    ]
    return pd.DataFrame(rows, columns=[*KEYS, "error_rate"])


def final_of(curve, arm):
    its = curve[(curve["arm"] == arm) & (curve["trial"] == curve["trial"].max())]
    return its.groupby(["participant", "experiment"])["error_rate"].mean().to_numpy()


def test_agrees_with_scipy_over_all_experiments(generator):
    curve = make_curve(generator, {"y_y": 0.036, "variance": 0.0365, "random": 0.037})
    told = pair_arms(curve, ARMS, [None]).set_index(["measure", "control"]).loc[("final", "random")]
    first, second = final_of(curve, "y_y"), final_of(curve, "random")
    expected = stats.ttest_rel(first, second)
    assert told["n"] == 8
    assert told["p_t"] == pytest.approx(expected.pvalue, rel=1e-9)
    assert (told["low"], told["high"]) == pytest.approx(tuple(expected.confidence_interval()), rel=1e-9)
    assert told["p_wilcoxon"] == pytest.approx(stats.wilcoxon(first, second).pvalue, rel=1e-9)
    assert told["d_z"] == pytest.approx((first - second).mean() / (first - second).std(ddof=1))
    assert told["wins"] == (first < second).sum()


def test_the_curve_is_averaged_over_designed_trials(generator):
    curve = make_curve(generator, {"y_y": 0.036, "random": 0.037})
    told = pair_arms(curve, ["y_y", "random"], [None]).set_index("measure").loc["curve"]
    its = curve[(curve["arm"] == "y_y") & (curve["trial"] > 0)]
    assert told["design_mean"] == pytest.approx(its["error_rate"].mean())


@pytest.mark.parametrize(
    ("means", "verdict", "recommended", "word"),
    [
        ({"y_y": 0.03, "variance": 0.04, "random": 0.04}, "design better", "y_y", "it is better than"),
        ({"y_y": 0.04, "variance": 0.031, "random": 0.03}, "control better", "random", "active_loop.utility=random"),
        ({"y_y": 0.04, "variance": 0.04, "random": 0.04}, "undecided", "y_y", "undecided against variance, random"),
    ],
)
def test_planted_data_turn_verdict_and_advice(means, verdict, recommended, word, generator):
    told = pair_arms(make_curve(generator, means, sd=0.0002), ARMS, [None])
    assert (told["verdict"] == verdict).all()
    advised = recommend(told, "y_y")
    assert list(advised["measure"]) == ["final", "curve"]
    assert (advised["recommended"] == recommended).all()
    assert advised["advice"].str.contains(word, regex=False).all()


def test_each_size_and_test_set_is_a_family_and_the_largest_advises(generator):
    means = {"y_y": 0.036, "variance": 0.0362, "random": 0.0364}
    curve = make_curve(generator, means, experiments=10, tests=("bank", "unseen_bank"))
    told = pair_arms(curve, ARMS, [4, None, 99])
    assert told.groupby(["tested_on", "n"]).size().to_dict() == {
        (name, n): 4 for name in ("bank", "unseen_bank") for n in (8, 20)
    }
    for _, family in told.groupby(["tested_on", "n"]):
        ordered = np.sort(family["p_t"])
        steps = np.minimum(1.0, np.maximum.accumulate(ordered * np.arange(4, 0, -1)))
        np.testing.assert_allclose(np.sort(family["p_holm"]), steps, rtol=1e-12)
    few = pair_arms(curve[(curve["experiment"] <= 4) & (curve["tested_on"] == "bank")], ARMS, [None])
    its = told[(told["n"] == 8) & (told["tested_on"] == "bank")].reset_index(drop=True)
    pd.testing.assert_frame_equal(its, few)
    assert (recommend(told, "y_y")["n"] == 20).all()


def test_arms_are_compared_on_the_experiments_that_all_have(generator):
    curve = make_curve(generator, {"y_y": 0.036, "random": 0.04}, experiments=6)
    fewer = curve[(curve["arm"] == "y_y") | (curve["experiment"] <= 2)]
    common = keep_common(fewer, 2)
    assert sorted(common["experiment"].unique()) == [1, 2]
    summary = summarise(common, ["bank"], ["y_y", "random"], ["pam1", "pam2"])
    assert (summary["experiments"] == 4).all()
    final = tell_final_errors(summary, ["bank"], ["y_y", "random"], ["pam1", "pam2"]).set_index(["muscle", "arm"])
    assert final.loc[("mean", "random"), "after"] == pytest.approx(final_of(common, "random").mean())
    assert final.loc[("mean", "random"), "before"] == pytest.approx(0.07)


def test_without_controls_there_is_nothing_to_compare_or_advise(generator):
    told = pair_arms(make_curve(generator, {"y_y": 0.036}), ["y_y"], [None])
    assert told.empty
    assert recommend(told, "y_y").empty
