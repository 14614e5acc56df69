"""Any frame, any contract: a table comes back exactly as it went in, or is refused in one line that says why."""

import math
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import TableError
from pipeline.page import make_grid
from pipeline.printing import format_value
from pipeline.table import Table, column, read_frame
from tests.faults import overwrite

COMMON = settings(derandomize=True, deadline=None, max_examples=100)
INT64 = st.integers(-(2**63), 2**63 - 1)
CHARACTERS = st.one_of(st.integers(0, 0xD7FF), st.integers(0xE000, 0x10FFFF)).map(chr)
"""All but surrogates, without the tables of Unicode that `st.text` takes seconds to make."""
TEXTS = st.one_of(
    st.lists(CHARACTERS, max_size=8).map("".join),
    st.sampled_from(["", "\x00", "é", "\U0001f600", "a\nb", "NaN", "x" * 100_000]),
)
VALUES = {
    int: st.one_of(INT64, st.sampled_from([-(2**63), 2**63 - 1, 0, 2**53 + 1])),
    float: st.floats(allow_nan=False),
    str: TEXTS,
    bool: st.booleans(),
}
DTYPES = {int: np.dtype("int64"), float: np.dtype("float64"), bool: np.dtype("bool"), str: pd.Series(["a"]).dtype}
INDEXES = {
    "default": lambda n: pd.RangeIndex(n),
    "reversed": lambda n: pd.RangeIndex(n, 0, -1),
    "repeated": lambda n: pd.Index(["twice"] * n, dtype=object),
    "levels": lambda n: pd.MultiIndex.from_arrays([["a"] * n, range(n)], names=["time_s", "c0"]),
}


@st.composite
def contracts(draw):
    """Draw the plain rules of a contract, one mapping for each column."""
    rules = {}
    for index in range(draw(st.integers(1, 4))):
        dtype = draw(st.sampled_from([int, float, str, bool]))
        rule = {"dtype": dtype, "nullable": draw(st.booleans())}
        for limit, range_of in (("low", (-5, 0)), ("high", (0, 5))):
            if dtype in (int, float) and draw(st.booleans()):
                rule[limit] = draw(st.integers(*range_of))
        if dtype is not bool and draw(st.integers(0, 3)) == 0:
            rule["among"] = draw(st.lists(VALUES[dtype], min_size=1, max_size=3))
        rules[f"c{index}"] = rule
    key = draw(st.lists(st.sampled_from(sorted(rules)), unique=True, max_size=2))
    return rules, tuple(key)


def make_table(rules, key=()):
    columns = {name: column(description=f"column {name}", unit="N", **rule) for name, rule in rules.items()}
    return Table("drawn", "A drawn row", columns, key=key)


def is_missing(value):
    return value is None or (isinstance(value, float) and math.isnan(value))


def keeps(rule, value):
    """Tell by the words of the contract, not by pandera, whether it allows a value."""
    if is_missing(value):
        return rule["nullable"] and rule["dtype"] in (float, str)
    return (
        isinstance(value, rule["dtype"])
        and ("low" not in rule or value >= rule["low"])
        and ("high" not in rule or value <= rule["high"])
        and ("among" not in rule or value in rule["among"])
    )


@st.composite
def frames(draw, rules):
    """Draw the values of a frame, most of which keep the rules, and the frame."""
    count = draw(st.integers(0, 6))
    values, series = {}, {}
    for name, rule in rules.items():
        allowed = VALUES[rule["dtype"]]
        if "among" in rule:
            allowed = st.sampled_from(rule["among"])
        elif rule["dtype"] in (int, float) and draw(st.integers(0, 4)):
            allowed = st.integers(rule.get("low", -9), rule.get("high", 9)).map(rule["dtype"])
        if rule["dtype"] in (float, str) and (rule["nullable"] or draw(st.integers(0, 5)) == 0):
            missing = st.just(math.nan) if rule["dtype"] is float else st.sampled_from([None, math.nan])
            allowed = st.one_of(allowed, missing)
        values[name] = draw(st.lists(allowed, min_size=count, max_size=count))
        text_as = draw(st.sampled_from([object, DTYPES[str]]))
        series[name] = pd.Series(values[name], dtype=text_as if rule["dtype"] is str else DTYPES[rule["dtype"]])
    frame = pd.DataFrame(series)
    frame.index = INDEXES[draw(st.sampled_from(sorted(INDEXES)))](count)
    return values, frame


