"""Files of numbers as other programs write them, each written by hand or by the program's own library."""

import gzip

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from stages.science.recording.files.readers import FileError, UnequalColumns, read_columns, read_header, read_samples

HDF5 = b"\x89HDF\r\n\x1a\n"
TIMES, FORCES = [0.0, 0.5, 1.0], [1.5, -2.25, 1000.0]


def refusal(path):
    with pytest.raises(FileError) as refused:
        read_samples(path)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize(
    ("text", "names", "units"),
    [
        ("t,F\n0,1.5\n0.5,-2.25\n1,1000\n", ["t", "F"], {}),
        ("t;F\n0;1,5\n0,5;-2,25\n1;1000\n", ["t", "F"], {}),
        ("t\tF\n0,0\t1,5\n0,5\t-2,25\n1,0\t1e3\n", ["t", "F"], {}),
        ("t F\n0 1.5\n0.5 -2.25\n1 1000\n", ["t", "F"], {}),
        ("  0.0   1.5\n  0.5  -2.25\n  1.0  1000\n", ["column_1", "column_2"], {}),
        ('"t","F"\n"0","1,5"\n"0,5","-2,25"\n"1","1000"\n', ["t", "F"], {}),
        ("t, F\n0, 1.5\n0.5, -2.25\n1, 1000\n", ["t", "F"], {}),
        ("\ufefft;F;\n0;1.5;\n0.5;-2.25;\n1;1000;\n", ["t", "F"], {}),
        ("# rig 3\n% day 2\n\nt,F\n0,1.5\n0.5,-2.25\n1,1000\n", ["t", "F"], {}),
        ("# t F\n0 1.5\n0.5 -2.25\n1 1000\n", ["t", "F"], {}),
        ("#t,F\n#[s],[kN]\n0,1.5\n0.5,-2.25\n1,1000\n", ["t", "F"], {"t": "s", "F": "kN"}),
        ("t,F\ns,kN\n0,1.5\n0.5,-2.25\n1,1000\n", ["t", "F"], {"t": "s", "F": "kN"}),
        ("t,F\n% s,kN\n0,1.5\n0.5,-2.25\n1,1000\n", ["t", "F"], {"t": "s", "F": "kN"}),
        ("Zeit [s];Kraft [%]\n0,0;1,5\n0,5;-2,25\n1,0;1000\n", ["Zeit [s]", "Kraft [%]"], {}),
        ("t,F\r\n0,1.5\r\n0.5,-2.25\r\n1,1000\r\n", ["t", "F"], {}),
        ("F,F\n0,1.5\n0.5,-2.25\n1,1000\n", ["F", "F.1"], {}),
        ("t,F\n0,1.5 N\n0.5,-2.25 N\n1,1 kN\n", ["t", "F"], {"F": "N"}),
        ("t;F\n0.0;1,5\n0.5;-2,25\n1.0;1000,0\n", ["t", "F"], {}),
    ],
)
def test_text_is_read_whatever_wrote_it(tmp_path, text, names, units):
    path = tmp_path / "run.csv"
    path.write_bytes(text.encode())
    header = read_header(path)
    assert list(header.names) == names
    assert header.units == units
    np.testing.assert_array_equal(read_samples(path).astype(float).to_numpy().T, [TIMES, FORCES])
    (last,) = read_samples(path, names[1:])
    assert last == names[1]


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        ("Bench 3;;\nRate: 2 Hz\n\nt;F\ns;kN\n-;Avg\n0,0;1,5\n0,5;-2,25\n1,0;1000\n", []),
        ("t|F\n0|1.5\n# valve shut\n0.5|-2.25\n1|1000\n", ["1 line left out, comments: 3"]),
        ("t,F\n0,1.5\n--- overload ---\n0.5,-2.25\n1,1000\n", ["1 line left out, no row of numbers: 3"]),
        ("t,F\n0,1.5\nt,F\n0.5,-2.25\nt,F\n1,1000\n", ["2 lines left out, no row of numbers: 3, 5"]),
        ("t,F\n0,1.5\n0.5,-2.25\n1,1000\nMean,333.1\n", ["1 line left out, below the table: 5"]),
        ("t;F;ok\n" + "0;1.5;1\n0.5;-2.25;1\n1;1000;1\n" * 4 + "0.0;1", ["1 line left out, lacks its last values: 14"]),
        ("t,F\n0,1.5D0\n0.5,-2.25 \n1,1000\n", []),
        ('"t","F"\n"0 s","1.5"\n"0.5 s","-2.25"\n"1 s","1,000"\n', []),
    ],
)
def test_a_loggers_file_is_read_and_what_is_left_out_is_said(tmp_path, text, left_out):
    path = tmp_path / "run.log"
    path.write_text(text)
    assert [name for name in read_header(path).names if name != "ok"] == ["t", "F"]
    assert list(read_header(path).dropped) == left_out
    frame = read_samples(path, ["t", "F"])
    np.testing.assert_array_equal(frame.astype(float).to_numpy()[:3].T, [TIMES, FORCES])
    assert len(frame) in (3, 12)


