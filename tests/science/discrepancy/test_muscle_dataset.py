"""Trials of different lengths come through whole: what one lacks counts for nothing, what another has is kept."""

import numpy as np

from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.recording.datasets import tabulate_session
from tests.science.discrepancy.searches import DISCREPANCY
from tests.science.discrepancy.sessions import record_session


def test_a_shorter_trial_shortens_no_other():
    samples, meta = record_session(trials=6, seconds=0.6, muscles=("pam1",))
    samples = samples[(samples["trial"] != 2) | (samples["time_s"] < 0.4)]
    rows = samples.groupby("trial").size()
    assert rows[2] < rows[1]
    for output in build_muscle_channels(tabulate_session(samples, meta, "short"), DISCREPANCY):
        np.testing.assert_array_equal(output.present.sum(axis=0), rows)
        own = samples.pivot(index="time_s", columns="trial", values=output.channel)
        np.testing.assert_allclose(output.measured[output.present], own.to_numpy()[output.present])
