"""MCAP files and ROS 2 bags as measured files, written by the libraries that recorders use."""

import sys

import numpy as np
import pandas as pd
import pytest

from pipeline.columns import main
from pipeline.errors import InputError
from stages.science.recording.files.readers import FileError, read_header, read_samples
from tests.bags import write_bag, write_mcap
from tests.measured_data import GEOMETRY, make_samples, read_measured

TIMES = np.arange(100) * 4_000_000
STATES = {
    "/load": (["pam1", "pam2"], TIMES, {"effort": np.arange(200.0).reshape(100, 2)}),
    "/joint": (["SFE"], TIMES[::2] + 1_000_000, {"position": 0.1 * np.arange(50.0)[:, None]}),
}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_is_a_table_on_the_clock_of_most_messages(tmp_path, storage):
    bag = write_bag(tmp_path / "bag", STATES, storage)
    header = read_header(bag)
    assert list(header.names) == ["time_s", "/joint.position[SFE]", "/load.effort[pam1]", "/load.effort[pam2]"]
    assert header.remarks[0] == "times from header.stamp"
    assert "2 topics (/joint 125 Hz, /load 250 Hz) on the clock of the one with most messages" in header.remarks[1]
    frame = read_samples(bag)
    np.testing.assert_array_equal(frame["time_s"], np.arange(100) / 250.0)
    np.testing.assert_array_equal(frame["/load.effort[pam2]"], np.arange(1.0, 200.0, 2.0))
    held = frame["/joint.position[SFE]"]
    assert np.isnan(held[0])
    np.testing.assert_array_equal(held[1:5], [0.0, 0.0, 0.1, 0.1])
    of_one = read_samples(bag, ["time_s", "/joint.position[SFE]"])  # which have its clock
    np.testing.assert_array_equal(of_one["time_s"], np.arange(50) / 125.0)
    if storage == "mcap":
        pd.testing.assert_frame_equal(read_samples(next(bag.glob("*.mcap"))), frame)


def test_messages_in_json_are_flattened(tmp_path):
    arm = {"name": ["a", "b"], "position": [1, 2], "limits": [1, 2, 3], "on": True, "mode": "hold", "deep": {"x": 3.5}}
    topics = {"/arm": [(k * 10**7, arm) for k in range(3)], "/camera": [(0, {"image": list(range(999))})]}
    path = write_mcap(tmp_path / "x.mcap", topics)
    header = read_header(path)
    assert list(header.remarks) == ["times from the log", "/camera.image is left alone: 999 entries"]
    (row, *_) = read_samples(path).to_dict("records")
    numbers = {"position[a]": 1, "position[b]": 2, "limits[0]": 1, "limits[1]": 2, "limits[2]": 3}
    told = numbers | {"on": True, "mode": "hold", "deep.x": 3.5}
    assert row == {"time_s": 0.0} | {f"/arm.{name}": value for name, value in told.items()}


def stamped(seconds, value):
    return {"header": {"stamp": {"sec": int(seconds), "nanosec": round(seconds % 1 * 1e9)}}, "data": value}


def test_stamps_of_another_clock_do_not_meet_the_logs_and_zeros_are_none(tmp_path):
    boot = {"/a": [(k * 10**7, stamped(5 + k / 50, k)) for k in range(5)]}
    assert read_header(write_mcap(tmp_path / "a.mcap", boot)).remarks == ("times from header.stamp",)
    np.testing.assert_allclose(read_samples(tmp_path / "a.mcap")["time_s"], np.arange(5) / 50)
    both = boot | {"/b": [(k * 10**7, {"data": k}) for k in range(4)]}
    (why, *_) = read_header(write_mcap(tmp_path / "b.mcap", both)).remarks
    assert why == "times from the log; header.stamp of /a is of another clock, and not every topic has one"
    np.testing.assert_allclose(read_samples(tmp_path / "b.mcap")["time_s"], np.arange(5) / 100)
    zero = write_mcap(tmp_path / "c.mcap", {"/a": [(k * 10**8, stamped(0, k)) for k in range(3)]})
    assert read_header(zero).remarks == ("times from the log",)
    assert read_samples(zero)["time_s"].tolist() == [0.0, 0.1, 0.2]


def test_a_broken_file_is_one_line(tmp_path):
    broken, blank = tmp_path / "x.mcap", write_mcap(tmp_path / "y.mcap", {"/p": [(0, list(range(999)))]})
    broken.write_bytes(b"no bag at all")
    bag = write_bag(tmp_path / "bag", STATES)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    for path, told in (
        (broken, "x.mcap: cannot be read as MCAP ("),
        (blank, "(expected messages with numbers, got none; /p is left alone: 999 entries)"),
        (bag, "bag: cannot be read as a ROS 2 bag"),
    ):
        with pytest.raises(FileError) as refused:
            read_header(path)
        assert told in str(refused.value)
        assert "\n" not in str(refused.value)


