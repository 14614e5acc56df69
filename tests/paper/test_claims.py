"""Every verdict turns with planted data, either way; statistics are those of SciPy and statsmodels."""

import re
from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from stages.identification.comparison import pair_arms
from stages.identification.participant_differences import compare_participants
from stages.paper.baselines import compare_family
from stages.paper.claims import CLAIMS, PAPER, claims
from stages.science.muscle_models.error_rates import add_average
from tests.planted import make_curve


def make_baseline(generator, mean, name="linear", sd=0.001):
    names = ["baseline", "participant", "experiment", "trial", "tested_on", "muscle"]
    keys = product([name], ["nobody"], range(1, 7), (1, 2), ["bank"], ("pam1", "pam2"))
    curve = pd.DataFrame(list(keys), columns=names)
    return curve.assign(error_rate=mean + sd * generator.standard_normal(len(curve)))


def judged(**tables):
    """Return verdicts by claim and setting."""
    frame, told = claims.function(cfg=None, ctx=None, **tables)
    checked = CLAIMS.check(frame, "test")
    counts = re.findall(r"(\d+) of the paper", " ".join(told["sentence"]))
    assert sum(map(int, counts)) == frame["claim"].nunique()
    return checked.set_index(["claim", "setting"])


@pytest.mark.parametrize(
    ("end", "sd", "verdict", "word"),
    [
        (0.03, 0.001, "holds", "shown"),
        (0.09, 0.001, "does not hold", "opposite"),
        (0.07, 0.02, "does not hold", "no difference was found"),
    ],
)
def test_error_falls_or_rises_or_neither_is_shown(end, sd, verdict, word, generator):
    curve = make_curve(generator, {"y_y": end}, 6, sd=sd)
    row = judged(learning_curve=curve).loc[("error_falls", "")]
    assert row["verdict"] == verdict
    assert word in row["finding"]
    means = curve.groupby(["participant", "experiment", "trial"])["error_rate"].mean().unstack("trial")
    expected = stats.ttest_rel(means[2], means[0])
    assert row["p"] == pytest.approx(expected.pvalue, rel=1e-6)
    assert (row["low"], row["high"]) == pytest.approx(tuple(expected.confidence_interval()), rel=1e-9)
    assert row["n"] == 12


@pytest.mark.parametrize(("baseline", "verdict"), [(0.06, "holds"), (0.01, "does not hold")])
def test_baselines_are_worse_or_better(baseline, verdict, generator):
    curve = pd.concat([make_baseline(generator, baseline), make_baseline(generator, baseline, "sparse_gp")])
    compared = compare_family(make_curve(generator, {"y_y": 0.03}, 6), curve, ["pam1", "pam2"], "bank")
    told = judged(baseline_comparison=compared)
    names = ["beats_linear", "beats_linear_all_along", "beats_sparse_gp"]
    assert list(told.index.get_level_values(0)) == names
    assert (told["verdict"] == verdict).all()
    assert (told["n"] == 6).all()


@pytest.mark.parametrize(
    ("offset", "sd", "verdict", "word"),
    [
        (0.0, 0.001, "holds", "equivalent"),
        (0.03, 0.001, "does not hold", "matters"),
        (0.0, 0.05, "does not hold", "undecided"),
        (0.004, 0.0005, "holds", "less than the margin"),
    ],
)
def test_participants_are_comparable_or_not(offset, sd, verdict, word, generator):
    curve = add_average(make_curve(generator, {"y_y": 0.03}, 6, sd=sd, offsets={"p2": offset}))
    compared = compare_participants(curve, ["p1", "p2"], ["mean", "pam1"], 0.01, [2, None])
    row = judged(participant_comparison=compared).loc[("participants_alike", "p1, p2")]
    assert (row["verdict"], row["n"]) == (verdict, 6)
    assert word in row["finding"]


