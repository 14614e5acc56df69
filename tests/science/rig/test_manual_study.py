"""A whole study whose trials a person executes: asked for one by one, told by files, the same command each time."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stages.science.rig.contract import tidy
from stages.science.rig.trial import Trial
from tests.conftest import Command
from tests.science.plant.machines import configured


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
    small = ["bank.trajectories=3", "subsampling.initial_trials=1", "active_loop.trials=2"]
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
    trials = [f"p1 experiment 1 {each}" for each in ("initial 1", "y_y trial 1", "y_y trial 2")]
    assert asked == ["bank 0", "bank 1", "bank 2", *trials]
    trials = pd.read_parquet(command.runs[0] / "tables" / "trials.parquet")
    assert list(trials["arm"].unique()) == ["y_y"]
