"""The loop that keeps all samples, run in memory, and its comparison against planted errors."""

import json
import re
from types import SimpleNamespace
from unittest.mock import DEFAULT, Mock

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import ConfigError
from stages.paper.sparse_comparison import compare_ways, join_exact
from stages.science.gp.sparse_marginal import condition_sparse
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import thin
from stages.science.rig.reference import track
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.measures import error_rate
from tests.planted import assert_holm, assert_paired, make_curve, values_of
from tests.studies import read_stages, run_stage

BEFORE = ["bank", "subsampling", "hyperprior", "hardware"]
STAGES = [*BEFORE, "active_loop", "comparison", "sparse_loop", "sparse_comparison"]
SETTINGS = (
    "experiment=paper_design",
    "+sparse_loop=default",
    "+sparse_comparison=default",
    "active_loop.controls=[random]",
    "active_loop.trials=2",
    "sparse_loop.trials=2",
    "sparse_loop.first_iterations=15",
    "sparse_loop.iterations=5",
)
KEPT = 50  # one in 20 of a trial's 1000 samples


def read(*overrides):
    return read_stages(STAGES, *SETTINGS, *overrides)


@pytest.fixture(scope="module")
def before(tmp_path_factory):
    """The study and all tables that the loop reads."""
    study, stages = read()
    folder, tables = tmp_path_factory.mktemp("before"), {}
    for name in BEFORE:
        tables.update(run_stage(study, stages[name], folder, tables))
    return study, stages, tables


@pytest.fixture(scope="module")
def after(before, tmp_path_factory):
    """The tables with the loop's."""
    study, stages, tables = before
    folder = tmp_path_factory.mktemp("after")
    return {**tables, **run_stage(study, stages["sparse_loop"], folder, tables)}, folder


def test_the_loop_never_sees_the_banks_force(before):
    _, stages, tables = before
    assert {name for name in stages["sparse_loop"].reads if "force_n" in tables[name]} == {"hardware_recordings"}


def test_every_sample_of_every_trial_is_kept(after):
    tables, _ = after
    trials = tables["sparse_trials"]
    assert trials["samples"].tolist() == [(2 + trial) * KEPT for trial in trials["trial"]]
    assert len(trials) == 4
    assert list(trials["arm"].unique()) == ["y_y", "random"]
    counts = leave_out_lead_in(tables["sparse_recordings"]).groupby(["arm", "trial", "muscle"]).size()
    assert (counts == 1000).all()
    initial = set(tables["initial_trials"]["trajectory"])
    for _, its in trials.groupby("arm"):
        assert its["trajectory"].is_unique
        assert not initial & set(its["trajectory"])


def rebuild(tables, arm, trial):
    """Yield each muscle's name, recorded rows, pseudo-inputs and theta, and the model of all samples by then."""
    muscles = MuscleSet.read(tables["candidates"], tables["hyperprior"], tables["scaling"])
    recorded = leave_out_lead_in(tables["sparse_recordings"]).query("arm == @arm and trial <= @trial")
    later = recorded[recorded["time_s"].rank(method="dense").astype(int) % 20 == 1]
    start = thin(tables["hardware_recordings"], 20, ["position"])
    inputs, outputs = muscles.standardise(pd.concat([start, later]) if trial else start)
    for m, name in enumerate(muscles.names):
        where = "arm == @arm and trial == @trial and muscle == @name"
        rows, at = tables["sparse_models"].query(where), tables["sparse_pseudo_inputs"].query(where)
        assert len(outputs[m]) == (2 + trial) * KEPT
        z, theta = muscles.scalings[m].inputs_of(at), rows["value"].to_numpy()
        model = condition_sparse(inputs[m], outputs[m], z, theta, muscles.priors[m])
        yield name, rows, at, z, theta, model, muscles.scalings[m], muscles.candidates[m][0]


@pytest.mark.parametrize("arm", ["y_y", "random"])
def test_recorded_models_stand_on_all_those_samples(after, arm):
    for _, rows, at, z, theta, model, _, points in rebuild(after[0], arm, 2):
        assert model.log_posterior == pytest.approx(rows["log_posterior"].iloc[0], rel=1e-6)
        np.testing.assert_allclose(np.sqrt(np.diag(model.laplace.covariance)), rows["sd"], rtol=1e-2)
        k = np.exp(-0.5 * (((points[:, None] - z) / np.exp(theta[:3])) ** 2).sum(axis=2) + 2 * theta[3])
        np.testing.assert_allclose(k @ at["weight"].to_numpy(), model.predict_mean(points), atol=1e-5)


