"""The hyperprior analysis against SciPy and statsmodels, with planted verdicts, and the stage on a small bank."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.weightstats import ttost_ind, ttost_paired

from pipeline.context import Context
from stages.paper import hyperprior_sensitivity as module
from stages.paper.hyperprior_sensitivity import add_average, change_prior, compare_settings
from stages.science.figures.experiments import draw_sensitivity
from stages.science.gp.hyperprior import Hyperprior
from tests.planted import assert_holm
from tests.science.muscle_models.data import HYPERPARAMETERS, LOOP, MUSCLES, make_bank, make_tables
from tests.studies import PickledContext, run_alone, stop_after

SECTION = {
    "mean_shifts": [0.5],
    "variance_factors": [0.1],
    "experiments": 2,
    "margin": 0.005,
    "loop": {**LOOP, "trials": 2},
}
NAMES = ("pam1", "pam2", "pam3")


def make_errors(generator, costs, experiments=16, sd=0.001, shared_sd=0.0, tested_on=("bank",)):
    """Return error rates where each (kind, setting, muscle) costs so much; variances share Table 1's part."""
    settings = {("table_1", 1.0), *((kind, setting) for kind, setting, _ in costs)}
    frames = []
    for name, muscle in product(tested_on, NAMES):
        shared = 0.04 + shared_sd * generator.standard_normal(experiments)
        for kind, setting in sorted(settings):
            own = 0.04 + shared_sd * generator.standard_normal(experiments) if kind == "mean" else shared
            after = own + costs.get((kind, setting, muscle), 0.0) + sd * generator.standard_normal(experiments)
            frame = pd.DataFrame({"experiment": range(1, experiments + 1), "before": after + 0.03, "after": after})
            frames.append(frame.assign(kind=kind, setting=setting, tested_on=name, muscle=muscle))
    columns = ["kind", "setting", "experiment", "tested_on", "muscle", "before", "after"]
    return add_average(pd.concat(frames, ignore_index=True)[columns])


def everywhere(kind, setting, cost):
    return {(kind, setting, muscle): cost for muscle in NAMES}


def compared(errors, margin=0.005):
    return compare_settings(errors, margin).set_index(["kind", "setting", "tested_on", "muscle"])


@pytest.mark.parametrize("kind", ["mean", "variance"])
@pytest.mark.parametrize(
    ("cost", "sd", "verdict"),
    [
        (0.02, 0.001, "sensitive"),
        (-0.02, 0.001, "sensitive"),
        (0.0, 0.001, "insensitive"),
        (0.003, 0.0005, "sensitive within the margin"),
        (0.0, 0.05, "undecided"),
    ],
)
def test_planted_costs_turn_the_verdict(kind, cost, sd, verdict, generator):
    told = compared(make_errors(generator, everywhere(kind, 0.5, cost), sd=sd))
    assert set(told["verdict"]) == {verdict}
    assert len(told) == 4
    assert np.sign(told["difference"]).eq(np.sign(cost)).all() or not cost


def test_each_muscle_and_setting_has_its_own_verdict(generator):
    costs = {**everywhere("mean", 0.5, 0.0), **everywhere("mean", 3.0, 0.0), ("mean", 3.0, "pam2"): 0.03}
    verdicts = compared(make_errors(generator, costs, tested_on=("bank", "unseen_bank")))["verdict"]
    assert len(verdicts) == 16
    assert (verdicts.loc["mean", 0.5] == "insensitive").all()
    for tested_on in ("bank", "unseen_bank"):
        told = verdicts.loc["mean", 3.0, tested_on]
        assert told["pam2"] == told["mean"] == "sensitive"
        assert told["pam1"] == told["pam3"] == "insensitive"


def pick(errors, kind, setting, muscle):
    its = errors.query("kind == @kind and setting == @setting and muscle == @muscle")
    return its.sort_values("experiment")["after"].to_numpy()


