"""Twelve designed trials on an emulated device teach as much as on the simulated rig."""

import numpy as np
import pytest
from scipy import stats

from tests.cpx_e.rig import emulate_rig
from tests.studies import PickledContext, read_stages, run_stage

pytestmark = pytest.mark.slow

STAGES = ["bank", "subsampling", "hyperprior", "task", "hardware", "active_loop", "comparison"]
MACHINE = ("plant=nominal", "exoskeleton.sampling_rate_hz=100", "exoskeleton.trial_s=2.0", "bank.trajectories=14")
STUDY = (*MACHINE, "subsampling.initial_trials=2", "active_loop.trials=12", "active_loop.controls=[]")
SEEDS = range(5)


def identify(folder, *chosen):
    """Run the study; return the mean error rate of the models before and after twelve trials."""
    study, stages = read_stages(STAGES, *STUDY, *chosen)
    tables = {}
    for name in STAGES:
        tables |= run_stage(study, stages[name], folder, tables, context=PickledContext)
    errors = tables["final_errors"].query("tested_on == 'bank' and muscle == 'mean'").iloc[0]
    return errors["before"], errors["after"]


def test_the_error_rate_is_that_of_the_simulated_rig_within_its_spread(tmp_path):
    with emulate_rig("exoskeleton.trial_s=2.0") as (emulator, _):
        before, after = identify(
            tmp_path / "emulated",
            "rig=festo_cpx",
            "rig._target_=tests.cpx_e.rig.ToldFestoCpx",
            "rig.device.host=127.0.0.1",
            f"rig.device.port={emulator.port}",
            f"+rig.control_port={emulator.control_port}",
        )
    simulated = [identify(tmp_path / str(seed), f"seed={seed}", f"bank.seed={2000 + seed}") for seed in SEEDS]
    known = np.log([error for _, error in simulated])
    reach = stats.t.ppf(0.995, len(known) - 1) * known.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(known))
    told = f"{after:.4f}, simulated {np.exp(known.mean()):.4f} ({np.exp(known.min()):.4f} to {np.exp(known.max()):.4f})"
    assert after < before
    assert abs(np.log(after) - known.mean()) < reach, told
    assert reach < np.log(3.0), told
