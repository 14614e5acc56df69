"""Records of any machine as they come: units, parts by name, no clock, unequal lengths and rates; against formulas."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pipeline.errors import ConfigError
from tests.measured_data import read_measured, refuse_measured

TANKS = Path("/work/shared/data/cascaded_tanks/cascaded_tanks.parquet")
MAP = ("measurement=records", "columns.time_s=t", "+columns.force_n=F", "+columns.position_m=x")


def make_record(samples=200, rate_hz=100.0, phase=0.0):
    """Return a record that follows from formulas: 0.7 Hz in force, 1.1 Hz in position."""
    time = np.arange(samples) / rate_hz
    force, position = 3.0 * np.sin(2 * np.pi * 0.7 * time + phase), 0.01 * np.cos(2 * np.pi * 1.1 * time + phase)
    return pd.DataFrame({"t": time, "F": force, "x": position})


def spread(tables, signal, record=None):
    rows = tables["measured_signals"]
    rows = rows[(rows["signal"] == signal) & (rows["record"].eq(record) if record else True)]
    return rows["time_s"].to_numpy(), rows["value"].to_numpy()


def test_several_files_are_refused_with_how_to_bring_several_records(tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("a", "b"):
        make_record().to_csv(tmp_path / "runs" / f"{name}.csv", index=False)
    told = refuse_measured(tmp_path, tmp_path / "runs", *MAP)
    assert "runs: expected samples.parquet in this folder, got a.csv, b.csv; name one file, as measured=" in told
    assert told.endswith("several records go into one file, told apart by a column: columns.record=NAME")
    with pytest.raises(ConfigError, match="measured: expected one path, got 2; several records go into one file"):
        read_measured(tmp_path, f"[{tmp_path}/runs/a.csv,{tmp_path}/runs/b.csv]", *MAP)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat"])
def test_one_record_is_the_same_from_every_format(tmp_path, suffix):
    frame, path = make_record(), tmp_path / f"run.{suffix}"
    if suffix == "csv":
        frame.to_csv(path, index=False, sep=";", decimal=",")
    elif suffix == "parquet":
        frame.to_parquet(path)
    else:
        savemat(path, {name: frame[name].to_numpy()[:, None] for name in frame})
    tables = read_measured(tmp_path, path, *MAP)
    for signal, name in (("force_n", "F"), ("position_m", "x")):
        np.testing.assert_allclose(spread(tables, signal)[1], frame[name], rtol=1e-12)
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(100.0)
    assert len(tables["measured_trials"]) == 16
    assert tables["measured_notes"].empty


UNITS = {
    "force_n": ("kN", 1.5, 1500.0),
    "position_m": ("mm", 2.5, 0.0025),
    "position_mm": ("um", 2.5, 0.0025),
    "wheel_rad_per_s": ("rpm", 60.0, 2.0 * np.pi),
    "torque_nm": ("mN m", 250.0, 0.25),
    "moment_nm": ("Nm", 250.0, 250.0),
    "current_a": ("mA", 3.0, 0.003),
    "supply_kpa": ("bar", 6.0, 600.0),
    "water_degc": ("degF", 212.0, 100.0),
    "water_k": ("degC", 20.0, 293.15),
    "ice_k": ('"°C"', 0.0, 273.15),
    "flow_m3_per_s": ("l/min", 60.0, 0.001),
    "opening": ("%", 40.0, 0.4),
    "push_m_per_s2": ("mm/s2", 5.0, 0.005),
}


def test_every_signal_may_have_a_unit_of_its_own(tmp_path):
    path = tmp_path / "run.csv"
    pd.DataFrame({"t": range(3), **{f"z{name}": value for name, (_, value, _) in UNITS.items()}}).to_csv(path)
    given = [f"+columns.{name}=z{name}" for name in UNITS] + [
        f"+units.{name}={unit}" for name, (unit, *_) in UNITS.items()
    ]
    tables = read_measured(tmp_path, path, "measurement=records", "columns.time_s=t", *given)
    for name, (_, _, expected) in UNITS.items():
        np.testing.assert_allclose(spread(tables, name)[1], expected, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("name", "unit", "told"),
    [
        ("force_n", "pound", "units.force_n: no unit 'pound'; choose from: N, mN, kN, lbf, kgf"),
        ("force_n", "mm", "units.force_n: no unit 'mm'; choose from: N"),
        ("pos", "mm", "units.pos: no unit 'mm' for a name that ends in no unit; name the signal pos_m"),
    ],
)
def test_an_unknown_unit_tells_the_known_ones(tmp_path, name, unit, told):
    path = tmp_path / "run.csv"
    pd.DataFrame({"t": [0.0, 1.0], "z": [1.0, 2.0]}).to_csv(path, index=False)
    given = ("measurement=records", "columns.time_s=t", f"+columns.{name}=z", f"+units.{name}={unit}")
    assert told in refuse_measured(tmp_path, path, *given)


@pytest.mark.parametrize(
    ("heading", "name", "told"),
    [
        (
            "Force (kN)",
            "force_n",
            "the file states kN, and force_n is in N; set +units.force_n=kN, or +units.force_n=N if",
        ),
        ("F [kN]", "force_n", "set +units.force_n=kN"),
        ("F_kN", "force_n", "set +units.force_n=kN"),
        ("p1_bar", "supply_kpa", "set +units.supply_kpa=bar"),
        ("x_mm", "force_n", "the file states mm, and force_n is in N; name the signal by its length, as NAME_mm, or"),
        ("x [mm]", "pos", "name the signal by its length, as NAME_mm"),
    ],
)
def test_a_unit_that_the_file_states_is_not_overlooked(tmp_path, heading, name, told):
    path = tmp_path / "run.parquet"
    pd.DataFrame({"t": [0.0, 1.0, 2.0], heading: [1.0, 2.0, 3.0]}).to_parquet(path)
    given = ("measurement=records", "columns.time_s=t", f'+columns.{name}="{heading}"')
    assert told in refuse_measured(tmp_path, path, *given)


def test_a_unit_that_is_given_is_believed_against_the_heading(tmp_path):
    path = tmp_path / "run.parquet"
    pd.DataFrame({"t": [0.0, 1.0, 2.0], "F (kN)": [1.0, 2.0, 3.0], "u_a": [1.0, 2.0, 3.0]}).to_parquet(path)
    given = ("measurement=records", "columns.time_s=t", '+columns.force_n="F (kN)"', "+columns.armature_v=u_a")
    tables = read_measured(tmp_path, path, *given, "+units.force_n=N")
    assert spread(tables, "force_n")[1].tolist() == spread(tables, "armature_v")[1].tolist() == [1.0, 2.0, 3.0]


def test_a_row_of_units_is_not_overlooked(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,F\nms,kN\n0,1\n10,2\n20,3\n")
    given = ("measurement=records", "columns.time_s=t", "+columns.force_n=F")
    assert "column t: the file states ms, and time_s is in s; set units.time_s=ms" in refuse_measured(
        tmp_path, path, *given
    )
    tables = read_measured(tmp_path, path, *given, "units.time_s=ms", "+units.force_n=kN")
    assert spread(tables, "force_n")[1].tolist() == [1000.0, 2000.0, 3000.0]
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(100.0)


def test_without_a_column_of_time_samples_are_counted(tmp_path):
    path = tmp_path / "run.mat"
    frame = make_record()
    savemat(path, {"F": frame["F"].to_numpy(), "x": frame["x"].to_numpy()})
    given = ("measurement=records", "+columns.force_n=F", "+columns.position_m=x")
    told = refuse_measured(tmp_path, path, *given)
    assert "no column time_s; there are: F, x; say which with columns.time_s=NAME, or set measurement.rate_hz" in told
    tables = read_measured(tmp_path, path, *given, "measurement.rate_hz=100")
    np.testing.assert_allclose(spread(tables, "force_n")[0], frame["t"])
    assert tables["measured_notes"]["note"].tolist() == ["counted at 100 Hz (measurement.rate_hz)"]


def test_a_stated_rate_that_the_times_contradict_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    make_record().to_csv(path, index=False)
    assert "expected steps of 0.02 s (50 Hz are stated), got 0.01 s" in refuse_measured(
        tmp_path, path, *MAP, "measurement.rate_hz=50"
    )
    assert read_measured(tmp_path, path, *MAP, "measurement.rate_hz=100")["measured_notes"].empty


@pytest.mark.parametrize("start", ["2024-05-01T12:00:00", "23:59:58"])
def test_dates_and_times_of_day_are_times(tmp_path, start):
    frame = make_record(100)
    if start.startswith("2024"):
        dates = pd.Timestamp(start) + pd.to_timedelta(frame["t"], unit="s")
        frame.assign(t=dates).to_parquet(tmp_path / "run.parquet")
        tables = read_measured(tmp_path, tmp_path / "run.parquet", *MAP)
        np.testing.assert_allclose(spread(tables, "force_n")[0], frame["t"], atol=1e-9)
        frame["t"] = dates.astype(str)
    else:
        frame["t"] = [f"23:59:{58 + time:09.6f}" for time in frame["t"]]
    frame.to_csv(tmp_path / "run.csv", index=False)
    tables = read_measured(tmp_path, tmp_path / "run.csv", *MAP)
    np.testing.assert_allclose(spread(tables, "force_n")[0], make_record(100)["t"], atol=1e-9)


def test_parts_that_stand_side_by_side_are_told_by_the_ends_of_names(tmp_path):
    long, short = make_record(300), make_record(120, phase=1.0)
    path = tmp_path / "set.mat"
    columns = {"uEst": long["F"], "yEst": long["x"], "uVal": short["F"], "yVal": short["x"]}
    savemat(path, {name: values.to_numpy()[:, None] for name, values in columns.items()} | {"Ts": 0.01})
    given = ("measurement=records", "+columns.force_n=u", "+columns.position_m=y", "measurement.rate_hz=100")
    tables = read_measured(tmp_path, path, *given, "measurement.part_endings=[Est,Val]")
    for part, frame in (("Est", long), ("Val", short)):
        time, force = spread(tables, "force_n", part)
        np.testing.assert_allclose(time, frame["t"])
        np.testing.assert_array_equal(force, frame["F"])
    assert tables["measured_trials"].groupby("part")["samples"].sum().to_dict() == {"Est": 300, "Val": 120}
    pd.DataFrame(columns).to_csv(tmp_path / "set.csv", index=False)
    same = read_measured(tmp_path, tmp_path / "set.csv", *given, "measurement.part_endings=[Est,Val]")
    pd.testing.assert_frame_equal(same["measured_signals"], tables["measured_signals"])
    assert "got none that is mapped and ends in Test; there are: uEst" in refuse_measured(
        tmp_path, path, *given, "measurement.part_endings=[Est,Test]"
    )
    told = refuse_measured(tmp_path, path, *given[:1], "+columns.force_n=uEst", "+columns.position_m=yVal", given[-1])
    assert "expected columns of one length, got uEst (300) and yVal (120); if the ends of their names" in told


@pytest.mark.skipif(not TANKS.exists(), reason=f"needs recorded tanks, {TANKS}")
def test_a_benchmark_reads_the_same_from_its_mat_file_and_from_a_table(tmp_path):
    table = pd.read_parquet(TANKS)
    parts = table.groupby("part")
    columns = {f"{n}{part.capitalize()}": rows[n].to_numpy()[:, None] for part, rows in parts for n in "uy"}
    savemat(tmp_path / "dataBenchmark.mat", columns | {"Ts": 4.0})
    names = ("measurement=records", "+columns.pump_v=u", "+columns.level_v=y")
    by_name = ("measurement.part_endings=[Est,Val]", "measurement.rate_hz=0.25")
    found = read_measured(tmp_path, tmp_path / "dataBenchmark.mat", *names, *by_name)
    expected = read_measured(tmp_path, TANKS, *names, "columns.time_s=t")
    found, expected = (each["measured_signals"][["time_s", "signal", "value"]] for each in (found, expected))
    pd.testing.assert_frame_equal(found, expected)


def test_records_of_unequal_length_share_the_blocks_by_their_length(tmp_path):
    runs = pd.concat([make_record(n, phase=k).assign(run=k) for k, n in enumerate([800, 400, 400])])
    runs.to_csv(tmp_path / "runs.csv", index=False)
    trials = read_measured(tmp_path, tmp_path / "runs.csv", *MAP, "columns.record=run")["measured_trials"]
    assert trials.groupby("record").size().to_dict() == {"0": 8, "1": 4, "2": 4}
    assert set(trials["samples"]) == {100}
    told = refuse_measured(tmp_path, tmp_path / "runs.csv", *MAP)
    assert "tell what begins anew there apart: set columns.record=NAME" in told


def test_each_of_many_records_is_a_trial_of_its_own(tmp_path):
    runs = pd.concat([make_record(100 + k, phase=k).assign(run=f"r{k}") for k in range(20)])
    runs.to_parquet(tmp_path / "runs.parquet")
    trials = read_measured(tmp_path, tmp_path / "runs.parquet", *MAP, "columns.record=run")["measured_trials"]
    assert trials["record"].tolist() == [f"r{k}" for k in range(20)]
    assert trials["samples"].tolist() == [100 + k for k in range(20)]


def test_runs_that_are_counted_anew_in_each_part_are_kept_apart(tmp_path):
    runs = [make_record(50).assign(part=part, run=run) for part in ("est", "val") for run in (1, 2)]
    pd.concat(runs).to_csv(tmp_path / "runs.csv", index=False)
    trials = read_measured(tmp_path, tmp_path / "runs.csv", *MAP, "columns.record=run")["measured_trials"]
    assert trials["record"].unique().tolist() == ["est 1", "est 2", "val 1", "val 2"]


@pytest.mark.parametrize("rate_hz", [300.0, 250.0, 1000.0 / 3.0])
def test_records_of_unequal_rate_are_resampled_to_the_lowest_and_that_is_said(tmp_path, rate_hz):
    slow, fast = make_record(600, 100.0), make_record(round(6 * rate_hz), rate_hz)
    hum = 0.5 * np.sin(2 * np.pi * 98.0 * fast["t"])
    runs = pd.concat([slow.assign(run="slow"), fast.assign(F=fast["F"] + hum, run="fast")])
    runs.to_csv(tmp_path / "runs.csv", index=False)
    tables = read_measured(tmp_path, tmp_path / "runs.csv", *MAP, "columns.record=run")
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(100.0)
    np.testing.assert_array_equal(spread(tables, "force_n", "slow")[1], slow["F"])
    time, force = spread(tables, "force_n", "fast")
    assert len(time) == pytest.approx(600, abs=1)
    np.testing.assert_allclose(np.diff(time), 0.01, rtol=1e-6)
    true = 3.0 * np.sin(2 * np.pi * 0.7 * time)
    assert np.abs(force - true)[25:-25].max() < 0.003  # the hum would stand at 2 Hz with its 0.5 N
    assert np.abs(spread(tables, "position_m", "fast")[1] - 0.01 * np.cos(2 * np.pi * 1.1 * time)).max() < 2e-5
    assert tables["measured_notes"].to_numpy().tolist() == [
        [
            "record fast",
            f"resampled from {rate_hz:.6g} Hz to 100 Hz, the lowest rate of all records, behind a filter against "
            "aliases",
        ]
    ]


def test_what_was_not_measured_stays_so_when_it_is_resampled(tmp_path):
    slow, fast = make_record(100, 100.0), make_record(300, 300.0)
    fast.loc[150:180, "F"] = np.nan
    runs = pd.concat([slow.assign(run="slow"), fast.assign(run="fast")])
    runs.to_csv(tmp_path / "runs.csv", index=False)
    tables = read_measured(tmp_path, tmp_path / "runs.csv", *MAP, "columns.record=run")
    time, force = spread(tables, "force_n", "fast")
    assert np.flatnonzero(np.isnan(force)).tolist() == list(range(49, 62))
    assert np.isfinite(spread(tables, "position_m", "fast")[1]).all()
    assert time[60] == pytest.approx(0.6)


def test_a_key_that_lacks_its_plus_is_told_how_to_be_added(pamid, tmp_path):
    make_record().to_csv(tmp_path / "run.csv", index=False)
    result = pamid(
        "workflow=discrepancy", "measurement=records", f"measured={tmp_path}/run.csv", "columns.force_n=F", "plan=true"
    )
    assert result.returncode == 2
    assert "unknown key 'columns.force_n': choose from: part, record, time_s; to add it, type +columns.force_n=..." in (
        result.stderr.replace("\n", " ")
    )
