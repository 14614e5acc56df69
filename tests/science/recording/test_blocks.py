"""Records and their blocks."""

import numpy as np
import pandas as pd
import pytest

from stages.science.recording.blocks import list_blocks, number_blocks, split_records


def frame(parts):
    return pd.DataFrame({"part": list(parts), "time_s": np.arange(len(parts)) * 0.5})


def test_each_run_of_a_part_is_a_record_and_a_column_of_records_is_believed():
    found = split_records(frame("aabbbaac"))
    assert list(found["record"]) == ["a", "a", "b", "b", "b", "a_2", "a_2", "c"]
    assert list(found["part"]) == list("aabbbaac")
    found = split_records(pd.DataFrame({"record": ["x", "x", "y"], "time_s": [0.0, 1.0, 0.0]}))
    assert list(found["record"]) == ["x", "x", "y"]
    assert found["part"].eq("given").all()


@pytest.mark.parametrize(
    ("times", "records"),
    [
        ([0, 1, 2, 0, 1, 2, 3], "given given given given_2 given_2 given_2 given_2"),
        ([0, 1, 2, 90, 91, 92, 93], "given given given given_2 given_2 given_2 given_2"),
        ([0, 1, 2, 6, 7, 8, 9], " ".join(["given"] * 7)),
        ([*range(20), 18, *range(20, 40)], " ".join(["given"] * 41)),
    ],
)
def test_a_record_begins_where_time_begins_anew_and_not_at_a_gap_or_where_rows_are_out_of_order(times, records):
    assert split_records(pd.DataFrame({"time_s": np.array(times, dtype=float)}))["record"].tolist() == records.split()


@pytest.mark.parametrize("sizes", [[100], [16, 33, 1000], [5, 40]])
def test_blocks_partition_every_record_evenly_and_in_order(sizes):
    records = split_records(frame("".join(letter * size for letter, size in zip("abc", sizes, strict=False))))
    records = records.assign(trial=number_blocks(records, 16))
    assert (records["trial"].diff().dropna().isin([0, 1])).all()
    lengths = records.groupby(["record", "trial"]).size()
    assert lengths.groupby("record").agg(np.ptp).max() <= 1
    assert lengths.groupby("record").size().to_dict() == dict(zip("abc", np.minimum(sizes, 16), strict=False))
    listed = list_blocks(records, 2.0)
    assert listed["duration_s"].sum() == sum(sizes) / 2.0
    assert list(listed["trial"]) == list(range(len(listed)))
