"""Choices, forces and reliability against other libraries and the definitions, with verdicts that planted data turn."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from pipeline.errors import ConfigError
from stages.paper.learned_models import (
    CHOICE_CONCENTRATION,
    CHOSEN_OFTEN,
    COVERAGE,
    RELIABILITY,
    count_choices,
    gather,
    judge_choices,
    lay_grid,
    measure_coverage,
    tabulate_reliability,
)
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import condition
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import MODEL_INPUTS, Scaling
from tests.planted import assert_holm
from tests.science.muscle_models.data import draw, make_tables
from tests.studies import PickledContext, read_stages, run_alone, run_stage

FIRST = ["bank", "unseen_bank", "subsampling", "hyperprior", "hardware", "active_loop"]
STAGES = [*FIRST, "learned_models"]
SMALL = ("experiment=paper", "active_loop.controls=[random]", "learned_models.reliability.every=50")
MUSCLES = ["pam1", "pam2", "pam3", "pam4"]


# ---- choices


def make_trials(generator, alike, experiments=8, movements=30, trials=5, again=False):
    """Return `trials` and `initial_trials`, where an arm named in `alike` chooses among eight movements only."""
    rows, initial = [], []
    for where in product(("p1", "p2"), range(1, experiments + 1)):
        first = generator.choice(movements, 2, replace=False)
        initial += [(*where, position, int(each)) for position, each in enumerate(first, 1)]
        free = np.arange(movements) if again else np.setdiff1d(np.arange(movements), first)
        for arm in ("y_y", "random"):
            chosen = generator.choice(free[free < 8] if arm in alike else free, trials, replace=again)
            for trial, each in enumerate(chosen, 1):
                rows.append((*where, arm, trial, int(each), free.size - (0 if again else trial - 1)))
    who = ["participant", "experiment"]
    return (
        pd.DataFrame(rows, columns=[*who, "arm", "trial", "trajectory", "available"]),
        pd.DataFrame(initial, columns=[*who, "position", "trajectory"]),
    )


@pytest.mark.parametrize("alike", [(), ("y_y",), ("random",), ("y_y", "random")])
@pytest.mark.parametrize("again", [False, True])
def test_planted_choices_turn_the_verdict(alike, again, generator):
    trials, initial = make_trials(generator, alike, again=again)
    told = judge_choices(trials, initial, list(range(30)), 2000, SimpleNamespace(generator=draw))
    told = CHOICE_CONCENTRATION.check(told, "test").set_index("arm")
    for arm in ("y_y", "random"):
        assert told.loc[arm, "verdict"] == ("concentrated" if arm in alike else "as at random")
        assert (told.loc[arm, "dispersion"] > told.loc[arm, "high"]) == (arm in alike)
    assert (told["n"] == 16).all()
    assert (told["trials"] == 80).all()
    first, second = np.sort(told["p"])
    np.testing.assert_allclose(np.sort(told["p_holm"]), [min(1, 2 * first), min(1, max(2 * first, second))])
    assert told["p"].min() >= 1 / 2001


def test_initial_trials_cannot_be_chosen_and_are_not_expected(generator):
    trials, initial = make_trials(generator, ())
    told = judge_choices(trials, initial, list(range(30)), 100, SimpleNamespace(generator=draw)).set_index("arm")
    excluded = initial["trajectory"].value_counts().reindex(range(30), fill_value=0).to_numpy()
    expected = (16 - excluded) * 5 / 28
    counts = trials.query("arm == 'y_y'")["trajectory"].value_counts().reindex(range(30), fill_value=0).to_numpy()
    assert told.loc["y_y", "dispersion"] == pytest.approx(((counts - expected) ** 2 / expected).sum())


def test_counts_are_those_of_the_trials(generator):
    trials, _ = make_trials(generator, ("y_y",), again=True)
    told = CHOSEN_OFTEN.check(count_choices(trials, list(range(30))), "test")
    for arm, its in told.groupby("arm"):
        chosen = trials[trials["arm"] == arm]
        assert its["times"].sum() == len(chosen)
        assert its["times"].is_monotonic_decreasing
        top = its.iloc[0]
        rows = chosen[chosen["trajectory"] == top["trajectory"]]
        assert top["times"] == len(rows)
        assert top["share"] == pytest.approx(len(rows.drop_duplicates(["participant", "experiment"])) / 16)
        assert list(its["rank"]) == list(stats.rankdata(-its["times"], method="min"))
        assert sorted(its["trajectory"]) == list(range(30))
    assert (told["experiments"] == 16).all()


# ---- reliability


def predict_by_sklearn(x, y, theta, at):
    """Return mean and SD of the noise-free output by scikit-learn."""
    kernel = ConstantKernel(np.exp(2 * theta[3])) * RBF(np.exp(theta[:3]))
    gp = GaussianProcessRegressor(kernel, alpha=np.exp(2 * theta[4]), optimizer=None).fit(x, y)
    return gp.predict(at, return_std=True)


def marginalise_by_sklearn(x, y, theta, covariance, at, step=1e-4):
    """Return the marginal GP's SD with slopes by finite differences."""
    _, sd = predict_by_sklearn(x, y, theta, at)
    slopes = []
    for index in range(theta.size):
        shift = step * np.eye(theta.size)[index]
        high, low = (predict_by_sklearn(x, y, theta + sign * shift, at) for sign in (1, -1))
        slopes.append([(high[0] - low[0]) / (2 * step), (high[1] ** 2 - low[1] ** 2) / (2 * step)])
    mean, variance = np.moveaxis(np.array(slopes), 1, 0)
    through = [np.einsum("ib,ij,jb->b", each, covariance, each) for each in (mean, variance)]
    return np.sqrt(4 / 3 * sd**2 + through[0] + through[1] / (3 * sd**2))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """All tables of a tiny study."""
    folder = tmp_path_factory.mktemp("study")
    configured, stages = read_stages(STAGES, *SMALL)
    tables = {}
    for name in FIRST:
        tables.update(run_stage(configured, stages[name], folder, tables, context=PickledContext))
    tables.update(run_stage(configured, stages["learned_models"], folder, tables))
    return SimpleNamespace(configured=configured, stages=stages, tables=tables, folder=folder)


