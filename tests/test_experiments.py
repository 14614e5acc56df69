"""Every named study: its first line is the command that runs it, and the command runs."""

import shlex

import numpy as np
import pandas as pd
import pytest

from tests.conftest import ROOT, Command

EXPERIMENTS = sorted((ROOT / "conf" / "experiment").glob("*.yaml"))
SHARED = "quick"
"""In the tiny budget it is the study of `shared_run`. The others are planned here; test_paper, test_hidden_effect and
the test below run them, test_time_shift and test_hyperprior_sensitivity their stages."""


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_runs_by_the_command_that_it_begins_with(path, shared_run):
    package, command = path.read_text().splitlines()[:2]
    assert package == "# @package _global_"
    words = shlex.split(command.removeprefix("# "))
    assert words[:3] == ["python", "-m", "pipeline"]
    assert f"experiment={path.stem}" in words
    planned = path.stem != SHARED
    result = Command(shared_run.outputs)(*words[3:], "budget=tiny", f"plan={str(planned).lower()}")
    assert result.returncode == 0, result.stderr
    for told in ["to run it: "] if planned else ["everything is fresh: nothing to run", "report: "]:
        assert told in result.stdout


@pytest.mark.slow
def test_utilities_are_arms_from_the_same_initial_data(pamid):
    result = pamid("experiment=utilities", "budget=tiny", "active_loop.trials=1", "figures=[png]")
    assert result.returncode == 0, result.stderr
    curve = pd.read_parquet(pamid.runs[0] / "tables/learning_curve.parquet")
    arms = ["integrated_variance", "y_y", "f_f", "f_y", "y_y_theta", "hyperparameter_information", "log_det"]
    arms += ["variance", "predictive_information", "random"]
    assert list(curve["arm"].unique()) == arms
    start = curve[curve["trial"] == 0].pivot(index=["tested_on", "muscle"], columns="arm", values="error_rate")
    assert np.ptp(start.to_numpy(), axis=1).max() == 0
    compared = pd.read_parquet(pamid.runs[0] / "tables/paired_comparison.parquet")
    assert len(compared) == 2 * 18
