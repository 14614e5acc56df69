"""The main job in its tiny budget, as a person runs it."""

import json
import signal
from itertools import product

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from pipeline.errors import ConfigError
from stages.science.muscle_models.inputs import ModelSettings
from stages.science.rig.limits import speed_samples
from stages.science.rig.reference import read_sources
from stages.science.rig.sim import SimulatedRig
from stages.science.signals.bending import Bending, read_changes
from stages.science.signals.lead_in import leave_out_lead_in
from tests.composing import compose_values
from tests.conftest import TINY, Command
from tests.faults import find_parts, tables_of, wait_until
from tests.studies import read_stages, run_stage

BEFORE = ["bank", "subsampling", "hyperprior", "task", "hardware"]
STAGES = [*BEFORE, "active_loop", "model_selection", "comparison", "participant_differences", "tracking_delay"]
FEATURES = ["contraction_stop_narrow", "contraction_stop", "contraction_stop_wide", "contraction_highpass"]
TABLES = """
bank candidates references initial_trials hyperprior scaling task task_movements
hardware_recordings protocol_recordings executed_by
trials active_recordings models points decisions learning_curve learning_summary final_errors paired_comparison
participant_comparison tracking_delays learning_findings advice
selected_inputs selected_constants models_tried selection_errors selection_findings selection_advice
"""

FIGURES = "expected_error learning_curve learning_curve_muscles model_selection participants selected_interactions"


@pytest.fixture
def run(shared_run):
    """The folder of a finished run."""
    return shared_run.runs[0]


def read(run, table):
    return pd.read_parquet(run / "tables" / f"{table}.parquet")


def plan_of(command, *arguments):
    """What is to be done about each stage."""
    lines = [line.split() for line in command(*arguments, "plan=true").stdout.splitlines()]
    return {words[0]: " ".join(words[1:]) for words in lines if words and words[0] in STAGES}


def origins(run):
    return {name: record["origin"] for name, record in json.loads((run / "run.json").read_text())["stages"].items()}


def test_runs_every_stage_and_leaves_every_table(shared_run, run):
    assert list(origins(run)) == STAGES
    assert {path.stem for path in (run / "tables").glob("*.parquet")} == set(TABLES.split())
    figures = product(
        FIGURES.split(),
        ("png", "pdf"),
    )
    assert {path.name for path in (run / "figures").iterdir()} == {".".join(each) for each in figures}
    assert "Error rate before and after" in (shared_run.outputs.parent / "printed.txt").read_text()
    page = (run / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 6
    assert 'src="http' not in page


def test_three_trials_of_three_arms_from_the_same_initial_data(run):
    trials, points, curve = read(run, "trials"), read(run, "points"), read(run, "learning_curve")
    assert list(trials["arm"].unique()) == ["integrated_variance", "y_y", "random"]
    assert trials.groupby("arm")["trial"].apply(list).map(lambda found: found == [1, 2, 3]).all()
    initial = read(run, "initial_trials")
    for _, chosen in trials.groupby("arm"):
        used = [*initial["trajectory"], *chosen["trajectory"]]
        assert len(set(used)) == len(used)
    counts = points.groupby(["arm", "trial", "muscle"]).size().unstack("trial")
    assert (counts[0] == 10).all()
    assert (counts[[1, 2, 3]] == 20).all().all()
    start = curve[curve["trial"] == 0].pivot(index=["tested_on", "muscle"], columns="arm", values="error_rate")
    assert np.ptp(start.to_numpy(), axis=1).max() == 0


def test_points_are_samples_of_the_recordings(run):
    points, recordings = read(run, "points"), read(run, "active_recordings")
    learned = points[points["trial"] > 0].drop(columns=["pick", *FEATURES])
    assert len(learned.merge(recordings, on=list(learned.columns))) == len(learned)


def test_error_rates_are_those_of_a_model_rebuilt_from_the_tables(run):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    its = "arm == 'y_y' and muscle == 'pam3' and trial"
    row = read(run, "learning_curve").query(f"tested_on == 'bank' and {its} == 2").iloc[0]
    theta = read(run, "models").query(f"{its} == 2")["value"].to_numpy()
    points = read(run, "points").query(f"{its} <= 2")
    scaling = read(run, "scaling").query("muscle == 'pam3'").set_index("quantity")
    settings = OmegaConf.to_container(compose_values().model)
    test = ModelSettings(**settings).extend(read(run, "bank").query("muscle == 'pam3'"), ["trajectory"])
    test = test[test["time_s"] >= 0.0]
    inputs = ["pressure_kpa", "contraction", "contraction_velocity_per_s", *FEATURES]

    def standard(frame, names):
        return ((frame[names] - scaling.loc[names, "centre"]) / scaling.loc[names, "scale"]).to_numpy()

    kernel = ConstantKernel(np.exp(2 * theta[-2])) * RBF(np.exp(theta[:-2])) + WhiteKernel(np.exp(2 * theta[-1]))
    model = GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0)
    model.fit(standard(points, inputs), standard(points, ["force_n"])[:, 0])
    centre, scale = scaling.loc["force_n", ["centre", "scale"]]
    predicted = model.predict(standard(test, inputs)) * scale + centre
    rmse_n = np.sqrt(np.mean((predicted - test["force_n"]) ** 2))
    assert row["rmse_n"] == pytest.approx(rmse_n, rel=1e-6)
    assert row["error_rate"] == pytest.approx(rmse_n / test["force_n"].max(), rel=1e-6)