def model_of(tables, muscle, trial, arm="y_y"):
    """Return data, theta and S of a model, from the tables and the library."""
    chosen = "muscle == @muscle and arm == @arm"
    theta = tables["models"].query(f"{chosen} and trial == @trial")["value"].to_numpy()
    points = tables["points"].query(f"{chosen} and trial <= @trial")
    scaling = Scaling.of_muscle(tables["scaling"], muscle)
    rows = tables["hyperprior"].query("muscle == @muscle")
    x, y = scaling.inputs_of(points), scaling.output_of(points)
    gp = condition(x, y, theta, Hyperprior(rows["mean"].to_numpy(), rows["variance"].to_numpy()))
    return x, y, theta, gp.laplace.covariance, scaling


@pytest.mark.parametrize(("muscle", "trial", "tested_on"), [("pam1", 3, "unseen_bank"), ("pam3", 0, "bank")])
def test_shares_and_widths_are_those_of_scikit_learn(study, muscle, trial, tested_on):
    x, y, theta, covariance, scaling = model_of(study.tables, muscle, trial)
    test = leave_out_lead_in(study.tables[tested_on]).query("muscle == @muscle")
    test = test[(test.groupby("trajectory").cumcount() % 50 == 0).to_numpy()]
    at, force = scaling.inputs_of(test), test["force_n"].to_numpy()
    mean, plain = predict_by_sklearn(x, y, theta, at)
    sds = {"plain": plain, "marginal": marginalise_by_sklearn(x, y, theta, covariance, at)}
    rows = study.tables["coverage"].query(
        "muscle == @muscle and trial == @trial and arm == 'y_y' and tested_on == @tested_on"
    )
    assert len(rows) == 2
    for _, row in rows.iterrows():
        half = 1.959963984540054 * scaling.force_scale_n * np.sqrt(sds[row["model"]] ** 2 + np.exp(2 * theta[4]))
        inside = np.abs(force - scaling.restore_force(mean)) <= half
        by_movement = pd.Series(inside).groupby(test["trajectory"].to_numpy()).mean()
        assert row["share"] == pytest.approx(inside.mean(), abs=1.5 / inside.size)
        assert row["half_width_n"] == pytest.approx(half.mean(), rel=1e-4)
        assert (row["samples"], row["trajectories"]) == (inside.size, by_movement.size)
        if by_movement.std():
            low, high = stats.t.interval(0.95, 7, by_movement.mean(), stats.sem(by_movement))
            assert (row["low"], row["high"]) == pytest.approx((max(low, 0), min(high, 1)), abs=0.02)