def test_of_a_file_that_is_cut_off_what_was_written_is_read(tmp_path):
    path = write_mcap(tmp_path / "x.mcap", {"/a": [(k * 10**7, {"data": k}) for k in range(500)]}, chunk_bytes=1000)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    header = read_header(path)
    assert any("the file is cut off" in each for each in header.remarks)
    found = read_samples(path)
    assert 50 < len(found) < 450
    assert found["/a.data"].tolist() == list(range(len(found)))
    np.testing.assert_allclose(found["time_s"], np.arange(len(found)) / 100)
    path.write_bytes(whole[:300])
    with pytest.raises(FileError, match=r"got none; what comes after .* the file is cut off"):
        read_samples(path)


@pytest.mark.parametrize(("name", "library"), [("x.mcap", "mcap"), ("bag", "rosbags")])
def test_a_missing_library_is_told_with_what_to_type(tmp_path, monkeypatch, name, library):
    write_mcap(tmp_path / "x.mcap", {"/a": [(0, {"data": 1})]})
    write_bag(tmp_path / "bag", STATES)
    for module in [each for each in sys.modules if each.split(".")[0] == library] + [library]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(FileError, match=rf'expected the library {library}, .*; type: pip install "pamid\[bags\]"$'):
        read_header(tmp_path / name)


def test_what_a_bag_holds_is_told(tmp_path, capsys):
    assert main([str(write_bag(tmp_path / "bag", STATES))]) == 0
    shown = capsys.readouterr().out
    for told in ("bag: 4 columns, 100 rows", "times from header.stamp", "/joint.position[SFE]"):
        assert told in shown


def wide(samples):
    """Return a row for each trial and time, the muscles beside each other."""
    told = samples[["trial", "time_s", "joint_angle_rad"]].drop_duplicates().reset_index(drop=True)
    for name in ("force_n", "pressure_kpa", "pressure_command_kpa"):
        columns = samples.pivot(index=["trial", "time_s"], columns="muscle", values=name).add_prefix(f"{name} of ")
        told = told.merge(columns.reset_index(), on=["trial", "time_s"])
    return told.rename(columns={"joint_angle_rad": "angle SFE"})


PATTERNS = ["pressure_kpa", "pressure_command_kpa", "force_n"]
MAP = [*(f'columns.{name}="{name} of {{muscle}}"' for name in PATTERNS), 'columns.joint_angle_rad="angle {joint}"']


def read_wide(folder, frame, *overrides, suffix=".csv"):
    path = folder / f"wide{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path)
    return read_measured(folder, path, *MAP, *overrides)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_column_for_each_muscle_is_read_by_a_pattern(tmp_path, suffix):
    samples = make_samples()
    tables = read_wide(tmp_path, wide(samples), suffix=suffix)
    expected = samples.sort_values(["trial", "muscle", "time_s"]).reset_index(drop=True)
    for name in ("trial", "muscle", *PATTERNS, "joint_angle_rad"):
        np.testing.assert_array_equal(tables["measured"][name], expected[name], err_msg=name)
    notes = tables["measured_notes"].set_index("about")["note"]
    assert notes["pam3"] == "left out: no values in column pressure_kpa and force_n"


def test_a_wide_file_without_trials_is_one(tmp_path):
    tables = read_wide(tmp_path, wide(make_samples(trials=1)).drop(columns="trial"))
    assert tables["measured_trials"]["trial"].tolist() == [0]
    assert ("trial", "the whole file is one, number 0") in tables["measured_notes"].itertuples(index=False, name=None)


def test_patterns_that_stand_for_nothing_and_repeated_rows_are_refused_and_missing_rows_noted(tmp_path):
    frame = wide(make_samples())
    with pytest.raises(InputError, match=r"no column 'F of \{muscle\}', which columns.force_n names; "):
        read_wide(tmp_path, frame, 'columns.force_n="F of {muscle}"')
    with pytest.raises(InputError, match=r"column time_s: row 300 repeat an earlier one \(trial 0, muscle pam1, "):
        read_wide(tmp_path, pd.concat([frame, frame.iloc[[7]]]))
    notes = read_wide(tmp_path, frame.drop(index=[20, 21]))["measured_notes"].set_index("about")["note"]
    assert notes["trial 0"] == "4 of its rows were missing: samples without values"


def test_muscles_are_read_from_a_bag(tmp_path):
    samples = make_samples(trials=1).sort_values(["muscle", "time_s"])
    own = dict(list(samples.groupby("muscle")))
    fields = dict(zip(("position", "velocity", "effort"), PATTERNS, strict=True))
    muscles = {field: np.column_stack([own[name][column] for name in GEOMETRY]) for field, column in fields.items()}
    angle = own["pam1"][["joint_angle_rad"]].to_numpy()
    topics = {"/muscles": (list(GEOMETRY), TIMES, muscles), "/joints": (["SFE"], TIMES, {"position": angle})}
    tables = read_measured(
        tmp_path,
        write_bag(tmp_path / "session", topics),
        *(f'columns.{column}="/muscles.{field}[{{muscle}}]"' for field, column in fields.items()),
        'columns.joint_angle_rad="/joints.position[{joint}]"',
    )
    for name in (*PATTERNS, "joint_angle_rad"):
        np.testing.assert_array_equal(tables["measured"][name], samples[name], err_msg=name)
    notes = dict(tables["measured_notes"].itertuples(index=False, name=None))
    assert "2 topics (/joints 250 Hz, /muscles 250 Hz)" in notes["session"]
