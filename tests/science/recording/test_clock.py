"""Clocks of recordings, even and uneven, against clocks whose truth is known."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.clock import find_rate, regularise
from stages.science.recording.columns import RecordingError
from stages.science.recording.uneven import even_out


def stream(times, trial=0, muscle="pam1"):
    values = np.arange(len(times), dtype=float)
    return pd.DataFrame({"trial": trial, "muscle": muscle, "time_s": times, "value": values})


@pytest.mark.parametrize("rate", [1.0, 100.0, 250.0, 333.0, 610.3515625, 10000.0])
def test_finds_the_rate_of_a_clock_with_gaps_or_rounded(rate):
    samples = np.delete(np.arange(500), [3, 4, 100, *range(200, 260)])
    assert find_rate(stream(samples / rate), ["trial", "muscle"], None) == pytest.approx(rate, rel=1e-8)
    rounded = stream((np.arange(3001) / 300.0).round(3))
    assert find_rate(rounded, ["trial"], None) == pytest.approx(300.0, rel=1e-6)


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
    with pytest.raises(RecordingError, match="in row 2"):
        regularise(stream(np.array([0.0, 0.01, 0.012, 0.022])), "trial", ["muscle"], 100.0, 0.4)


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_dates_that_are_no_seconds_are_refused_with_their_unit(scale, unit):
    rows = pd.DataFrame({"record": "", "time_s": scale * (1.76e9 + 0.1 * np.arange(9))})
    with pytest.raises(RecordingError, match=f"later than any date; set units.time_s={unit}$"):
        find_rate(rows, ["record"], None)


@pytest.mark.parametrize("times", [[0.0], [1.0, 1.0, 1.0]])
def test_a_clock_that_does_not_run_is_refused(times):
    with pytest.raises(RecordingError, match="column time_s: expected"):
        find_rate(stream(np.array(times)), ["trial"], None)


def record(times, values=None, name="given"):
    values = np.sin(3.0 * times) if values is None else values
    return pd.DataFrame({"record": name, "part": "given", "time_s": times, "force_n": values})


def even(frame):
    notes = []
    return even_out(frame, ["force_n"], 0.01, notes), notes


@pytest.mark.parametrize("decimals", [2, 3, 4])
@pytest.mark.parametrize("lost", [[], [700, 701, 1500]])
def test_a_rounded_clock_is_counted(decimals, lost):
    true = np.delete(5.0 + np.arange(3000) / 610.0, lost if decimals > 2 else [])
    found, notes = even(record(true.round(decimals), np.sin(3.0 * true)))
    digit = 10.0**-decimals
    assert np.abs(found["time_s"] - true).max() < 0.1 * digit + 1e-6
    np.testing.assert_allclose(np.diff(found["time_s"]) * 610.0, np.diff(true) * 610.0, rtol=1e-4)
    np.testing.assert_array_equal(found["force_n"], np.sin(3.0 * true))
    assert notes == [("record given", f"its times are rounded to {digit:g} s: samples counted at 610 Hz")]


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
    ends = [lost.min(), lost[lost < 7.0].max(), lost[lost > 7.0].min(), lost.max()]
    assert ends == pytest.approx([5.0, 5.2, 10.0, 10.3], abs=0.02)
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


def test_a_row_that_was_written_twice_is_no_rounded_clock():
    frame = record(np.insert(np.arange(2000) * 0.01, 500, 4.99))
    assert even(frame)[0] is frame


def test_steps_of_all_sizes_are_refused(generator):
    times = np.cumsum(generator.lognormal(-4.0, 2.0, 300))
    told = r"expected samples about evenly in time, got time steps of .* resample it"
    with pytest.raises(RecordingError, match=told):
        even(record(times))
