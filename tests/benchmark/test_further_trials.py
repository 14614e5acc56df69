"""Further trials of a hidden session: they are the same machine's, and the loop that chooses them."""

import numpy as np
import pandas as pd
import pytest

from stages.benchmark.blinded_rig.sessions import HiddenSessions
from stages.science.recording.datasets import tabulate_session


@pytest.mark.parametrize("catalogue", ["own", "foreign_building"])
def test_a_recorded_trial_that_is_prescribed_again_is_recorded_again_but_for_noise(catalogue):
    rig = HiddenSessions(3, "coulomb_friction", "strong", None, 4, catalogue)
    session = rig.record()
    tables = tabulate_session(session.samples, session.meta, "")
    joint = tables.measured_muscles.set_index("muscle")["joint"]
    trial = session.samples[session.samples["trial"] == 2].groupby("muscle")
    command = {name: rows["pressure_command_kpa"].to_numpy() for name, rows in trial}
    angle = {joint[name]: rows["joint_angle_rad"].to_numpy() for name, rows in trial}
    step_s = 1.0 / session.meta["sampling_rate_hz"]
    again, starts = rig.prescribe(command, angle, step_s, 0)
    assert set(again["trial"]) == {4}
    assert starts[0] > session.meta["trial_start_s"][-1] + session.meta["trial_s"]
    for name, rows in again.groupby("muscle"):
        first = trial.get_group(name)
        np.testing.assert_array_equal(rows["pressure_command_kpa"], first["pressure_command_kpa"])
        np.testing.assert_allclose(rows["contraction"], first["contraction"], atol=1e-4)
        for channel in ("pressure_kpa", "force_n"):
            same, other = (each[channel].to_numpy()[round(0.5 / step_s) :] for each in (first, rows))
            assert 0.0 < np.sqrt(np.mean((same - other) ** 2)) < 0.04 * np.ptp(same)
    later, _ = rig.prescribe(command, angle, step_s, 1)
    assert set(later["trial"]) == {5}
    assert not np.array_equal(later["force_n"], again["force_n"])
    repeated, _ = rig.prescribe(command, angle, step_s, 0)
    pd.testing.assert_frame_equal(repeated, again)


@pytest.mark.slow
def test_the_loop_records_what_it_chose_and_the_search_has_it(pamid):
    hidden = ("experiment=hidden_effect", "seed=3", "rig.effect=stribeck_friction", "rig.magnitude=weak")
    stages = "stages=[blinded_session,further_trials,measurement,locate_gap]"
    told = pamid(*hidden, "rig.trials=6", "next_trials=1", "figures=[]", stages)
    assert told.returncode == 0, told.stderr
    folder = pamid.runs[-1] / "tables"
    chosen = pd.read_parquet(folder / "further_trials.parquet")
    assert list(chosen["trial"]) == [6]
    assert {"stribeck_friction", "coulomb_friction"} <= set(chosen["rivals"].item().split(","))
    assert chosen["expected_after"].item() > chosen["expected_before"].item()
    parts = pd.read_parquet(folder / "trial_parts.parquet").set_index("trial")["part"]
    assert parts[6] == "fitted"
    assert len(parts) == 7
    measured = pd.read_parquet(folder / "measured.parquet")
    assert measured["trial"].nunique() == 7
    assert len(set(measured.groupby("trial").size())) == 1
