"""Comparisons of arms and of participants against SciPy and statsmodels, with verdicts that planted data turn."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.weightstats import ttost_ind

from stages.identification.comparison import (
    advise,
    describe_final_errors,
    describe_learning,
    keep_common,
    pair_arms,
    summarise,
)
from stages.identification.participant_differences import compare_participants
from stages.science.muscle_models.error_rates import add_average
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
    ("means", "verdict", "found", "advised"),
    [
        (
            {"y_y": 0.03, "variance": 0.04, "random": 0.04},
            "design better",
            "With trajectories chosen at random they end at 4 %: the design (y/y) is better by 1 point (95 % interval",
            [],
        ),
        (
            {"y_y": 0.04, "variance": 0.031, "random": 0.03},
            "control better",
            "With trajectories chosen at random they end at 3 %, which is better by 0.99 points",
            ["Choose by random: python -m pipeline ARGUMENTS active_loop.utility=random"],
        ),
        (
            {"y_y": 0.04, "variance": 0.04, "random": 0.04},
            "undecided",
            "Not told apart from trajectories chosen by variance (",
            ["More experiments show whether y/y or variance or random is better"],
        ),
    ],
)
def test_planted_data_turn_verdict_finding_and_advice(means, verdict, found, advised, generator):
    curve = make_curve(generator, means, sd=0.0002)
    told = pair_arms(curve, ARMS, [None])
    assert (told["verdict"] == verdict).all()
    muscles = list(curve["muscle"].unique())
    summary = summarise(curve, ["bank"], ARMS, muscles)
    final = describe_final_errors(summary, ["bank"], ARMS, muscles)
    sentences = describe_learning(final, summary[summary["muscle"] == "mean"], told, ["bank"], "y_y")
    assert f"the models err by {100 * means['y_y']:.2g} %" in sentences[0]
    assert any(found in each for each in sentences)
    ended = final.assign(trials=final["arm"].map({"y_y": 1.25, "variance": 2.0, "random": 1.5}))
    early = " ".join(describe_learning(ended, summary[summary["muscle"] == "mean"], told, ["bank"], "y_y"))
    assert early.startswith("After 1.2 designed trials on average the models err")
    assert f"{100 * means['random']:.2g} % after 1.5 trials on average" in early
    assert f"{100 * means['variance']:.2g} % after 2 trials" in early
    *first, last = advise(told, "bank", ARMS)
    assert [each[: len(words)] for each, words in zip(first, advised, strict=True)] == advised
    assert last.endswith("python -m pipeline experiment=naming")


def check_families(compare, curve, sizes, n, rows, p_value):
    """Check that each size and test set is a family of its own; return the comparison of all that there are."""
    told = compare(curve, [4, None, 99])
    assert told.groupby(["tested_on", n]).size().to_dict() == {
        (name, size): rows for name in ("bank", "unseen_bank") for size in sizes
    }
    for _, family in told.groupby(["tested_on", n]):
        assert_holm(family, rows, p_value)
    few = compare(curve[(curve["experiment"] <= 4) & (curve["tested_on"] == "bank")], [None])
    its = told[(told[n] == sizes[0]) & (told["tested_on"] == "bank")]
    pd.testing.assert_frame_equal(its.reset_index(drop=True), few)
    return told


def test_each_size_and_test_set_is_a_family_of_arms(generator):
    means = {"y_y": 0.036, "variance": 0.0362, "random": 0.0364}
    curve = make_curve(generator, means, experiments=10, tests=("bank", "unseen_bank"))
    check_families(lambda its, sizes: pair_arms(its, ARMS, sizes), curve, (8, 20), "n", 4, "p_t")


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


def test_without_controls_there_is_nothing_to_compare(generator):
    told = pair_arms(make_curve(generator, {"y_y": 0.036}), ["y_y"], [None])
    assert told.empty
    assert len(advise(told, "bank", ["y_y"])) == 1


def make_people(generator, means, experiments=8, sd=0.002):
    """Return error rates of each participant around a mean of their own, with their average over muscles."""
    return add_average(make_curve(generator, {"y_y": 0.0}, experiments, sd, ("bank",), tuple(means), 0.05, means))


def compare_people(curve, sizes=(None,), margin=0.01):
    return compare_participants(curve, list(curve["participant"].unique()), ["mean", "pam1", "pam2"], margin, sizes)


def test_participants_are_compared_as_by_scipy_and_statsmodels_on_the_last_trial(generator):
    curve = make_people(generator, {"p1": 0.036, "p2": 0.039})
    told = compare_people(curve).set_index(["first", "second", "muscle"])
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
def test_planted_data_turn_the_verdict_on_participants(means, sd, margin, verdict, generator):
    told = compare_people(make_people(generator, means, sd=sd), margin=margin)
    assert (told["verdict"] == verdict).all()


def test_each_size_and_test_set_is_a_family_of_participants(generator):
    curve = make_people(generator, {"p1": 0.036, "p2": 0.037, "p3": 0.038})
    both = pd.concat([curve, curve.assign(tested_on="unseen_bank", error_rate=curve["error_rate"] + 0.01)])
    told = check_families(compare_people, both, (4, 8), "n_first", 9, "p_welch")
    seen, unseen = (told[(told["tested_on"] == name) & (told["n_first"] == 8)] for name in ("bank", "unseen_bank"))
    np.testing.assert_allclose(unseen["first_mean"], seen["first_mean"] + 0.01)
    np.testing.assert_allclose(unseen["p_welch"], seen["p_welch"])


def test_one_experiment_decides_nothing_and_one_person_has_no_row(generator):
    told = compare_people(make_people(generator, {"p1": 0.03, "p2": 0.06}, experiments=1))
    assert (told["verdict"] == "undecided").all()
    assert told[["low", "p_welch", "p_tost", "power", "n_needed"]].isna().all(axis=None)
    assert compare_people(make_people(generator, {"p1": 0.03})).empty
