"""Which columns label records: those that stay, and change wherever time begins anew."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.labels import list_labels

ROWS, RECORDS = 20, 3
TIME = pd.Series(np.tile(np.arange(ROWS) * 0.1, RECORDS))
PART = np.repeat(np.arange(RECORDS), ROWS)


@pytest.mark.parametrize(
    ("values", "labels"),
    [
        (PART, True),
        (PART.astype(float), True),
        (np.array(["a", "b", "c"])[PART], True),
        (PART + 0.5, True),  # a load that was set for each
        (PART + 0.5 * (np.arange(ROWS * RECORDS) > 5), False),  # a signal that rests elsewhere too
        (np.sin(np.arange(ROWS * RECORDS)), False),  # a signal
        (np.arange(ROWS * RECORDS), False),  # counts rows
        (PART % 2, False),  # a label that comes again
        (np.minimum(PART, 1), False),  # time begins anew within one
        (np.where(np.arange(ROWS * RECORDS) == 5, np.nan, PART), False),
    ],
    ids=["whole", "whole_as_float", "text", "fraction", "rests", "signal", "row", "again", "too_few", "gap"],
)
def test_what_stays_and_changes_with_time_is_a_label(values, labels):
    for time in (TIME, np.arange(ROWS * RECORDS) * 0.1 + 60.0 * PART):  # a clock that runs on, with pauses
        found = list_labels({"t": pd.Series(time), "column": pd.Series(values)}, "t")
        assert found == (["column"] if labels else [])


def test_without_a_time_that_begins_anew_nothing_is_a_label():
    columns = {"t": pd.Series(np.arange(ROWS * RECORDS) * 0.1), "column": pd.Series(PART)}
    assert list_labels(columns, "t") == list_labels(columns, None) == []


def test_a_text_tells_apart_records_whose_rows_take_turns():
    times = pd.Series(np.repeat(np.arange(200) * 0.01, 2))
    turns, other = (pd.Series(np.array(["a", "b"])[np.arange(400) // every % 2]) for every in (1, 2))
    assert list_labels({"t": times, "x": np.sin(times), "turns": turns}, "t") == ["turns"]
    assert list_labels({"t": times, "x": np.sin(times), "other": other}, "t") == []  # with it times come twice too
    assert list_labels({"t": pd.Series(np.arange(400) * 0.01), "turns": turns}, "t") == []
