"""Trials that a person executes: asked for one by one, told by files, the same command each time."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stages.science.rig.contract import MEASUREMENT_COLUMNS, RigError, tidy
from stages.science.rig.manual import ManualRig, TrialRequested
from stages.science.rig.trial import Proposal, Trial
from tests.conftest import Command
from tests.science.plant.machines import configured
from tests.science.rig.watching import execute, execute_whole


@pytest.fixture
def trial():
    rig = configured()
    reference = np.full((rig.samples, 2), 0.5)
    return Trial("tracked", "p1", np.full((rig.samples, 4), 100.0), reference, label="p1 experiment 1 y_y trial 3")


@pytest.fixture
def told(trial):
    return execute(configured(), trial, seed=3)


@pytest.fixture
def operator(tmp_path):
    simulated = configured()
    return ManualRig(exoskeleton=simulated.exoskeleton, participants=simulated.participants, folder=str(tmp_path))


def asked_for(operator, trial):
    with pytest.raises(TrialRequested) as request:
        execute(operator, trial)
    return request.value.asks


def test_asks_for_what_is_not_recorded_yet(operator, trial):
    asks = asked_for(operator, trial)
    assert asks["trial"] == "p1 experiment 1 y_y trial 3"
    assert asks["save_as"].startswith(operator.folder)
    np.testing.assert_array_equal(asks["reference_rad"]["EFE"], trial.reference_rad[:, 1])
    np.testing.assert_array_equal(asks["pressure_command_kpa"]["pam4"], trial.pressure_command_kpa[:, 3])
    assert list(asks["columns"]) == list(MEASUREMENT_COLUMNS)
    assert asks["reason"] == ""
    proposed = replace(trial, proposal=Proposal(1, 3, "a quick movement for the bank"))
    assert asked_for(operator, proposed)["reason"] == "a quick movement for the bank"


def test_another_trial_under_the_same_label_is_asked_for_anew(operator, trial):
    other = Trial("tracked", "p1", trial.pressure_command_kpa + 1, trial.reference_rad, label=trial.label)
    assert asked_for(operator, trial)["save_as"] != asked_for(operator, other)["save_as"]


def test_reads_back_exactly_what_was_recorded(operator, trial, told):
    path = asked_for(operator, trial)["save_as"]
    pd.DataFrame(tidy(told, configured())).sample(frac=1.0, random_state=1).to_csv(path, index=False)
    found = execute(operator, trial)
    for name in vars(told):
        np.testing.assert_array_equal(getattr(found, name), getattr(told, name))


def test_a_filling_is_read_back_whole_or_left_out(operator, trial):
    path = asked_for(operator, trial)["save_as"]
    whole = execute_whole(configured(), trial, 4)
    rows = pd.DataFrame(tidy(whole, configured()))
    rows.to_csv(path, index=False)
    np.testing.assert_array_equal(execute_whole(operator, trial).joint_angle_rad, whole.joint_angle_rad)
    hole = rows["time_s"].between(-0.5, -0.0041)
    for kept in (~hole, ~hole | (rows["muscle"] != "pam2")):
        rows[kept].to_csv(path, index=False)
        with pytest.raises(
            RigError, match=r"before time 0, from -1 s on, where .* \(250\), got 126; leave them all out"
        ):
            execute_whole(operator, trial)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda frame: frame.drop(columns="force_n"), "expected the columns time_s, .*; it lacks force_n$"),
        (lambda frame: frame.assign(force_n=np.nan), "column force_n: expected not_nullable, got nan"),
        (lambda frame: frame.assign(force_n="much"), "column force_n: expected .*float.*, got much"),
        (lambda frame: frame.assign(contraction=9.0), r"contraction: expected less_than_or_equal_to\(0.5\), got 9.0"),
        (lambda frame: pd.DataFrame(), "expected a table"),
        (lambda frame: frame.iloc[:-1], "expected 1000 samples of every muscle, got 999 of pam4"),
        (lambda frame: frame[frame["muscle"] != "pam2"], "got 0 of pam2"),
        (
            lambda frame: frame.assign(time_s=frame["time_s"] + 0.001 * (frame["muscle"] == "pam1")),
            "expected the same 1000 times for every muscle, got 2000 times",
        ),
        (
            lambda frame: frame.assign(time_s=2.0 * frame["time_s"]),
            r"from 0 to 3.996 s, 250 in a second, .* 7.992",
        ),
        (
            lambda frame: frame.assign(time_s=frame["time_s"] + 100.0),
            "got them from 100 to 103.996 s",
        ),
        (
            lambda frame: frame.assign(pressure_kpa=frame["pressure_kpa"] / 100.0),
            "none above .*; if they are in bar",
        ),
        (
            lambda frame: frame.assign(pressure_command_kpa=frame["pressure_command_kpa"] + 50.0),
            "what was asked for, within 1 kPa RMS where clipped_by is empty, got 50 kPa off",
        ),
    ],
)
def test_refuses_what_was_not_asked_for(operator, trial, told, spoil, message):
    path = asked_for(operator, trial)["save_as"]
    spoil(pd.DataFrame(tidy(told, configured()))).to_csv(path, index=False)
    with pytest.raises(RigError, match=message) as refusal:
        execute(operator, trial)
    assert re.match(re.escape(path), str(refusal.value))
    assert "\n" not in str(refusal.value)


def execute_by_hand(asks):
    """Stand in for the operator: execute what is asked for on the simulator and save it."""
    reference = np.column_stack(list(asks["reference_rad"].values())) if asks["reference_rad"] else None
    command = np.column_stack(list(asks["pressure_command_kpa"].values()))
    with configured("rich") as rig:
        trial = Trial(asks["kind"], asks["participant"], command, reference)
        recording = rig.execute(trial, np.random.default_rng(len(asks["trial"])))
        path = Path(asks["save_as"])
        path.parent.mkdir(exist_ok=True)
        pd.DataFrame(tidy(recording, rig)).to_csv(path, index=False)


@pytest.mark.slow
def test_asks_for_each_trial_and_goes_on_when_told(tmp_path):
    small = ["bank.trajectories=3", "subsampling.initial_trials=1", "active_loop.trials=2", "task=bank"]
    command = Command(tmp_path / "outputs", "budget=tiny", *small, "rig=manual", f"rig.folder={tmp_path / 'told'}")
    asked = []
    for _ in range(12):
        result = command()
        if result.returncode != 3:
            break
        assert re.search(r"paused: execute .* save what was recorded as .* when that is done, type: ", result.stderr)
        assert len(result.stderr.strip().splitlines()) == 1
        (run,) = command.runs
        asks = json.loads((run / "documents" / "asks.json").read_text())
        asked.append(asks["trial"])
        execute_by_hand(asks)
    assert result.returncode == 0, result.stderr
    trials = [f"p1 experiment 1 {each}" for each in ("initial 1", *(f"integrated_variance trial {k}" for k in (1, 2)))]
    assert asked == ["bank 0", "bank 1", "bank 2", *trials]
    trials = pd.read_parquet(command.runs[0] / "tables" / "trials.parquet")
    assert list(trials["arm"].unique()) == ["integrated_variance"]