@pytest.mark.parametrize(("kind", "setting"), [("mean", 1.0), ("variance", 0.01)])
def test_comparisons_agree_with_scipy_and_statsmodels(kind, setting, generator):
    errors = make_errors(generator, everywhere(kind, setting, 0.001), sd=0.003)
    row = compared(errors).loc[kind, setting, "bank", "pam2"]
    values = pick(errors, kind, setting, "pam2"), pick(errors, "table_1", 1.0, "pam2")
    difference = values[0] - values[1]
    assert row["difference"] == pytest.approx(difference.mean(), rel=1e-9)
    assert (row["n"], row["n_table_1"]) == (16, 16)
    if kind == "mean":
        test, tost = stats.ttest_ind(*values, equal_var=False), ttost_ind(*values, -0.005, 0.005, usevar="unequal")
        assert row["p_welch"] == pytest.approx(test.pvalue, rel=1e-9)
        assert (row["low"], row["high"]) == pytest.approx(tuple(test.confidence_interval(0.95)), rel=1e-9)
        assert np.sign(row["hedges_g"]) == np.sign(row["difference"])
        assert row[["hodges_lehmann", "rank_biserial", "p_wilcoxon"]].isna().all()
    else:
        averages = [(a + b) / 2 for i, a in enumerate(difference) for b in difference[i:]]
        tost = ttost_paired(*values, -0.005, 0.005)
        assert row["p_wilcoxon"] == pytest.approx(stats.wilcoxon(difference).pvalue, rel=1e-9)
        assert row["hodges_lehmann"] == pytest.approx(np.median(averages), rel=1e-9)
        assert row["low"] < row["hodges_lehmann"] < row["high"]
        assert row[["hedges_g", "p_welch"]].isna().all()
    assert row["p_tost"] == pytest.approx(tost[0], rel=1e-9)


def test_the_average_is_that_of_the_muscles(generator):
    errors = make_errors(generator, everywhere("mean", 1.0, 0.01))
    muscles = np.mean([pick(errors, "mean", 1.0, name) for name in NAMES], axis=0)
    np.testing.assert_allclose(pick(errors, "mean", 1.0, "mean"), muscles, rtol=1e-12)
    row = compared(errors).loc["mean", 1.0, "bank", "mean"]
    assert (row["mean"], row["before"]) == pytest.approx((muscles.mean(), muscles.mean() + 0.03))


@pytest.mark.parametrize(("kind", "p_value"), [("mean", "p_welch"), ("variance", "p_wilcoxon")])
def test_holm_counts_the_muscles_and_their_average_of_one_setting_and_test_set(kind, p_value, generator):
    costs = {**everywhere(kind, 0.5, 0.0005), **everywhere(kind, 0.1, 0.001)}
    told = compared(make_errors(generator, costs, sd=0.002, tested_on=("bank", "unseen_bank")))
    for _, family in told.groupby(["kind", "setting", "tested_on"]):
        assert_holm(family, 4, p_value)


def test_one_experiment_decides_nothing(generator):
    costs = {**everywhere("mean", 0.5, 0.02), **everywhere("variance", 0.1, 0.02)}
    told = compared(make_errors(generator, costs, experiments=1))
    assert (told["verdict"] == "undecided").all()
    assert told[["low", "p_holm", "p_tost", "power"]].isna().all(axis=None)


def test_sampled_means_are_normal_around_table_1_and_variances_are_scaled(generator):
    prior = Hyperprior(np.array([1.0, -2.0]), np.array([0.25, 4.0]))
    drawn = np.array([change_prior(prior, "mean", 3.0, generator).mean for _ in range(2000)])
    for values, mean, sd in zip(drawn.T, prior.mean, (1.5, 6.0), strict=True):
        assert stats.kstest(values, stats.norm(mean, sd).cdf).pvalue > 1e-3
        assert stats.kstest(values, stats.norm(mean, 1.2 * sd).cdf).pvalue < 1e-3
    np.testing.assert_array_equal(change_prior(prior, "mean", 3.0, generator).variance, prior.variance)
    small = change_prior(prior, "variance", 0.1, generator)
    np.testing.assert_array_equal(small.mean, prior.mean)
    np.testing.assert_allclose(small.variance, [0.025, 0.4])