def plant(generator, plain, marginal, experiments=6, sd=0.01, tests=("bank",), arms=("y_y",)):
    """Return `coverage` with shares around a mean of each model's own."""
    means, widths = {"plain": plain, "marginal": marginal}, {"plain": 10.0, "marginal": 12.5}
    keys = product(("p1", "p2"), range(1, experiments + 1), arms, (0, 5), tests, ("pam1", "pam2"), means)
    frame = pd.DataFrame(list(keys), columns=list(COVERAGE.columns)[:7]).assign(samples=1000, trajectories=40)
    shares = frame["model"].map(means) + sd * generator.standard_normal(len(frame))
    half_width_n = frame["model"].map(widths)
    frame = frame.assign(share=shares.clip(0, 1), low=np.nan, high=np.nan, half_width_n=half_width_n)
    return COVERAGE.check(frame[list(COVERAGE.columns)], "test")


def calibrated(coverage):
    return RELIABILITY.check(tabulate_reliability(coverage, ["pam1", "pam2"]), "test")


@pytest.mark.parametrize(
    ("plain", "marginal", "sd", "verdict"),
    [
        (0.80, 0.92, 0.01, "marginal closer"),
        (0.94, 0.999, 0.005, "plain closer"),
        (0.99, 0.91, 0.0001, "undecided"),
        (0.80, 0.81, 0.05, "undecided"),
    ],
)
def test_planted_shares_turn_the_verdict(plain, marginal, sd, verdict, generator):
    told = calibrated(plant(generator, plain, marginal, sd=sd))
    assert (told["verdict"] == verdict).all()
    assert (told["n"] == 12).all()
    assert list(told["muscle"].unique()) == ["mean", "pam1", "pam2"]
    np.testing.assert_allclose(told["wider"], 1.25)


def average(frame, trial):
    """Return each experiment's average over muscles."""
    return frame.xs(trial, level="trial").groupby(["participant", "experiment"]).mean()


def test_agrees_with_scipy(generator):
    coverage = plant(generator, 0.90, 0.915, sd=0.03)
    told = calibrated(coverage).set_index(["muscle", "trial"])
    wide = coverage.pivot(index=["muscle", "trial", "participant", "experiment"], columns="model", values="share")
    gaps = (wide - 0.95).abs()
    for key in (("pam2", 5), ("mean", 0)):
        its, shares = (average(each, key[1]) if key[0] == "mean" else each.loc[key] for each in (gaps, wide))
        row = told.loc[key]
        test = stats.ttest_rel(its["marginal"], its["plain"])
        assert row["p_t"] == pytest.approx(test.pvalue, rel=1e-9)
        assert (row["low"], row["high"]) == pytest.approx(tuple(test.confidence_interval(0.95)), rel=1e-9)
        assert row["p_wilcoxon"] == pytest.approx(stats.wilcoxon(its["marginal"], its["plain"]).pvalue, rel=1e-9)
        assert (row["plain_gap"], row["marginal_gap"]) == pytest.approx((its["plain"].mean(), its["marginal"].mean()))
        for model in ("plain", "marginal"):
            ends = stats.t.interval(0.95, 11, shares[model].mean(), stats.sem(shares[model]))
            assert row[f"{model}_share"] == pytest.approx(shares[model].mean())
            assert (row[f"{model}_low"], row[f"{model}_high"]) == pytest.approx(ends)


def test_each_arm_and_test_set_is_a_family(generator):
    coverage = plant(generator, 0.93, 0.94, tests=("bank", "unseen_bank"), arms=("y_y", "random"))
    told = calibrated(coverage)
    assert told.groupby(["arm", "tested_on"]).size().to_dict() == {
        (arm, name): 6 for arm in ("y_y", "random") for name in ("bank", "unseen_bank")
    }
    for _, family in told.groupby(["arm", "tested_on"]):
        assert_holm(family, 6)


def test_one_experiment_decides_nothing(generator):
    coverage = plant(generator, 0.80, 0.95)
    told = calibrated(coverage[(coverage["experiment"] == 1) & (coverage["participant"] == "p1")])
    assert (told["verdict"] == "undecided").all()
    assert told[["low", "high", "d_z", "p_t", "p_wilcoxon", "p_holm", "plain_low"]].isna().all(axis=None)


# ---- forces


@pytest.mark.parametrize("muscle", ["pam1", "pam4"])
def test_forces_are_those_of_scikit_learn(study, muscle):
    x, y, theta, covariance, scaling = model_of(study.tables, muscle, 3)
    its = study.tables["force_surfaces"].query("muscle == @muscle").iloc[::97]
    at = scaling.inputs_of(its)
    mean, _ = predict_by_sklearn(x, y, theta, at)
    sd = marginalise_by_sklearn(x, y, theta, covariance, at)
    np.testing.assert_allclose(its["mean_n"], scaling.restore_force(mean), rtol=1e-6)
    np.testing.assert_allclose(its["sd_n"], scaling.force_scale_n * sd, rtol=1e-3)
    samples = scaling.inputs_of(leave_out_lead_in(study.tables["bank"]).query("muscle == @muscle"))
    np.testing.assert_allclose(its["nearest"], cdist(at, samples).min(axis=1), rtol=1e-9)


