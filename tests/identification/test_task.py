"""What models are wanted for: its samples, and the design that serves it, in the tiny budget."""

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import ConfigError
from stages.science.signals.lead_in import leave_out_lead_in
from tests.studies import assert_refused, read_stages, run_stage

CHAIN = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop", "comparison"]
DESIGNED = ["active_loop.controls=[random]"]
FEATURES = ["contraction_stop_narrow", "contraction_stop", "contraction_stop_wide", "contraction_highpass"]


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The tables of a designed study of a mixed bank, with its stages and a folder."""
    study, stages = read_stages(CHAIN, *DESIGNED)
    folder = tmp_path_factory.mktemp("designed")
    tables = {}
    for name in CHAIN:
        tables.update(run_stage(study, stages[name], folder, tables))
    return study, stages, tables


def test_models_stand_on_features_of_the_past_and_are_tested_on_the_task(designed):
    _, _, tables = designed
    assert list(tables["points"].columns[-4:]) == list(tables["task"].columns[-4:]) == FEATURES
    assert set(tables["hyperprior"]["hyperparameter"]) > {f"log_length_{name}" for name in FEATURES}
    curve = tables["learning_curve"].groupby(["tested_on", "arm", "trial"])["error_rate"].mean()
    for arm in ("integrated_variance", "random"):
        assert curve["task", arm, 3] < 0.7 * curve["task", arm, 0]


def test_the_task_is_spread_over_its_movements(designed):
    _, _, tables = designed
    task, movements = tables["task"], leave_out_lead_in(tables["task_movements"])
    assert (task.groupby("muscle").size() == 400).all()
    for muscle, rows in task.groupby("muscle"):
        its = movements[movements["muscle"] == muscle]
        assert set(rows["pressure_kpa"]) <= set(its["pressure_kpa"])
        quantiles = (each["contraction"].quantile([0.1, 0.5, 0.9]) for each in (rows, its))
        np.testing.assert_allclose(*quantiles, atol=0.01)


def test_choices_are_the_same_with_every_force_but_the_trials_set_to_nan(designed, tmp_path):
    study, stages, tables = designed
    unread = ("bank", "task_movements")
    blind = {name: each.assign(force_n=np.nan) if name in unread else each for name, each in tables.items()}
    for name in CHAIN[1:3]:
        blind.update(run_stage(study, stages[name], tmp_path, blind))
    blind.update(run_stage(study, stages["active_loop"], tmp_path, blind))
    for name in ("trials", "points", "models"):
        pd.testing.assert_frame_equal(blind[name], tables[name], check_exact=True)


def test_a_region_bounds_the_samples_and_an_empty_one_is_refused(designed, tmp_path):
    _, _, tables = designed
    lows, contraction = "+task.region.pam1.pressure_kpa={low: LOW,high: 999.0}", "{low: 0.0,high: 0.1}"
    region = [lows.replace("LOW", "100.0"), f"+task.region.pam1.contraction={contraction}"]
    study, stages = read_stages(["bank", "subsampling", "task"], "task=bank", *region)
    found = run_stage(study, stages["task"], tmp_path / "some", tables)
    pam1 = found["task"].query("muscle == 'pam1'")
    assert pam1["pressure_kpa"].min() >= 100.0
    assert pam1["contraction"].max() <= 0.1
    assert found["task"].query("muscle == 'pam2'")["pressure_kpa"].min() < 100.0
    assert found["task_movements"].empty
    study, stages = read_stages(["bank", "subsampling", "task"], "task=movements", *region)
    moved = run_stage(study, stages["task"], tmp_path / "moved", tables)["task_movements"]
    bounded = (moved["pressure_kpa"] >= 100.0) & (moved["contraction"] <= 0.1) & (moved["contraction"] >= 0.0)
    assert moved["wanted"].equals((moved["muscle"] != "pam1") | bounded)
    assert 0 < moved["wanted"].sum() < len(moved)
    study, stages = read_stages(["bank", "subsampling", "task"], "task=bank", lows.replace("LOW", "900.0"))
    with pytest.raises(ConfigError, match=r"task\.region\.pam1: expected bounds that hold a sample"):
        run_stage(study, stages["task"], tmp_path / "none", tables)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["+task.region.pam9={pressure_kpa: {low: 0.0,high: 1.0}}"], "task.region: no muscle 'pam9'; did you mean"),
        (["+task.region.pam1={weight: {low: 0.0,high: 1.0}}"], "task.region.pam1: the model has no input 'weight'"),
        (["+task.region.pam1={pressure_kpa: {low: 9.0,high: 1.0}}"], "task.region.pam1.pressure_kpa: expected low"),
        (["task.trajectories=1000000000"], "task.trajectories: expected at most 12500 movements"),
        (["model.inputs=[pressure,weight]"], "model.inputs.1: input should be"),
    ],
)  # fmt: skip
def test_refuses(overrides, told):
    assert_refused(CHAIN, told, "task=bank", *overrides)


@pytest.fixture(scope="module")
def ended(designed, tmp_path_factory):
    """The same study's tables where experiments end by the error that is to be expected."""
    tables = designed[2]
    study, stages = read_stages(CHAIN, *DESIGNED, "active_loop.until.error_percent=4.5")
    folder = tmp_path_factory.mktemp("ended")
    found = run_stage(study, stages["active_loop"], folder, tables)
    return found | run_stage(study, stages["comparison"], folder, {**tables, **found})


