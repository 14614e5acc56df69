"""Contracts of tables, on write and on read."""

import pandas as pd
import pyarrow.parquet
import pytest

from pipeline.errors import TableError
from pipeline.table import Table, column

FORCES = Table(
    "forces",
    "A force",
    {
        "time_s": column(float, "since start", unit="s", low=0),
        "force_n": column(float, "tension", unit="N", low=0, high=100),
    },
    key=("time_s",),
)
GOOD = pd.DataFrame({"time_s": [0.0, 0.1, 0.2], "force_n": [1.0, 2.0, 3.0]})


def test_round_trip_keeps_values_and_units(tmp_path):
    FORCES.write(GOOD, tmp_path / "forces.parquet")
    pd.testing.assert_frame_equal(FORCES.read(tmp_path / "forces.parquet"), GOOD)
    schema = pyarrow.parquet.read_schema(tmp_path / "forces.parquet")
    assert schema.field("force_n").metadata[b"unit"] == b"N"
    assert schema.metadata[b"title"] == b"A force"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"force_n": [1.0, float("nan"), 3.0]}, "column force_n: expected no missing value, got nan in row 1"),
        ({"force_n": [1.0, 2.0, -3.0]}, r"column force_n: expected greater_than_or_equal_to\(0\), got -3.0 in row 2"),
        ({"force_n": [1.0, 2000.0, 3000.0]}, r"expected less_than_or_equal_to\(100\), got 2000.0 in rows 1, 2"),
        ({"force_n": ["a", "b", "c"]}, "column force_n: expected dtype"),
        ({"force_n": [1, 2, 3]}, "column force_n: expected dtype"),
        ({"time_s": [0.0, 0.1, 0.1]}, r"row 2 repeats the key \(time_s 0.1\)"),
    ],
)
def test_refuses_what_breaks_the_contract(tmp_path, change, told):
    with pytest.raises(TableError, match=told):
        FORCES.write(GOOD.assign(**change), tmp_path / "forces.parquet")
    assert list(tmp_path.iterdir()) == []


def test_read_refuses_truncated_foreign_and_absent_files(tmp_path):
    path = tmp_path / "forces.parquet"
    with pytest.raises(TableError, match="is absent"):
        FORCES.read(path)
    FORCES.write(GOOD, path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(TableError, match="is not a whole Parquet file"):
        FORCES.read(path)
    path.write_text("time_s,force_n\n")
    with pytest.raises(TableError, match="is not a whole Parquet file"):
        FORCES.read(path)
    GOOD.drop(columns="force_n").to_parquet(path)
    with pytest.raises(TableError, match="lacks force_n"):
        FORCES.read(path)