def test_sections_span_the_bank_and_hold_the_third_input(study):
    forces, bank = study.tables["force_surfaces"], leave_out_lead_in(study.tables["bank"])
    assert list(forces["muscle"].unique()) == MUSCLES
    for (muscle, section), its in forces.groupby(["muscle", "section"]):
        samples = bank[bank["muscle"] == muscle]
        varied = ["pressure_kpa", "contraction" if section == "pressure_contraction" else "contraction_velocity_per_s"]
        for name in varied:
            ends = (samples[name].min(), samples[name].max())
            assert (its[name].min(), its[name].max()) == pytest.approx(ends)
        if section == "pressure_contraction":
            assert (its["contraction_velocity_per_s"] == 0).all()
        else:
            assert (its["contraction"] == samples["contraction"].median()).all()
        assert len(its) == 31 * 31


def test_an_input_that_never_varied_gets_a_range_of_its_unit(generator):
    samples = make_tables(generator)["bank"].assign(contraction_velocity_per_s=0.0)
    scaling = Scaling(MODEL_INPUTS, np.array([100, 0.1, 0.0]), np.array([30, 0.05, 0.2]), 50.0, 15.0)
    states = lay_grid(samples, ("pressure_kpa", "contraction_velocity_per_s"), 3, scaling)
    assert sorted(states["contraction_velocity_per_s"].unique()) == pytest.approx([-0.2, 0.0, 0.2])
    assert list(states.columns) == list(MODEL_INPUTS)


# ---- the stage


def test_the_stage_tells_of_every_arm_and_test_set_and_draws(study):
    tables = study.tables
    arms = list(tables["trials"]["arm"].unique())
    assert list(tables["choice_concentration"]["arm"]) == arms
    assert set(tables["coverage"]["arm"]) == set(arms)
    assert set(tables["reliability"]["tested_on"]) == {"bank", "unseen_bank"}
    assert sorted(tables["coverage"]["trial"].unique()) == [0, 1, 3]
    start = tables["coverage"].query("trial == 0").groupby(["tested_on", "muscle", "model"])["share"]
    assert (start.max() == start.min()).all()
    for name in ("frequent_references", "force_surfaces", "reliability"):
        assert (study.folder / "figures" / f"{name}.png").stat().st_size > 10_000
    # one experiment is as concentrated as any
    assert (tables["choice_concentration"]["p"] == 1).all()


def test_without_an_unseen_bank_all_else_is_the_same_and_found_by_other_processes_too(study, tmp_path):
    stage = study.stages["learned_models"]
    tables = {name: study.tables[name] for name in stage.reads if name != "unseen_bank"}
    found = run_alone(stage, study.configured.config(stage), tmp_path, tables, context=PickledContext)
    for name in ("chosen_often", "choice_concentration", "force_surfaces"):
        pd.testing.assert_frame_equal(found[name], study.tables[name])
    for name in ("coverage", "reliability"):
        same = study.tables[name].query("tested_on == 'bank'").reset_index(drop=True)
        pd.testing.assert_frame_equal(found[name], same)


def test_only_the_first_experiments_count(study):
    tables = study.tables
    recorded = {"pam2": RecordedModels.read(tables["hyperprior"], tables["scaling"], "pam2")}
    section = study.configured.config(study.stages["learned_models"]).learned_models.reliability
    models, points = (
        pd.concat([tables[name], tables[name].assign(experiment=section.experiments + 1)], ignore_index=True)
        for name in ("models", "points")
    )
    (job,) = gather(recorded, {"bank": leave_out_lead_in(tables["bank"])}, models, points, section).values()
    expected = tables["coverage"].query("muscle == 'pam2' and tested_on == 'bank'")
    assert [row[9] for row in measure_coverage(*job)] == list(expected["share"])


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("learned_models.surfaces.muscle=pam9", "learned_models.surfaces.muscle: no muscle 'pam9'; did you mean"),
        ("learned_models.reliability.every=1000", "every: expected less than the 1000 samples of a movement, got 1000"),
    ],
)
def test_what_does_not_fit_the_machine_is_refused(override, told):
    with pytest.raises(ConfigError, match=told):
        read_stages(STAGES, "experiment=paper", override)