def test_a_row_that_counts_the_columns_is_none_of_their_values(tmp_path):
    path = tmp_path / "run.csv"
    for first, rows in (("0,1,2", 3), ("1,2,3", 3), ("0,1,1", 4)):
        path.write_text(f"{first}\n0,1.5,3.5\n0.5,-2.25,3.25\n1,1000.5,3.75\n")
        assert (list(read_header(path).names), len(read_samples(path))) == ([f"column_{k}" for k in (1, 2, 3)], rows)
    path.write_text("0,1\n0.01,0.99\n0.02,0.97\n")  # as a cosine begins
    assert len(read_samples(path)) == 3


def test_a_row_whose_first_cell_is_text_where_all_others_are_empty_heads_the_values(tmp_path):
    path = tmp_path / "run.lvm"
    path.write_text("Samples\t3\t3\t\nX_Value\tt\tF\tComment\n\t0\t1.5\n\t0.5\t-2.25\n\t1\t1000\n")
    np.testing.assert_array_equal(read_samples(path, ["t", "F"]).to_numpy().T, [TIMES, FORCES])


@pytest.mark.parametrize(
    ("fields", "values"),
    [
        (["950", "1.050", "12.500"], [950.0, 1050.0, 12500.0]),
        (["0", "1.234.567", "2.500"], [0.0, 1234567.0, 2500.0]),
        (["0.950", "1.050", "12.500"], [0.95, 1.05, 12.5]),
        (["2.125", "1.050", "12.500"], [2.125, 1.05, 12.5]),
        (["2", "1.050", "12.500"], [2.0, 1.05, 12.5]),
        (["950", "1.050", "12.25"], [950.0, 1.05, 12.25]),
        (["0,101", "0,5", "1,25"], [0.101, 0.5, 1.25]),
        (["101", "5", "1,250"], [101.0, 5.0, 1250.0]),
    ],
)
def test_signs_before_decimals_and_thousands_are_told_by_column(tmp_path, fields, values):
    path = tmp_path / "run.csv"
    path.write_text("t;F\n" + "".join(f"0.{k};{each}\n" for k, each in enumerate(fields)))
    assert read_samples(path)["F"].tolist() == values


def test_a_preamble_tells_the_rate_and_cells_their_unit(tmp_path):
    path = tmp_path / "run.csv.gz"
    text = "Station: 4\nSampling rate; 250 Hz\nStep = 4 ms\n\np;u\n1,5 bar;30 %\n2,5 bar;40 %\n"
    path.write_bytes(gzip.compress(text.encode()))
    header = read_header(path)
    assert header.single == {"Station": 4.0, "Sampling rate": 250.0, "Step": 0.004}
    assert header.units == {"p": "bar", "u": "percent"}
    assert read_samples(path).to_dict("list") == {"p": [1.5, 2.5], "u": [30.0, 40.0]}


LABVIEW = """LabVIEW Measurement|
Separator|Tab
X_Columns|{told}
Date|2026/03/05
***End_of_Header***|
|
Channels|2||
Samples|3|3|
Y_Unit_Label|Volts|rad/s|
X0|0.0000E+0|0.0000E+0|
Delta_X|0.010000|0.010000|
***End_of_Header***|||
X_Value|Drive|Speed|Comment
{rows}
""".replace("|", "\t")


