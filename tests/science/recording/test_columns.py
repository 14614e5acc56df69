"""Columns of a file under this project's names."""

import pandas as pd
import pytest

from stages.science.recording.columns import RecordingError, adopt, find_mark

READINGS = [10.0 * each for each in range(20)]


@pytest.mark.parametrize(
    ("told", "names"),
    [([1.0, 2.0], ["1", "2"]), ([0.5, 2.0], ["0.5", "2.0"]), (["1.0", "b"], ["1.0", "b"]), ([7, 8], ["7", "8"])],
)
def test_records_that_are_numbered_are_named_by_whole_numbers(told, names):
    frame = pd.DataFrame({"run": told, "t": [0.0, 1.0]})
    assert list(adopt(frame, {"record": "run", "time_s": "t"}, {}, ["record"], ["record"])["record"]) == names


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ([*READINGS, -999.0, -999.0], r"column F: 2 values are -999, far from all readings \(0 to 190\); leave empty"),
        ([*READINGS, 65535.0, 65535.0, 65535.0], "column F: 3 values are 65535, far from all readings"),
        ([*READINGS, 999.0], ""),
        ([*READINGS, 999.0, 999.0, 950.0], ""),
        ([0.0, 1.0, 999.0, 999.0], ""),
    ],
)
def test_a_number_that_marks_what_was_not_read_is_refused_and_one_that_may_be_a_reading_is_not(values, told):
    frame = pd.DataFrame({"F": values})
    how = {"columns": {"force_n": "F"}, "units": {}, "names": (), "needed": ()}
    if told:
        with pytest.raises(RecordingError, match=told):
            adopt(frame, **how)
    else:
        assert adopt(frame, **how)["force_n"].tolist() == values
        assert bool(find_mark(frame["F"], least=1)) == (values == [*READINGS, 999.0])
