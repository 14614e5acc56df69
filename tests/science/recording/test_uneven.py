"""Records whose clocks do not tick evenly, against the even clocks that they come from."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.columns import RecordingError
from stages.science.recording.uneven import even_out

RATE_HZ = 610.0


def record(times, values=None, name="given"):
    values = np.sin(3.0 * times) if values is None else values
    return pd.DataFrame({"record": name, "part": "given", "time_s": times, "force_n": values})


def even(frame):
    notes = []
    return even_out(frame, ["force_n"], 0.01, notes), notes


@pytest.mark.parametrize("decimals", [2, 3, 4])
@pytest.mark.parametrize("lost", [[], [700, 701, 1500]])
def test_a_rounded_clock_is_counted(decimals, lost):
    true = np.delete(5.0 + np.arange(3000) / RATE_HZ, lost if decimals > 2 else [])
    found, notes = even(record(true.round(decimals), np.sin(3.0 * true)))
    digit = 10.0**-decimals
    assert np.abs(found["time_s"] - true).max() < 0.1 * digit + 1e-6
    np.testing.assert_allclose(np.diff(found["time_s"]) * RATE_HZ, np.diff(true) * RATE_HZ, rtol=1e-4)
    np.testing.assert_array_equal(found["force_n"], np.sin(3.0 * true))
    assert notes == [("record given", f"its times are rounded to {digit:g} s: samples counted at {RATE_HZ:g} Hz")]


def test_a_jittered_clock_gives_way_to_an_even_one(generator):
    times = np.arange(3000) * 0.002 + generator.uniform(-0.0006, 0.0006, 3000)
    found, notes = even(record(times))
    steps = np.diff(found["time_s"])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert 1.0 / steps[0] == pytest.approx(500.0, rel=1e-3)
    assert np.abs(found["force_n"] - np.sin(3.0 * found["time_s"])).max() < 1e-4  # of lines across 6 ms at most
    assert len(notes) == 1
    assert "put on an even clock of" in notes[0][1]


def test_what_was_not_measured_stays_so(generator):
    times = np.arange(2000) * 0.01 + generator.uniform(-0.002, 0.002, 2000)
    frame = record(times)
    frame.loc[500:520, "force_n"] = np.nan
    found, _ = even(frame.drop(index=range(1000, 1030)))
    lost = found.loc[found["force_n"].isna(), "time_s"]
    assert lost.min() == pytest.approx(5.0, abs=0.02)
    assert lost[lost < 7.0].max() == pytest.approx(5.2, abs=0.02)
    assert lost[lost > 7.0].min() == pytest.approx(10.0, abs=0.02)
    assert lost.max() == pytest.approx(10.3, abs=0.02)
    assert len(lost) == pytest.approx(51, abs=4)


def test_even_clocks_are_left_alone_beside_uneven_ones(generator):
    plain = record(np.delete(np.arange(400) * 0.01, [7, 90, 91]), name="a")
    shaky = record(np.arange(400) * 0.01 + generator.uniform(-0.003, 0.003, 400), name="b")
    assert even(plain)[0] is plain
    found, notes = even(pd.concat([plain, shaky], ignore_index=True))
    pd.testing.assert_frame_equal(found[found["record"] == "a"], plain)
    assert [about for about, _ in notes] == ["record b"]


@pytest.mark.parametrize("times", [np.repeat([0.1, 0.2, 0.7], 5), np.array([3.0, 2.0] * 6), np.full(12, np.nan)])
def test_times_that_are_wrong_are_left_to_be_refused(times):
    frame = record(times, np.arange(len(times), dtype=float))
    assert even(frame)[0] is frame


def test_steps_of_all_sizes_are_refused(generator):
    times = np.cumsum(generator.lognormal(-4.0, 2.0, 300))
    with pytest.raises(
        RecordingError, match=r"expected samples about evenly in time, got time steps of .* resample it"
    ):
        even(record(times))