def test_an_experiment_ends_with_the_first_trial_after_which_the_error_is_probably_below_the_limit(designed, ended):
    whole, trials = (each["trials"].set_index(["arm", "trial"]) for each in (designed[2], ended))
    assert "expected_below" not in whole
    lasts = {}
    for arm, its in trials.groupby("arm"):
        lasts[arm] = len(its)
        assert (its["expected_below"].iloc[:-1].fillna(0.0) < 0.9).all()
        assert its["expected_below"].iloc[-1] >= 0.9 or len(its) == 3
    assert lasts == {"integrated_variance": 2, "random": 3}
    same = ["trajectory", "utility", "surprise", "expected_error", "expected_low", "expected_high"]
    pd.testing.assert_frame_equal(trials[same], whole.loc[trials.index, same], check_exact=True)


def test_an_experiment_that_ended_keeps_its_last_error_where_arms_are_compared(ended):
    curve, final = ended["learning_curve"], ended["final_errors"]
    last = curve.groupby(["tested_on", "muscle", "arm"])["error_rate"].last()
    told = final[final["muscle"] != "mean"].set_index(["tested_on", "muscle", "arm"])
    pd.testing.assert_series_equal(told["after"].sort_index(), last, check_names=False)
    executed = ended["trials"].groupby("arm").size()
    assert (final["trials"] == final["arm"].map(executed)).all()


def test_an_experiment_ends_where_the_next_trial_would_gain_too_little(designed, tmp_path):
    study, stages = read_stages(CHAIN, "active_loop.controls=[]", "active_loop.until.gain_percent=99.0")
    trials = run_stage(study, stages["active_loop"], tmp_path, designed[2])["trials"]
    assert len(trials) == 1
    assert 0.0 < trials["expected_next"].iloc[0] < trials["expected_error"].iloc[0]


def test_an_end_by_the_task_is_refused_without_one():
    left = [each for each in CHAIN if each != "task"]
    limit = "experiment=paper_design", "active_loop.until.error_percent=2.0"
    assert_refused(left, "active_loop.until: expected errors are those on a task, and this workflow has no", *limit)


def test_a_choice_that_serves_a_task_is_refused_without_one_before_anything_is_measured():
    left = [each for each in CHAIN if each != "task"]
    assert_refused(left, "active_loop.utility: integrated_variance asks for the stage task", "~task")
    sampled = "active_loop=paper", "active_loop.subsample_utility=predictive_information"
    assert_refused(left, "active_loop.utility: predictive_information asks for the stage task", "~task", *sampled)


def test_errors_on_the_task_are_of_its_region_alone(designed, tmp_path):
    study, stages, tables = designed
    moved = tables["task_movements"]
    first = moved["trajectory"] == 0
    told = {"all": tables}
    for name, each in {"region": moved.assign(wanted=first), "alone": moved[first]}.items():
        told[name] = run_stage(study, stages["comparison"], tmp_path / name, {**tables, "task_movements": each})
    on_task = {name: each["learning_curve"].query("tested_on == 'task'") for name, each in told.items()}
    curves = {name: each["error_rate"].to_numpy() for name, each in on_task.items()}
    np.testing.assert_array_equal(curves["region"], curves["alone"])
    assert np.abs(curves["region"] - curves["all"]).max() > 1e-4