@pytest.mark.parametrize("ended", ["\t", ""])
@pytest.mark.parametrize(("told", "times"), [("No", [""] * 40), ("One", [f"{0.01 * k:.2f}" for k in range(40)])])
def test_a_file_of_labview_tells_step_and_units_above_the_names(tmp_path, told, times, ended):
    path = tmp_path / "run.lvm"
    rows = "\n".join(f"{time}\t{k}.5\t-{k}.25{ended}" for k, time in enumerate(times))
    path.write_text(LABVIEW.format(told=told, rows=rows))
    header, frame = read_header(path), read_samples(path)
    assert header.single["Delta_X"] == 0.01
    assert header.units == {"Drive": "Volts", "Speed": "rad/s"}
    assert frame["Drive"].tolist() == [k + 0.5 for k in range(40)]
    assert frame["Speed"].tolist() == [-k - 0.25 for k in range(40)]
    assert frame["X_Value"].isna().all() if told == "No" else frame["X_Value"].iloc[-1] == 0.39


def test_signals_that_simulink_logs_have_their_labels(tmp_path):
    path = tmp_path / "run.mat"
    logged = np.zeros(3, dtype=[("values", "O"), ("dimensions", "O"), ("label", "O")])
    wide = np.array([[5.0, 6.0], [7.0, 8.0], [9.0, 10.0]])
    logged[:] = [(np.array(TIMES) + 1.0, 1, "drive"), (np.array(FORCES), 1, ""), (wide, 2, "mux")]
    savemat(path, {"log": {"time": TIMES, "signals": logged, "blockName": "model/Scope"}})
    columns = read_columns(path)
    assert list(columns) == ["log.time", "log.drive", "log.signal_2", "log.mux_1", "log.mux_2"]
    assert columns["log.drive"].tolist() == [1.0, 1.5, 2.0]
    assert columns["log.signal_2"].tolist() == FORCES
    assert columns["log.mux_2"].tolist() == [6.0, 8.0, 10.0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_text_of_any_usual_encoding_is_read(tmp_path, encoding):
    path = tmp_path / "run.txt"
    path.write_bytes("t/µs\tT/°C\n0\t20,5\n1\t21,5\n".encode(encoding))
    assert list(read_samples(path)) == ["t/µs", "T/°C"]
    assert read_samples(path)["T/°C"].tolist() == [20.5, 21.5]


def test_a_column_of_text_and_missing_values_stay(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t;F;part\n0;1,5;est\n1;;est\n2;nan;val\n")
    frame = read_samples(path)
    assert frame["part"].tolist() == ["est", "est", "val"]
    assert frame["F"].isna().tolist() == [False, True, True]
    assert read_header(path).remarks == ("columns separated by semicolons", "decimal commas")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (
            "t,F\n0,5,1,2\n0,6,1,3\n",
            "the line above its values has 2 fields and these have 4; if its numbers have decimal",
        ),
        ("t,F\n0,1,5\n1,2,6\n2,3,7\n", "put # before the lines above the names of the columns"),
        ("# nothing\n", "No columns to parse"),
        ("t,F\n0,1\n" + "1,2\n" * 200 + "1,2,3\n", "Expected 2 fields in line 203, saw 3"),
        ("t\0,F\n0,1\n", "it holds no text"),
        ("a,b\n1,2\n1,2,3\n", "the line above its values has 2 fields and these have 3"),
        ("t,F\n0,1\n1,2\nF,t\n3,2\n", "line 4 heads the columns anew, by F, t, and the lines above the values by t, F"),
        (
            "t,F\ns,N\n0,1\n1,2\ns,kN\n2,3\n",
            "line 5 heads the columns anew, by s, kN, and the lines above the values by s, N",
        ),
        ("t,F\n0,1 N\n1,2 bar\n", "expected values of one unit in a column, got N and bar"),
        ("t,F\n0,1 N\n1,2 kN\n2,3\n", "expected values of one unit in a column, got N and kN, or some without"),
        ("荷重,力\n0,1\n".encode("shift-jis"), "it is no text in UTF-8, UTF-16 or Windows' cp1252; save it as UTF-8"),
        ("a,b\n1,2\n", "expected two rows of numbers or more, got one"),
        ("a,b\n", "expected rows of numbers, got 'a,b'"),
        ("<html>\n<p>no such file</p>\n</html>\n", "expected rows of numbers, got '<html>'"),
        (b"\xff\xfe\x00", "run.csv: cannot be read as CSV ("),
        (b"no", "x.parquet: cannot be read as PARQUET ("),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + HDF5, "cannot be read as MAT (version 7.3, expected 7"),
        (HDF5 + b"\0" * 600, "expected 7 or older; load it in MATLAB and type: save('new.mat', '-v7')"),
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM\x0f\0\0\0\xff\0\0\0abc", "cannot be read as MAT ("),
        *((each, "cannot be read as MAT (") for each in (b"no such thing", b"")),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_remedy(tmp_path, content, told):
    path = tmp_path / ("x.parquet" if "PARQUET" in told else "x.mat" if "MAT" in told else "run.csv")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert told in refusal(path)


def test_an_index_of_a_parquet_file_that_has_a_name_is_a_column(tmp_path):
    frame = pd.DataFrame({"F": FORCES}, index=pd.Index(TIMES, name="t"))
    frame.to_parquet(tmp_path / "x.parquet")
    assert read_samples(tmp_path / "x.parquet")["t"].tolist() == TIMES
    assert list(read_samples(tmp_path / "x.parquet", ["F", "gone"])) == ["F"]
    frame.set_axis([7, 3, 5]).to_parquet(tmp_path / "y.parquet")
    pd.testing.assert_frame_equal(read_samples(tmp_path / "y.parquet"), frame.reset_index(drop=True))


def test_vectors_of_a_mat_file_are_columns_and_single_numbers_are_told(tmp_path):
    path = tmp_path / "run.mat"
    column = np.array(FORCES)[:, None]
    struct = {"F": column, "deep": {"x": np.array(TIMES)}, "fs": 50}
    savemat(path, {"t": np.array(TIMES), "data": struct, "Ts": 0.5, "M": np.arange(6).reshape(3, 2), "who": "me"})
    header = read_header(path)
    assert sorted(header.names) == ["M_1", "M_2", "data.F", "data.deep.x", "t"]
    assert header.single == {"Ts": 0.5, "data.fs": 50.0}
    frame = read_samples(path, ["t", "data.F", "M_2"])
    assert frame["data.F"].tolist() == FORCES
    assert frame["M_2"].tolist() == [1, 3, 5]
    assert len(read_samples(path)) == 3
    savemat(path, {"M": np.arange(20).reshape(2, 10)})  # wide: its signals are its rows
    assert read_samples(path)["M_2"].tolist() == list(range(10, 20))


def test_an_array_of_structs_is_an_array_of_records(tmp_path):
    runs = np.zeros(2, dtype=[("t", "O"), ("y", "O"), ("mass", "O")])
    runs[:] = [(np.arange(size), np.arange(size) + start, 1.0) for size, start in ((3.0, 10.0), (5.0, 20.0))]
    savemat(tmp_path / "x.mat", {"run": runs})
    frame = read_samples(tmp_path / "x.mat")
    assert frame["run"].tolist() == ["1"] * 3 + ["2"] * 5
    assert frame["run.y"].tolist() == [10, 11, 12, 20, 21, 22, 23, 24]


def test_vectors_of_unequal_length_are_refused_together_only(tmp_path):
    path = tmp_path / "x.mat"
    savemat(path, {"u": np.arange(3.0), "y": np.arange(3.0), "more": np.arange(5.0)})
    assert list(read_samples(path, ["u", "y"])) == ["u", "y"]
    assert {name: len(values) for name, values in read_columns(path).items()} == {"u": 3, "y": 3, "more": 5}
    with pytest.raises(UnequalColumns, match=r"expected columns of one length, got u \(3\) and more \(5\)"):
        read_samples(path, ["u", "more"])


def test_what_is_no_vector_is_left_alone_and_said(tmp_path):
    cells = np.empty(2, dtype=object)
    cells[:] = [np.arange(3.0), np.arange(4.0)]
    path, mixed = tmp_path / "x.mat", np.array([{"t": np.arange(3.0)}, 1.0], dtype=object)
    others = {"z": np.array([1j, 2.0]), "cube": np.zeros((2, 3, 4)), "mixed": mixed}
    savemat(path, {"u": np.arange(3.0), "c": cells, **others})
    told = "; ".join(read_header(path).remarks)
    assert "mixed is left alone" in told
    assert "c is left alone: a cell array; write its numbers as vectors" in told
    assert "z is left alone: complex numbers" in told
    assert "cube is left alone: 2 x 3 x 4 numbers; write one vector for each signal" in told
    assert list(read_samples(path)) == ["u"]