def test_the_figure_has_a_point_for_each_experiment(generator):
    costs = {**everywhere("mean", 0.5, 0.02), **everywhere("variance", 0.1, 0.0)}
    errors = make_errors(generator, costs, tested_on=("bank", "unseen_bank")).query("muscle == 'mean'")
    labels = {("table_1", 1.0): "Table 1", ("mean", 0.5): "means", ("variance", 0.1): "variances"}
    first, second = draw_sensitivity(errors, labels).axes
    assert [each.get_text() for each in second.get_xticklabels()] == list(labels.values())
    points = [line for line in second.lines if line.get_linestyle() == "None"]
    its = errors.query("tested_on == 'unseen_bank' and kind == 'mean'")["after"]
    np.testing.assert_allclose(np.asarray(points[1].get_ydata(), dtype=float), 100 * its.to_numpy())
    assert len({line.get_marker() for line in points}) == 3
    assert first.get_ylabel() == "error rate, average of the muscles (%)"


def run(folder, tables, context=PickledContext, **section):
    cfg = module.Config(hyperprior_sensitivity=module.HyperpriorSensitivity(**{**SECTION, **section}), seed=0)
    return list(run_alone(module.hyperprior_sensitivity, cfg, folder, tables, context=context).values())


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    generator = np.random.default_rng(3)
    tables = {**make_tables(generator), "unseen_bank": make_bank(generator, movements=2)}
    folder = tmp_path_factory.mktemp("sensitivity")
    priors, errors, comparison = run(folder, tables, Context)
    return SimpleNamespace(tables=tables, folder=folder, priors=priors, errors=errors, comparison=comparison)


def test_the_stage_tells_every_setting_and_experiment(small):
    assert len(small.errors) == 3 * 2 * 2 * len(MUSCLES)
    assert len(small.comparison) == 2 * 2 * (len(MUSCLES) + 1)
    assert len(small.priors) == 3 * 2 * len(MUSCLES) * len(HYPERPARAMETERS)
    assert list(small.errors["kind"].unique()) == ["table_1", "mean", "variance"]
    assert (small.folder / "figures" / "hyperprior_sensitivity.png").exists()


def test_every_experiment_has_means_of_its_own_and_variances_keep_those_of_table_1(small):
    keys = ["muscle", "hyperparameter"]
    table_1 = small.tables["hyperprior"].set_index(keys)
    for (kind, setting, _), its in small.priors.groupby(["kind", "setting", "experiment"]):
        same = its.set_index(keys).loc[table_1.index]
        assert (same["mean"] == table_1["mean"]).all() == (kind != "mean")
        factor = setting if kind == "variance" else 1.0
        np.testing.assert_allclose(same["variance"], factor * table_1["variance"])
    sampled = small.priors[small.priors["kind"] == "mean"]
    assert sampled["mean"].nunique() == len(sampled)


def test_a_variance_factor_of_nearly_one_is_table_1_again_and_sampled_means_are_another_group(small, tmp_path):
    _, errors, _ = run(tmp_path, small.tables, variance_factors=[1 - 1e-9], mean_shifts=[1e-9], experiments=1)
    of = {kind: its["after"].to_numpy() for kind, its in errors.groupby("kind")}
    np.testing.assert_allclose(of["variance"], of["table_1"], rtol=1e-4)
    assert np.abs(of["mean"] / of["table_1"] - 1).min() > 1e-4


def test_settings_do_not_depend_on_the_others_and_the_unseen_bank_may_be_absent(small, tmp_path):
    tables = {name: table for name, table in small.tables.items() if name != "unseen_bank"}
    _, errors, comparison = run(tmp_path, tables, mean_shifts=[2.0, 0.5], experiments=1)
    assert set(comparison["tested_on"]) == {"bank"}
    same = small.errors.query("experiment < 2 and tested_on == 'bank'").reset_index(drop=True)
    ours = errors.query("setting != 2.0").reset_index(drop=True)
    pd.testing.assert_frame_equal(ours, same)


def test_a_killed_run_goes_on_and_a_copy_in_another_process_finds_the_same(small, tmp_path, monkeypatch):
    def begin():
        return run(tmp_path, small.tables, experiments=1)

    stop_after(monkeypatch, 1, begin)
    (landed,) = (tmp_path / "parts" / "hyperprior_sensitivity").iterdir()
    made = landed.stat().st_mtime_ns
    priors, errors, _ = begin()
    assert landed.stat().st_mtime_ns == made
    for found, whole in ((priors, small.priors), (errors, small.errors)):
        pd.testing.assert_frame_equal(found, whole.query("experiment == 1").reset_index(drop=True))
