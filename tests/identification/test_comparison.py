"""The comparison of arms against SciPy, with verdicts and advice that planted data turn either way."""

import pandas as pd
import pytest

from stages.identification.comparison import describe_final_errors, keep_common, pair_arms, recommend, summarise
from tests.planted import assert_holm, assert_paired, make_curve, values_of

ARMS = ["y_y", "variance", "random"]


def test_agrees_with_scipy_over_all_experiments(generator):
    curve = make_curve(generator, {"y_y": 0.036, "variance": 0.0365, "random": 0.037})
    told = pair_arms(curve, ARMS, [None]).set_index(["measure", "control"]).loc[("final", "random")]
    assert_paired(told, *(values_of(curve[curve["arm"] == arm]) for arm in ("y_y", "random")))


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
        assert_holm(family, 4)
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
    final = describe_final_errors(summary, ["bank"], ["y_y", "random"], ["pam1", "pam2"]).set_index(["muscle", "arm"])
    assert final.loc[("mean", "random"), "after"] == pytest.approx(values_of(common[common["arm"] == "random"]).mean())
    assert final.loc[("mean", "random"), "before"] == pytest.approx(0.07)


def test_without_controls_there_is_nothing_to_compare_or_advise(generator):
    told = pair_arms(make_curve(generator, {"y_y": 0.036}), ["y_y"], [None])
    assert told.empty
    assert recommend(told, "y_y").empty