def test_picks_are_the_same_with_the_force_of_the_bank_set_to_nan(run, tmp_path):
    until_chosen = [*BEFORE[1:], "active_loop"]
    study, stages = read_stages(["bank", *until_chosen])
    tables = {"bank": read(run, "bank").assign(force_n=np.nan)}
    for name in until_chosen:
        tables.update(run_stage(study, stages[name], tmp_path, tables))
    assert tables["bank"]["force_n"].isna().all()
    for name in ("trials", "points", "models"):
        pd.testing.assert_frame_equal(tables[name], read(run, name), check_exact=True)


def test_a_trial_may_take_each_muscles_pressures_from_another_movement(run, tmp_path):
    listed, keys = ["bank", *BEFORE[1:], "active_loop"], ["active_loop.exchange_pressures=true", "active_loop.trials=2"]
    keys += ["active_loop.controls=[random]", "active_loop.bending.coefficients=null"]
    study, stages = read_stages(listed, *keys)
    tables = {table.name: read(run, table.name) for name in BEFORE for table in stages[name].writes}
    found = run_stage(study, stages["active_loop"], tmp_path, tables)
    assert set(found["trials"]["arm"]) == {"integrated_variance", "random"}
    bank, recorded = (each.set_index(["muscle", "time_s"]) for each in (tables["bank"], found["active_recordings"]))
    others = 0
    for row in found["trials"].to_dict("records"):
        sources = read_sources(row["pressures_from"])
        trial = recorded.query("arm == @row['arm'] and trial == @row['trial']")
        for muscle in tables["hyperprior"]["muscle"].unique():
            source = row["trajectory"] if row["arm"] == "random" else sources[muscle]
            asked = bank[bank["trajectory"] == source].loc[muscle, "pressure_command_kpa"]
            np.testing.assert_allclose(trial.loc[muscle, "pressure_command_kpa"], asked, atol=1e-9)
            others += source != row["trajectory"]
    assert others > 3


def test_the_designs_movements_are_executed_as_bent_and_controls_as_they_are(run):
    references, trials, recordings = (read(run, name) for name in ("references", "trials", "active_recordings"))
    exoskeleton = read_stages(BEFORE[:2])[0].build("rig").exoskeleton
    joints = {each.name: each.joint for each in exoskeleton.muscles}
    bending = Bending.read(references, joints, exoskeleton.samples, speed_samples(exoskeleton.sampling_rate_hz))
    recorded = leave_out_lead_in(recordings)
    for row in trials.to_dict("records"):
        changes = read_changes(row["bent_by"])
        rows = references[references["trajectory"] == row["trajectory"]]
        asked = bending.bend(rows, changes)
        found = recorded.query("arm == @row['arm'] and trial == @row['trial'] and experiment == @row['experiment']")
        np.testing.assert_allclose(found["pressure_command_kpa"], asked["pressure_command_kpa"], atol=1e-9)
        if row["arm"] != "integrated_variance":
            assert not changes
            assert np.isnan(row["bent_utility"])
        else:
            assert set(changes) <= {*joints, *joints.values()}
            assert row["bent_utility"] > 0.0
            assert np.abs(asked["joint_angle_rad"] - rows["joint_angle_rad"]).max() > 0.02