@pytest.mark.parametrize(("random", "verdict"), [(0.04, "holds"), (0.02, "does not hold"), (0.03, "does not hold")])
def test_choices_tell_more_or_less_than_random_ones(random, verdict, generator):
    compared = pair_arms(make_curve(generator, {"y_y": 0.03, "random": random}, 6), ["y_y", "random"], [2, None])
    told = judged(paired_comparison=compared)
    assert (told["verdict"] == verdict).all()
    assert (told["n"] == 12).all()


def make_shift(difference, p_holm, p_tost, measure):
    row = {"amplitude_s": 0.3, "tested_on": "bank", "measure": measure, "n": 20, "difference": difference}
    row |= {"low": difference - 0.001, "high": difference + 0.002, "d_z": 2.0, "p_holm": p_holm}
    return pd.DataFrame([row | {"p_tost": p_tost, "margin": 0.005}])


@pytest.mark.parametrize(
    ("p_holm", "p_tost", "verdict"),
    [(0.5, 0.01, "holds"), (0.01, 0.01, "holds"), (0.01, 0.5, "does not hold"), (0.5, 0.5, "does not hold")],
)
def test_a_shift_matters_or_not(p_holm, p_tost, verdict):
    told = judged(shift_comparison=make_shift(0.002, p_holm, p_tost, "final"))
    assert tuple(told.loc[("robust_to_shift", "up to 0.3 s"), ["verdict", "p"]]) == (verdict, p_tost)


@pytest.mark.parametrize(
    ("difference", "p_holm", "verdict"),
    [(0.004, 0.01, "holds"), (0.004, 0.2, "does not hold"), (-0.004, 0.01, "does not hold")],
)
def test_no_shift_is_best_or_not(difference, p_holm, verdict):
    told = judged(shift_comparison=make_shift(difference, p_holm, np.nan, "curve"))
    row = told.loc[("best_without_shift", "up to 0.3 s")]
    assert (row["verdict"], row["p"]) == (verdict, p_holm)
    assert row["estimate"] == pytest.approx(-difference)
    assert row["low"] <= row["estimate"] <= row["high"]
    assert row["effect"] == -2.0


def make_sensitivity(kind, p_holms, p_tosts):
    row = {"kind": kind, "setting": 0.5, "tested_on": "bank", "n": 20, "difference": 0.001, "low": -0.001}
    row |= {"high": 0.003, "hodges_lehmann": 0.002, "hedges_g": 0.2, "rank_biserial": 0.3, "margin": 0.005}
    judged = zip(("pam1", "pam2", "mean"), p_holms, p_tosts, strict=True)
    return pd.DataFrame([row | {"muscle": muscle, "p_holm": holm, "p_tost": tost} for muscle, holm, tost in judged])


@pytest.mark.parametrize("kind", ["mean", "variance"])
@pytest.mark.parametrize(
    ("p_holms", "p_tosts", "verdict", "p"),
    [
        ((0.5, 0.5, 0.5), (0.01, 0.03, 0.9), "holds", 0.03),
        ((0.5, 0.5, 0.5), (0.01, 0.2, 0.01), "does not hold", 0.2),
        ((0.01, 0.5, 0.5), (0.2, 0.01, 0.01), "does not hold", 0.2),
        ((0.01, 0.5, 0.5), (0.02, 0.01, 0.9), "holds", 0.02),
        ((0.5, 0.5, 0.5), (np.nan, 0.01, 0.01), "not tested", np.nan),
    ],
)
def test_priors_matter_if_one_muscle_says_so(kind, p_holms, p_tosts, verdict, p):
    told = judged(sensitivity_comparison=make_sensitivity(kind, p_holms, p_tosts))
    (row,) = told.reset_index().to_dict("records")
    assert row["claim"] == {"mean": "robust_to_prior_means", "variance": "robust_to_prior_spread"}[kind]
    assert row["verdict"] == verdict
    assert row["p"] == pytest.approx(p, nan_ok=True)
    assert ("matters to pam1" in row["finding"]) == (p_holms[0] < 0.05)
    assert row["estimate"] == (0.001 if kind == "mean" else 0.002)
    least = "pam1" if not p_tosts[0] < p_tosts[1] else "pam2"
    assert f"of {least}, least surely" in row["statistic"]


