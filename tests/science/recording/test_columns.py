"""Columns of a file under this project's names."""

import pandas as pd
import pytest

from stages.science.recording.columns import adopt


@pytest.mark.parametrize(
    ("told", "names"),
    [([1.0, 2.0], ["1", "2"]), ([0.5, 2.0], ["0.5", "2.0"]), (["1.0", "b"], ["1.0", "b"]), ([7, 8], ["7", "8"])],
)
def test_records_that_are_numbered_are_named_by_whole_numbers(told, names):
    frame = pd.DataFrame({"run": told, "t": [0.0, 1.0]})
    assert list(adopt(frame, {"record": "run", "time_s": "t"}, {}, ["record"], ["record"])["record"]) == names