def test_recordings_are_not_bent(run, tmp_path, monkeypatch):
    monkeypatch.setattr(SimulatedRig, "recorded", True)
    study, stages = read_stages(["bank", *BEFORE[1:], "active_loop"], "active_loop.controls=[]")
    tables = {table.name: read(run, table.name) for name in BEFORE for table in stages[name].writes}
    assert "bent_by" not in run_stage(study, stages["active_loop"], tmp_path, tables)["trials"]


def test_exchanged_pressures_are_refused_where_trials_are_recordings(run, tmp_path, monkeypatch):
    monkeypatch.setattr(SimulatedRig, "recorded", True)
    study, stages = read_stages(["bank", *BEFORE[1:], "active_loop"], "active_loop.exchange_pressures=true")
    tables = {table.name: read(run, table.name) for name in BEFORE for table in stages[name].writes}
    with pytest.raises(ConfigError, match="exchange_pressures: expected false, as SimulatedRig returns trials as they"):
        run_stage(study, stages["active_loop"], tmp_path, tables)


def test_a_loop_goes_on_with_its_trials_where_their_number_or_what_ends_it_changes(run, tmp_path):
    listed, controls = ["bank", *BEFORE[1:], "active_loop"], "active_loop.controls=[]"

    def rerun(*keys):
        study, stages = read_stages(listed, controls, *keys)
        tables = {table.name: read(run, table.name) for name in BEFORE for table in stages[name].writes}
        return run_stage(study, stages["active_loop"], tmp_path, tables)["trials"]

    def parts():
        return {each.name: each.stat().st_mtime_ns for each in (tmp_path / "parts" / "active_loop").iterdir()}

    whole = read(run, "trials").query("arm == 'integrated_variance'").reset_index(drop=True)
    rerun("active_loop.trials=2")
    two = parts()
    pd.testing.assert_frame_equal(rerun("active_loop.trials=3"), whole, check_exact=True)
    three = parts()
    assert len(two) == 2 * len(whole["participant"].unique())
    assert {name: three[name] for name in two} == two
    ended = rerun("active_loop.until.error_percent=50.0", "active_loop.until.probability=0.6")
    assert list(ended["trial"]) == [1] * len(whole["participant"].unique())
    assert ended["expected_below"].between(0.6, 1.0).all()
    assert parts() == three


@pytest.mark.slow
def test_killed_in_the_loop_continues_at_the_next_trial_with_identical_tables(run, tmp_path):
    command = Command(tmp_path / "outputs", *TINY)
    process = command.start()
    wait_until(process, lambda: len(find_parts(command, "active_loop")) >= 4)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    result = command()
    assert result.returncode == 0, result.stderr
    assert f"resuming {command.runs[0]}" in result.stdout
    assert len(command.runs) == 1
    assert tables_of(command.runs[0]) == tables_of(run)


def test_changed_key_reruns_just_the_stages_that_read_it(shared_run):
    plan = plan_of(shared_run, "active_loop.points_per_trial=1")
    assert "run config changed (active_loop.points_per_trial 20 -> 1)" in plan["active_loop"]
    assert [name for name in STAGES if plan[name].startswith("fresh")] == BEFORE
    assert plan["comparison"].startswith("wait")


def test_another_seed_shares_the_bank(shared_run):
    plan = plan_of(shared_run, "seed=5")
    assert plan["bank"].startswith("fresh")
    assert plan["subsampling"].startswith("run config changed (seed 0 -> 5)")
