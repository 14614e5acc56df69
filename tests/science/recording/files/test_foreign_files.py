"""Five hundred files as loggers write them, by a hand that knew the docs alone: read as they are, or refused."""

import re

import numpy as np
import pytest

from stages.science.plant.machine import list_signals
from stages.science.recording.columns import RecordingError
from stages.science.recording.dates import read_dates
from stages.science.recording.description import describe
from stages.science.recording.files.readers import FileError, read_columns, read_header
from tests.science.recording.files.foreign_files import make_files

SEED = 4


def count(values):
    """Return a column as numbers: moments as seconds from the first."""
    if values.dtype.kind == "M":
        values = (values - values.iloc[0]).dt.total_seconds()
    if values.dtype.kind not in "iufb":
        values = read_dates(values)
        values = values if values is None else values - values.iloc[0]
    return None if values is None else values.to_numpy(dtype=float)


def find_fault(truth, columns, dropped):
    """Return what of a file is not as it was written, or nothing."""
    for name, expected in truth.columns.items():
        found = count(columns[name]) if name in columns else None
        if found is None:
            return f"{name} is missing or no number, of {list(columns)}"
        whole = np.append(found, np.full(max(len(expected) - len(found), 0), np.nan))  # columns of unequal length
        if len(whole) != len(expected) or not np.allclose(whole, expected, rtol=1e-9, atol=1e-6, equal_nan=True):
            return f"{name} has other values"
    told = {int(line) for remark in dropped for line in re.findall(r"\d+", remark.split(": ")[-1])}
    return "" if set(truth.dropped) <= told else f"lines {truth.dropped} were left out, told are {sorted(told)}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_foreign_files_are_read_as_they_are_or_refused_in_one_line(tmp_path):
    faults = {}
    truths = make_files(tmp_path, SEED)
    for truth in truths:
        path = tmp_path / truth.file
        try:
            header, columns = read_header(path), read_columns(path)
            describe(columns, header, 0.01, list_signals())
        except (FileError, RecordingError) as error:
            if truth.must == "read" or "\n" in str(error):
                faults[truth.file] = str(error)
            continue
        if truth.must == "refuse":
            faults[truth.file] = f"read as {list(columns)}"
        if truth.must == "read" and (fault := find_fault(truth, columns, header.dropped)):
            faults[truth.file] = fault
    assert len(truths) == 500
    assert sum(truth.must == "read" for truth in truths) >= 300
    assert faults == {}