def test_the_control_differs_in_its_choices_alone(after):
    tables, _ = after
    for name in ("sparse_models", "sparse_pseudo_inputs"):
        first = tables[name].query("trial == 0")
        arms = [its.drop(columns="arm").reset_index(drop=True) for _, its in first.groupby("arm")]
        pd.testing.assert_frame_equal(*arms)
    chosen = tables["sparse_trials"].set_index(["arm", "trial"])
    assert chosen.loc["y_y", "utility"].notna().all()
    assert chosen.loc["random", "utility"].isna().all()


def test_costs_of_both_models_are_measured(after):
    told = json.loads((after[1] / "documents" / "cost.json").read_text())
    assert (told["sparse"]["samples"], told["exact"]["samples"]) == (4 * KEPT, 30)
    for each in told.values():
        assert each["seconds"] > 0
        assert each["peak_memory_mb"] > 0


def test_a_killed_loop_goes_on_from_its_parts(before, after, tmp_path, monkeypatch):
    study, stages, tables = before
    loop = stages["sparse_loop"]
    tracked = Mock(wraps=track, side_effect=[DEFAULT, DEFAULT, DEFAULT, KeyboardInterrupt, DEFAULT])
    monkeypatch.setattr(f"{loop.module}.track", tracked)
    with pytest.raises(KeyboardInterrupt):
        run_stage(study, loop, tmp_path, tables)
    parts = sorted(path.name for path in (tmp_path / "parts" / "sparse_loop").iterdir())
    assert parts == ["p1~1~random~01", "p1~1~y_y~01", "p1~1~y_y~02"]
    resumed = run_stage(study, loop, tmp_path, tables)
    assert tracked.call_count == 5
    for name, frame in resumed.items():
        pd.testing.assert_frame_equal(frame, after[0][name])


def test_a_real_rig_executes_nothing_unless_asked(before, tmp_path):
    study, stages, tables = before
    found = run_stage(study, stages["sparse_loop"], tmp_path, tables, rig=SimpleNamespace(real=True))
    assert all(each.empty for each in found.values())
    empty = {**tables, **found, "learning_curve": pd.DataFrame(columns=["arm"])}
    nothing = run_stage(study, stages["sparse_comparison"], tmp_path, empty)
    assert all(each.empty for each in nothing.values())


def test_errors_are_those_of_the_models_and_exact_ones_stand_beside(before, after, tmp_path, generator):
    study, stages, _ = before
    exact = make_curve(generator, {"y_y": 0.05, "random": 0.06, "variance": 0.05}).assign(rmse_n=1.0)
    tables = {**after[0], "learning_curve": exact}
    found = run_stage(study, stages["sparse_comparison"], tmp_path, tables)
    curve, compared = found["sparse_curve"], found["sparse_comparison"]
    for name, *_, model, scaling, _ in rebuild(tables, "y_y", 0):
        test = leave_out_lead_in(tables["bank"]).query(f"muscle == '{name}'")
        force_n = test["force_n"].to_numpy()
        rate = error_rate(scaling.restore_force(model.predict_mean(scaling.inputs_of(test))), force_n)
        where = f"arm == 'y_y' and trial == 0 and muscle == '{name}'"
        row = curve.query(f"model == 'sparse' and {where}")
        assert row["error_rate"].item() == pytest.approx(rate, rel=1e-5)
        assert row["rmse_n"].item() == pytest.approx(rate * force_n.max(), rel=1e-5)
    beside = curve[curve["model"] == "exact"].drop(columns="model").reset_index(drop=True)
    theirs = exact.query("arm != 'variance' and participant == 'p1' and experiment == 1").reset_index(drop=True)
    pd.testing.assert_frame_equal(beside, theirs[list(beside.columns)])
    assert len(compared) == 6
    assert (compared["verdict"] == "undecided").all()
    assert (tmp_path / "figures" / "sparse_curve.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("sparse_loop.utility=log_det", "sparse_loop.utility: input should be 'y_y', "),
        ("sparse_loop.controls=[random,random]", "controls: expected each control once, got random 2 times"),
        ("sparse_loop.trials=7", "sparse_loop.trials: expected at most 6 (8 movements of the bank less 2 initial"),
        ("sparse_loop.every=200", "sparse_loop.pseudo_inputs: expected at most the 10 samples that are kept of the 2"),
        ("sparse_loop.pseudo_inputs=101", "sparse_loop.pseudo_inputs: expected at most the 100 samples"),
        ("sparse_loop.pseudo_inputs=0", "sparse_loop.pseudo_inputs: input should be greater than or equal to 1"),
        ("sparse_loop.starts=0", "sparse_loop.starts: input should be greater than or equal to 1"),
        ("sparse_loop.experiments=0", "sparse_loop.experiments: input should be greater than 0"),
        ("sparse_comparison.margin=0", "sparse_comparison.margin: input should be greater than 0"),
        ("+sparse_loop.evry=2", "unknown key 'sparse_loop.evry': did you mean 'every'?"),
    ],
)
def test_settings_that_make_no_sense_are_refused(override, told):
    with pytest.raises(ConfigError, match=re.escape(told)):
        read(override)


