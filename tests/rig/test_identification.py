"""Ten designed trials on an emulated device teach as much as on the simulated rig."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.cpx_e.emulator import ROOT, Emulator
from tests.cpx_e.rig import describe_machine, describe_rig

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
pytestmark = pytest.mark.realtime

STUDY = (
    "plant=nominal",
    "participant=p1",
    "exoskeleton.sampling_rate_hz=100",
    "exoskeleton.trial_s=2.0",
    "bank.trajectories=14",
    "subsampling.experiments=1",
    "subsampling.initial_trials=2",
    "active_loop.trials=10",
    "active_loop.controls=[]",
)
SEEDS = range(5)
PATIENT = ("rig.device.watchdog_s=2.0", "rig.device.reply_s=0.8", "rig.guard.missed_share=0.6")
"""What is learnt is asked here, not what stops a trial when the computer is late."""


def identify(outputs, *arguments):
    """Run the study; return the mean error rate of the models before and after ten trials."""
    command = [sys.executable, "-m", "pipeline", *STUDY, *arguments, f"outputs={outputs}"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    (table,) = outputs.glob("runs/*/tables/final_errors.parquet")
    errors = pd.read_parquet(table).query("tested_on == 'bank' and muscle == 'mean'").iloc[0]
    return errors["before"], errors["after"]


def test_the_error_rate_is_that_of_the_simulated_rig_within_its_spread(tmp_path):
    section = describe_rig("exoskeleton.trial_s=2.0", *PATIENT)
    with Emulator(describe_machine(section)) as emulator:
        before, after = identify(
            tmp_path / "emulated",
            "rig=festo_cpx",
            *PATIENT,
            "rig._target_=tests.cpx_e.rig.ToldFestoCpx",
            "rig.device.host=127.0.0.1",
            f"rig.device.port={emulator.port}",
            f"+rig.control_port={emulator.control_port}",
        )
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        folders, seeds = [tmp_path / str(seed) for seed in SEEDS], [f"seed={seed}" for seed in SEEDS]
        simulated = list(pool.map(identify, folders, seeds, [f"bank.seed={2000 + seed}" for seed in SEEDS]))
    known = np.log([error for _, error in simulated])
    reach = stats.t.ppf(0.995, len(known) - 1) * known.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(known))
    told = f"{after:.4f}, simulated {np.exp(known.mean()):.4f} ({np.exp(known.min()):.4f} to {np.exp(known.max()):.4f})"
    assert after < before
    assert abs(np.log(after) - known.mean()) < reach, told
    assert reach < np.log(3.0), told
    print(told)
