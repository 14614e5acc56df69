"""The clock of a recording, against clocks whose truth is known."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.clock import find_rate, regularise
from stages.science.recording.columns import RecordingError


def stream(times, trial=0, muscle="pam1"):
    return pd.DataFrame(
        {"trial": trial, "muscle": muscle, "time_s": times, "value": np.arange(len(times), dtype=float)}
    )


@pytest.mark.parametrize("rate", [1.0, 100.0, 250.0, 333.0, 610.3515625, 10000.0])
def test_finds_the_rate_of_a_clock_with_gaps(rate):
    samples = np.delete(np.arange(500), [3, 4, 100, *range(200, 260)])
    assert find_rate(stream(samples / rate), ["trial", "muscle"], None) == pytest.approx(rate, rel=1e-8)


def test_finds_the_rate_of_a_rounded_clock():
    assert find_rate(stream((np.arange(3001) / 300.0).round(3)), ["trial"], None) == pytest.approx(300.0, rel=1e-6)


def test_a_clock_that_drifts_within_the_jitter_loses_no_sample():
    found, _ = regularise(stream(np.arange(5000) * 0.004 * 1.002), "trial", ["muscle"], 250.0, 0.01)
    assert list(found["value"]) == list(range(5000))


def test_muscles_that_start_and_end_apart_share_a_grid():
    early, late = stream(np.arange(10) * 0.01), stream(np.arange(3, 15) * 0.01, muscle="pam2")
    found, starts = regularise(pd.concat([early, late], ignore_index=True), "trial", ["muscle"], 100.0, 0.01)
    wide = found.pivot(index="time_s", columns="muscle", values="value")
    np.testing.assert_allclose(wide.index, np.arange(15) * 0.01)
    assert wide["pam1"].isna().tolist() == [False] * 10 + [True] * 5
    assert wide["pam2"].isna().tolist() == [True] * 3 + [False] * 12
    assert starts.to_dict() == {0: 0.0}


def test_jitter_is_refused_with_its_rows():
    times = np.arange(20) * 0.01
    times[7] += 0.0002
    with pytest.raises(RecordingError, match=r"got a deviation of 0\.02 in rows 7, 8; resample it"):
        regularise(stream(times), "trial", ["muscle"], 100.0, 0.01)
    regularise(stream(times), "trial", ["muscle"], 100.0, 0.03)


def test_times_closer_than_a_period_are_refused():
    with pytest.raises(RecordingError, match="in row 2"):
        regularise(stream(np.array([0.0, 0.01, 0.012, 0.022])), "trial", ["muscle"], 100.0, 0.4)


@pytest.mark.parametrize("times", [[0.0], [1.0, 1.0, 1.0]])
def test_a_clock_that_does_not_run_is_refused(times):
    with pytest.raises(RecordingError, match="column time_s: expected"):
        find_rate(stream(np.array(times)), ["trial"], None)