def test_what_does_not_fit_in_memory_is_refused():
    many = ("sparse_loop.reuse_trajectories=true", "sparse_loop.trials=2000", "subsampling.every=1")
    with pytest.raises(ConfigError, match=r"sparse_loop\.every: expected at most 25000000 pseudo-inputs x samples"):
        read(*many)
    with pytest.raises(ConfigError, match=r"sparse_loop\.experiments: expected recordings of at most 50000000 rows"):
        read(*many, "subsampling.experiments=9", "sparse_loop.experiments=9")


# the comparison, on planted errors

LINES = [("sparse", "y_y"), ("sparse", "random"), ("exact", "y_y"), ("exact", "random")]


def make_lines(generator, shifts=None, **sizes):
    """Return error rates of each model and arm around a mean of its own after the first trial."""
    means = {line: 0.05 + (shifts or {}).get(line, 0.0) for line in LINES}
    curve = make_curve(generator, means, start=0.1, **sizes)
    models, arms = zip(*curve["arm"], strict=True)
    return curve.assign(model=models, arm=arms, rmse_n=1.0)


def row_of(told, measure, second):
    return told.set_index(["measure", "first", "second"]).loc[(measure, "sparse y_y", second)]


def pick(curve, model, arm):
    return curve[(curve["model"] == model) & (curve["arm"] == arm)]


@pytest.mark.parametrize("measure", ["final", "curve"])
def test_agrees_with_scipy_and_statsmodels(measure, generator):
    curve = make_lines(generator, {("exact", "y_y"): 0.0007})
    told = row_of(compare_ways(curve, 0.002), measure, "exact y_y")
    first, second = (values_of(pick(curve, model, "y_y"), measure) for model in ("sparse", "exact"))
    assert told["n"] == 8
    assert_paired(told, first, second, 0.002)
    assert (told["first_mean"], told["second_mean"]) == pytest.approx((first.mean(), second.mean()))


@pytest.mark.parametrize(
    ("shift", "sd", "verdict"),
    [
        (0.03, 0.001, "first better"),
        (-0.03, 0.001, "second better"),
        (0.005, 0.0005, "first better within the margin"),
        (-0.005, 0.0005, "second better within the margin"),
        (0.0, 0.002, "equivalent"),
        (0.0, 0.05, "undecided"),
    ],
)
def test_planted_errors_turn_the_verdict(shift, sd, verdict, generator):
    curve = make_lines(generator, {("exact", "y_y"): shift, ("sparse", "random"): shift}, sd=sd)
    told = compare_ways(curve, 0.01)
    for second in ("exact y_y", "sparse random"):
        for measure in ("final", "curve"):
            assert row_of(told, measure, second)["verdict"] == verdict


def test_each_test_set_is_a_family_and_questions_are_told_apart(generator):
    curve = make_lines(generator, {("exact", "y_y"): 0.001}, tests=("bank", "unseen_bank"))
    told = compare_ways(curve, 0.01)
    assert told.groupby(["tested_on", "question"]).size().to_dict() == {
        (name, question): count
        for name in ("bank", "unseen_bank")
        for question, count in (("keeping all samples", 4), ("choosing by utility", 2))
    }
    for _, family in told.groupby("tested_on"):
        assert_holm(family, 6)


def test_controls_of_fewer_experiments_are_paired_on_theirs(generator):
    curve = make_lines(generator)
    fewer = curve[~((curve["model"] == "exact") & (curve["arm"] == "random") & (curve["experiment"] > 2))]
    told = compare_ways(fewer, 0.01).set_index(["measure", "first", "second"])["n"]
    assert told[("final", "sparse random", "exact random")] == 4
    assert told[("final", "sparse y_y", "exact y_y")] == 8


def test_exact_errors_are_those_of_the_same_experiments(generator):
    curve = make_lines(generator)
    sparse = curve[(curve["model"] == "sparse") & (curve["experiment"] <= 2)]
    exact = curve[curve["model"] == "exact"].drop(columns="model")
    other = exact[exact["arm"] == "random"].assign(arm="variance")
    joined = join_exact(sparse, pd.concat([exact, other]))
    assert joined.groupby(["model", "arm"])["experiment"].agg(["min", "max"]).to_numpy().tolist() == [[1, 2]] * 4
    assert "variance" not in set(joined["arm"])
    alone = join_exact(sparse[sparse["arm"] == "y_y"], pd.concat([exact, other]))
    assert list(alone["arm"].unique()) == ["y_y"]