def write_and_read(table, frame):
    """Return what is read again, or the error of writing after which nothing may be left."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.parquet"
        try:
            table.write(frame, path)
        except TableError as error:
            assert list(Path(folder).iterdir()) == []
            return error
        return table.read(path)


def assert_one_line(error):
    assert isinstance(error, TableError)
    assert str(error).isprintable()
    assert len(str(error)) < 1000


def assert_same(found, values, dtypes):
    assert list(found.columns) == list(values)
    assert found.index.equals(pd.RangeIndex(len(found)))
    for name, expected in values.items():
        assert found[name].dtype == dtypes[name]
        assert len(found) == len(expected)
        for got, put in zip(found[name], expected, strict=True):
            if is_missing(put):
                assert is_missing(got)
            else:
                assert got == put
                assert math.copysign(1, got) == math.copysign(1, put) if isinstance(put, float) else True


@COMMON
@given(st.data())
def test_a_frame_comes_back_exactly_or_is_refused_by_name(data):
    rules, key = data.draw(contracts())
    values, frame = data.draw(frames(rules))
    before = frame.copy()
    found = write_and_read(make_table(rules, key), frame)
    pd.testing.assert_frame_equal(frame, before)

    broken = [name for name, rule in rules.items() if not all(keeps(rule, value) for value in values[name])]
    rows = list(zip(*([None if is_missing(each) else each for each in values[name]] for name in key), strict=True))
    if broken:
        assert_one_line(found)
        assert re.search(rf"column ({'|'.join(broken)}): expected", str(found))
    elif key and len(set(rows)) < len(rows):
        assert_one_line(found)
        assert f"repeats the key ({key[0]} " in str(found)
    else:
        assert_same(found, values, {name: DTYPES[rule["dtype"]] for name, rule in rules.items()})


FOREIGN = {
    "float for int": (int, lambda n: np.linspace(0.5, 1, n)),
    "int for float": (float, lambda n: np.arange(n)),
    "narrow int": (int, lambda n: np.arange(n, dtype="int32")),
    "unsigned": (int, lambda n: np.arange(n, dtype="uint64")),
    "narrow float": (float, lambda n: np.arange(n, dtype="float32")),
    "int for bool": (bool, lambda n: np.ones(n, dtype=int)),
    "missing bool": (bool, lambda n: pd.Series([None] * n, dtype=object)),
    "number in text": (str, lambda n: pd.Series(["a", *range(n)][:n][::-1], dtype=object)),
    "list in text": (str, lambda n: pd.Series([[1]] * n, dtype=object)),
    "bytes": (str, lambda n: pd.Series([b"a"] * n, dtype=object)),
    "surrogate": (str, lambda n: pd.Series(["\ud800"] * n, dtype=object)),
    "categories": (str, lambda n: pd.Categorical(["a"] * n)),
    "coded numbers": (int, lambda n: pd.Categorical([1] * n)),
    "text for float": (float, lambda n: pd.Series(["1.0"] * n)),
    "times": (float, lambda n: pd.Series(pd.to_datetime([0] * n))),
    "complex": (float, lambda n: np.ones(n) * 1j),
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("nullable", [False, True])
@pytest.mark.parametrize("key", [(), ("wrong",)])
def test_a_column_of_another_type_is_named(kind, nullable, key):
    dtype, make = FOREIGN[kind]
    table = make_table({"fine": {"dtype": int}, "wrong": {"dtype": dtype, "nullable": nullable}}, key)
    for count in (2, 5):
        error = write_and_read(table, pd.DataFrame({"fine": range(count), "wrong": make(count)}))
        assert_one_line(error)
        assert "column wrong: expected" in str(error)


@COMMON
@given(st.data())
def test_other_columns_are_named(data):
    rules, key = data.draw(contracts())
    names = data.draw(st.lists(st.sampled_from([*rules, "other", "a\nb", 0]), max_size=6))
    frame = pd.DataFrame(np.zeros((data.draw(st.integers(0, 2)), len(names))), columns=names)
    found = write_and_read(make_table(rules, key), frame)
    if names == list(rules) and not isinstance(found, TableError):
        return
    assert isinstance(found, TableError)
    assert str(found).isprintable() or "a\nb" in names
    if names != list(rules):
        assert f"expected columns {', '.join(rules)}" in str(found)
        assert all(str(name) in str(found) for name in {*rules} ^ {*names})


def test_text_is_of_one_type_however_it_was_held():
    table = make_table({"c0": {"dtype": str, "nullable": True}})
    for values in (["a", None], [None, None], []):
        for dtype in (object, DTYPES[str]):
            found = write_and_read(table, pd.DataFrame({"c0": pd.Series(values, dtype=dtype)}))
            assert_same(found, {"c0": values}, {"c0": DTYPES[str]})


def test_a_huge_value_is_not_repeated_in_full():
    error = write_and_read(make_table({"c0": {"dtype": str, "among": ["a"]}}), pd.DataFrame({"c0": ["b\n" * 10**6]}))
    assert_one_line(error)


GOOD = pd.DataFrame({"i": [1, -(2**62)], "f": [0.1, math.nan], "s": ["aé", None], "b": [True, False]})
TYPES = {"i": int, "f": float, "s": str, "b": bool}
TABLE = make_table({name: {"dtype": dtype, "nullable": dtype in (float, str)} for name, dtype in TYPES.items()})


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "drawn.parquet"
    TABLE.write(GOOD, path)
    return path, path.read_bytes()


def read_exactly_or_refuse(path, read=TABLE.read):
    """Return whether a damaged file was refused; when it was not, it must read as the original."""
    try:
        found = read(path)
    except TableError as error:
        assert_one_line(error)
        return True
    pd.testing.assert_frame_equal(found, GOOD, check_exact=True)
    return False


def flip(path, content, places, masks=(1,)):
    """Yield each place of a file while its byte there is changed; the file is neither closed nor emptied between."""
    path.write_bytes(content)
    with path.open("r+b", buffering=0) as handle:
        for at in places:
            handle.seek(at)
            handle.write(bytes([content[at] ^ masks[at % len(masks)]]))
            yield at
            handle.seek(at)
            handle.write(content[at : at + 1])


def test_a_file_with_any_byte_flipped_is_noticed(file):
    path, content = file
    flipped = flip(path, content, range(len(content)), (1, 255, 2, 4, 8, 16, 32, 64, 128))
    refused = sum(read_exactly_or_refuse(path, read_frame) for _ in flipped)
    assert refused > 0.97 * len(content)


def test_a_file_cut_at_any_byte_is_refused(file):
    path, content = file
    path.write_bytes(content)
    for at in reversed([*range(0, len(content) - 200, 11), *range(len(content) - 200, len(content))]):
        os.truncate(path, at)
        assert read_exactly_or_refuse(path)


@COMMON
@given(st.data())
def test_a_file_damaged_anywhere_reads_exactly_or_is_refused(file, data):
    path, content = file
    start = data.draw(st.integers(0, len(content)))
    stop = min(len(content), start + data.draw(st.integers(0, 64)))
    put = data.draw(st.one_of(st.binary(max_size=64), st.just(b"\0" * (stop - start))))
    path.write_bytes(content[:start] + put + content[stop:])
    if path.read_bytes() != content:
        read_exactly_or_refuse(path)


def test_a_file_of_others_without_a_digest_is_read_or_refused(file):
    path, _ = file
    GOOD.set_index(pd.Index(["x", "y"])).to_parquet(path)
    pd.testing.assert_frame_equal(TABLE.read(path), GOOD)
    GOOD[["i"]].assign(i=[1.5, 2.5]).set_index(pd.Index(["x", "y"])).to_parquet(path)
    table = make_table({"i": {"dtype": int}})
    with pytest.raises(TableError, match="column i: expected dtype"):
        table.read(path)
    content = path.read_bytes()
    for _ in flip(path, content, range(len(content) % 7, len(content), 7)):
        with pytest.raises(TableError):
            table.read(path)


def test_text_that_looks_like_a_digest_does_no_harm():
    seal = "SHA-256 of this file with these digits zero: "
    values = {"c0": [text * count for text in (seal, seal + "0" * 64, seal + "f" * 64) for count in (1, 2)]}
    for rows in (slice(0, 2), slice(2, 4), slice(4, 6)):
        held = {"c0": values["c0"][rows]}
        assert_same(write_and_read(make_table({"c0": {"dtype": str}}), pd.DataFrame(held)), held, {"c0": DTYPES[str]})


FORCES = Table(
    "forces",
    "A force",
    {
        "time_s": column(float, "since start", unit="s", low=0),
        "force_n": column(float, "tension", unit="N", low=0, high=100),
    },
    key=("time_s",),
)
FEW = pd.DataFrame({"time_s": [0.0, 0.1, 0.2], "force_n": [1.0, 2.0, 3.0]})


def test_any_reader_reads_values_and_units(tmp_path):
    FORCES.write(FEW, tmp_path / "forces.parquet")
    for read in (FORCES.read, pd.read_parquet):
        pd.testing.assert_frame_equal(read(tmp_path / "forces.parquet"), FEW)
    TABLE.write(GOOD, tmp_path / "drawn.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "drawn.parquet"), GOOD)
    schema = pyarrow.parquet.read_schema(tmp_path / "forces.parquet")
    assert schema.field("force_n").metadata[b"unit"] == b"N"
    assert schema.metadata[b"title"] == b"A force"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"force_n": [1.0, float("nan"), 3.0]}, "column force_n: expected no missing value, got nan in row 1"),
        ({"force_n": [1.0, 2.0, -3.0]}, r"column force_n: expected greater_than_or_equal_to\(0\), got -3.0 in row 2"),
        ({"force_n": [1.0, 2000.0, 3000.0]}, r"expected less_than_or_equal_to\(100\), got 2000.0 in rows 1, 2"),
        ({"time_s": [0.0, 0.1, 0.1]}, r"row 2 repeats the key \(time_s 0.1\)"),
    ],
)
def test_refuses_what_breaks_the_contract(tmp_path, change, told):
    with pytest.raises(TableError, match=told):
        FORCES.write(FEW.assign(**change), tmp_path / "forces.parquet")
    assert list(tmp_path.iterdir()) == []


def test_read_refuses_truncated_foreign_and_absent_files(tmp_path):
    path = tmp_path / "forces.parquet"
    with pytest.raises(TableError, match="is absent"):
        FORCES.read(path)
    FORCES.write(FEW, path)
    for content in (path.read_bytes()[:-20], b"time_s,force_n\n"):
        overwrite(path, content)
        with pytest.raises(TableError, match="is not a whole Parquet file"):
            FORCES.read(path)
    FEW.drop(columns="force_n").to_parquet(path)
    with pytest.raises(TableError, match="lacks force_n"):
        FORCES.read(path)


def test_an_optional_column_may_be_absent_as_a_whole_and_is_checked_where_it_is_there(tmp_path):
    table = Table(
        "t", "a table", {"a": column(int, "a"), "b": column(float, "b", low=0, optional=True), "c": column(int, "c")}
    )
    for frame in (pd.DataFrame({"a": [1], "c": [2]}), pd.DataFrame({"a": [1], "b": [0.5], "c": [2]})):
        table.write(frame, tmp_path / "t.parquet")
        pd.testing.assert_frame_equal(table.read(tmp_path / "t.parquet"), frame)
        pd.testing.assert_frame_equal(table.select(frame.assign(d=0)[["c", "d", *frame.columns[:-1]]]), frame)
    for bad in (-1.0, np.nan):
        with pytest.raises(TableError, match="column b"):
            table.check(pd.DataFrame({"a": [1], "b": [bad], "c": [2]}), "here")
    with pytest.raises(TableError, match="lacks c; expected columns a, b, c"):
        table.check(pd.DataFrame({"a": [1]}), "here")


def test_chances_are_shown_as_far_as_they_can_be_told():
    chance, share = (column(float, "from 0 to 1", low=0, high=1, percent=each) for each in (False, True))
    table = Table(
        "tried",
        "A try",
        {"probability": chance, "p": chance, "part": share, "force": column(float, "force", unit="N", low=0)},
    )
    values = [4.3e-128, 0.25, 1.0 - 1e-12]
    shown, units = table.show(pd.DataFrame(dict.fromkeys(("p", "part", "force"), values)))
    assert [format_value(each) for each in shown["p"]] == ["< 0.0001", "0.25", "> 0.9999"]
    sure, _ = table.show(pd.DataFrame({"probability": [0.0, 1.0], "p": [0.0, 1.0]}))
    assert [*sure["probability"], *sure["p"]] == ["< 0.0001", "> 0.9999", 0.0, 1.0]
    assert [format_value(each) for each in shown["force"]] == ["4.3e-128", "0.25", "1"]
    assert (units["part"], shown["part"][1]) == ("%", 25.0)
    assert make_grid(shown)["numeric"] == [True] * 3