@pytest.mark.parametrize(("p_holm", "verdict"), [(0.0001, "holds"), (0.3, "does not hold"), (np.nan, "not tested")])
def test_choices_of_the_design_agree_or_not(p_holm, verdict):
    row = {"arm": "y_y", "n": 40, "effect": 5.0, "p_holm": p_holm}
    told = judged(choice_concentration=pd.DataFrame([row, row | {"arm": "random", "p_holm": 1 - p_holm}]))
    (found,) = told.reset_index().to_dict("records")
    assert (found["claim"], found["verdict"], found["n"]) == ("choices_agree", verdict, 40)


@pytest.mark.parametrize(
    ("difference", "p_holm", "verdict"),
    [(-0.01, 0.001, "holds"), (0.01, 0.001, "does not hold"), (-0.01, 0.3, "does not hold")],
)
def test_a_sparse_model_gains_or_not(difference, p_holm, verdict):
    row = {"question": "keeping all samples", "measure": "final", "tested_on": "bank", "first": "sparse y_y"}
    row |= {"second": "exact y_y", "n": 8, "difference": difference, "low": difference - 0.001}
    row |= {"high": difference + 0.001, "d_z": -1.0, "p_holm": p_holm}
    others = [row | {"first": "sparse random", "p_holm": 1.0}, row | {"measure": "curve"}]
    told = judged(sparse_comparison=pd.DataFrame([row, *others]))
    (found,) = told.reset_index().to_dict("records")
    assert (found["claim"], found["verdict"]) == ("sparse_model_gains", verdict)


@pytest.mark.parametrize(("real", "verdict"), [(False, "not testable in simulation"), (True, "holds")])
def test_a_real_robot_is_judged_where_one_was_there(real, verdict, generator):
    rig = pd.DataFrame({"rig": ["Any"], "real": [real], "sampling_rate_hz": [250.0]})
    told = judged(executed_by=rig, learning_curve=make_curve(generator, {"y_y": 0.03}, 6))
    assert told.loc[("works_on_real_robot", ""), "verdict"] == verdict
    worse = judged(executed_by=rig, learning_curve=make_curve(generator, {"y_y": 0.09}, 6))
    assert worse.loc[("works_on_real_robot", ""), "verdict"] == ("does not hold" if real else verdict)


def test_one_experiment_shows_nothing(generator):
    curve = make_curve(generator, {"y_y": 0.03}, experiments=1, people=("p1",))
    row = judged(learning_curve=curve).loc[("error_falls", "")]
    assert (row["verdict"], row["n"]) == ("not tested", 1)
    assert "too few" in row["finding"]
    assert np.isnan(row["p"])


def test_a_claim_without_a_comparison_is_told_as_not_tested(generator):
    rig = pd.DataFrame({"rig": ["Any"], "real": [False], "sampling_rate_hz": [250.0]})
    told = judged(executed_by=rig, learning_curve=make_curve(generator, {"y_y": 0.03}, 6)).reset_index()
    assert set(told["claim"]) == set(PAPER)
    others = told[~told["claim"].isin(["error_falls", "works_on_real_robot"])]
    assert (others["verdict"] == "not tested").all()
    assert (others["n"] == 0).all()


def test_amplitudes_that_nearly_agree_are_told_apart():
    both = pd.concat([make_shift(0.002, 0.5, 0.01, "final").assign(amplitude_s=a) for a in (0.1, 0.1000001)])
    assert list(judged(shift_comparison=both).index.get_level_values(1)) == ["up to 0.1 s", "up to 0.1000001 s"]


def test_a_workflow_without_comparisons_has_no_claims():
    assert all(each.empty for each in claims.function(cfg=None, ctx=None))
