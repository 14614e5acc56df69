"""Records of any machine as they come: units, parts by name, no clock, unequal lengths and rates; against formulas."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pipeline.errors import ConfigError
from tests.measured_data import read_measured, refuse_measured

MAP = ("measurement=records", "columns.time_s=t", "+columns.force_n=F", "+columns.position_m=x")


def make_record(samples=200, rate_hz=100.0, phase=0.0, **told):
    """Return a record that follows from formulas, 0.7 Hz in force, 1.1 Hz in position, and what is told of it."""
    time = np.arange(samples) / rate_hz
    force, position = 3.0 * np.sin(2 * np.pi * 0.7 * time + phase), 0.01 * np.cos(2 * np.pi * 1.1 * time + phase)
    return pd.DataFrame({"t": time, "F": force, "x": position, **told})


def spread(tables, signal, record=None):
    rows = tables["measured_signals"]
    rows = rows[(rows["signal"] == signal) & (rows["record"].eq(record) if record else True)]
    return rows["time_s"].to_numpy(), rows["value"].to_numpy()


def keep(frame, path):
    """Write a table as its ending says, and return its path."""
    frame.to_csv(path, index=False) if path.suffix == ".csv" else frame.to_parquet(path)
    return path


def read_runs(tmp_path, *records):
    """Return the tables of records that a column ``run`` tells apart."""
    return read_measured(tmp_path, keep(pd.concat(records), tmp_path / "runs.parquet"), *MAP, "columns.record=run")


def test_several_files_are_refused_with_how_to_bring_several_records(tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("a.csv", "b.csv"):
        keep(make_record(), tmp_path / "runs" / name)
    told = refuse_measured(tmp_path, tmp_path / "runs", *MAP)
    assert "runs: expected samples.parquet in this folder, got a.csv, b.csv; name one file, as measured=" in told
    assert told.endswith("several records go into one file, told apart by a column: columns.record=NAME")
    with pytest.raises(ConfigError, match="measured: expected one path, got 2; several records go into one file"):
        read_measured(tmp_path, f"[{tmp_path}/runs/a.csv,{tmp_path}/runs/b.csv]", *MAP)


@pytest.mark.parametrize(
    ("heading", "name", "told"),
    [
        ("Force (kN)", "force_n", "states kN, and force_n is in N; set +units.force_n=kN, or +units.force_n=N if"),
        ("M [mNm]", "m_nm", """set '+units.m_nm="mN m"', or '+units.m_nm="N m"' if the file is wrong"""),
        ("x_mm", "force_n", "states mm, and force_n is in N; name the signal by its length, as NAME_mm, or"),
        ("x [mm]", "pos", "name the signal by its length, as NAME_mm"),
    ],
)
def test_a_unit_is_the_one_that_the_file_states(tmp_path, heading, name, told):
    frame = pd.DataFrame({"t": [0.0, 1.0, 2.0], heading: [1.0, 2.0, 3.0], "Way (cm)": [1.0, 2.0, 4.0]})
    given = [*MAP[:2], f'+columns.{name}="{heading}"', '+columns.way_m="Way (cm)"']
    refused = refuse_measured(tmp_path, keep(frame, tmp_path / "run.parquet"), *given)
    assert told in refused
    assert "column Way (cm): the file states cm, and way_m is in m; set +units.way_m=cm" in refused


@pytest.mark.parametrize(
    ("name", "unit", "told"),
    [
        ("units.time_s", "hr", "units.time_s: no unit 'hr'; choose from: s, ns, us, ms, min, h, d"),
        ("+units.force_n", "mm", "units.force_n: no unit 'mm'; choose from: N, mN, daN, kN, lbf, gf, kgf"),
        ("+units.pos", "mm", "units.pos: no unit 'mm' for a name that ends in no unit; name the signal pos_m"),
    ],
)
def test_a_unit_that_is_none_is_refused_before_anything_runs(tmp_path, name, unit, told):
    path = keep(make_record(), tmp_path / "run.csv")
    with pytest.raises(ConfigError, match=re.escape(told)):
        read_measured(tmp_path, path, *MAP, "+columns.pos=x", f"{name}={unit}")


def test_a_unit_that_is_given_is_believed_against_the_heading(tmp_path):
    frame = pd.DataFrame({"t": [0.0, 1.0, 2.0], "F (kN)": [1.0, 2.0, 3.0], "u_a": [1.0, 2.0, 3.0]})
    given = (*MAP[:2], '+columns.force_n="F (kN)"', "+columns.armature_v=u_a", "+units.force_n=N")
    tables = read_measured(tmp_path, keep(frame, tmp_path / "run.parquet"), *given)
    assert spread(tables, "force_n")[1].tolist() == spread(tables, "armature_v")[1].tolist() == [1.0, 2.0, 3.0]


def test_a_row_of_units_is_not_overlooked_and_each_signal_is_converted(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,F,T\nms,kN,degF\n0,1,212\n10,2,32\n20,3,32\n")
    given = (*MAP[:3], "+columns.water_k=T")
    told = refuse_measured(tmp_path, path, *given)
    assert "column t: the file states ms, and time_s is in s; set units.time_s=ms" in told
    tables = read_measured(tmp_path, path, *given, "units.time_s=ms", "+units.force_n=kN", "+units.water_k=degF")
    assert spread(tables, "force_n")[1].tolist() == [1000.0, 2000.0, 3000.0]
    assert spread(tables, "water_k")[1] == pytest.approx([373.15, 273.15, 273.15])
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(100.0)


def test_without_a_column_of_time_samples_are_counted(tmp_path):
    path = tmp_path / "run.mat"
    frame = make_record()
    savemat(path, {"F": frame["F"].to_numpy(), "x": frame["x"].to_numpy()})
    given = (MAP[0], *MAP[2:])
    told = refuse_measured(tmp_path, path, *given)
    assert "no column time_s; there are: F, x; say which with columns.time_s=NAME, or set measurement.rate_hz" in told
    tables = read_measured(tmp_path, path, *given, "measurement.rate_hz=100")
    np.testing.assert_allclose(spread(tables, "force_n")[0], frame["t"])
    assert tables["measured_notes"]["note"].tolist() == ["counted at 100 Hz (measurement.rate_hz)"]


def test_a_stated_rate_that_the_times_contradict_is_refused(tmp_path):
    path = keep(make_record(), tmp_path / "run.csv")
    told = refuse_measured(tmp_path, path, *MAP, "measurement.rate_hz=50")
    assert "expected steps of 0.02 s (50 Hz are stated), got 0.01 s" in told
    assert read_measured(tmp_path, path, *MAP, "measurement.rate_hz=100")["measured_notes"].empty


def test_times_that_no_machine_keeps_are_remarked(tmp_path):
    path = keep(make_record(), tmp_path / "run.csv")
    notes = read_measured(tmp_path, path, *MAP, "units.time_s=ns")["measured_notes"]
    ((about, note),) = notes.to_numpy().tolist()
    assert about == "time_s"
    assert note == "1e+11 samples in a second, and 2e-09 s in all, are hardly a machine's: see units.time_s"


def test_dates_and_times_of_day_are_times(tmp_path):
    frame = make_record(100)
    dates = pd.Timestamp("2024-05-01T12:00:00") + pd.to_timedelta(frame["t"], unit="s")
    times = [f"23:59:{58 + time:09.6f}" for time in frame["t"]]
    for name, told in (("dates.parquet", dates), ("times.csv", times)):
        tables = read_measured(tmp_path, keep(frame.assign(t=told), tmp_path / name), *MAP)
        np.testing.assert_allclose(spread(tables, "force_n")[0], frame["t"], atol=1e-9)


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
    table = keep(pd.DataFrame(columns), tmp_path / "set.csv")
    same = read_measured(tmp_path, table, *given, "measurement.part_endings=[Est,Val]")
    pd.testing.assert_frame_equal(same["measured_signals"], tables["measured_signals"])
    told = refuse_measured(tmp_path, path, *given, "measurement.part_endings=[Est,Test]")
    assert "got none that is mapped and ends in Test; there are: uEst" in told
    told = refuse_measured(tmp_path, path, *given[:1], "+columns.force_n=uEst", "+columns.position_m=yVal", given[-1])
    assert "expected columns of one length, got uEst (300) and yVal (120); if the ends of their names" in told


def test_records_of_unequal_length_share_the_blocks_by_their_length(tmp_path):
    tables = read_runs(tmp_path, *(make_record(n, phase=k, run=k) for k, n in enumerate([800, 400, 400])))
    assert tables["measured_trials"].groupby("record").size().to_dict() == {"0": 8, "1": 4, "2": 4}
    assert set(tables["measured_trials"]["samples"]) == {100}
    counted = read_measured(tmp_path, tmp_path / "runs.parquet", *MAP)  # time begins anew in each
    assert counted["measured_trials"].groupby("record").size().to_dict() == {"given": 8, "given_2": 4, "given_3": 4}
    assert "begins anew in rows 800, 1200, as another record" in list(counted["measured_notes"]["note"])


def test_many_records_are_trials_and_runs_that_are_counted_anew_in_each_part_are_kept_apart(tmp_path):
    trials = read_runs(tmp_path, *(make_record(100 + k, run=f"r{k}") for k in range(20)))["measured_trials"]
    assert trials[["record", "samples"]].to_numpy().tolist() == [[f"r{k}", 100 + k] for k in range(20)]
    runs = [make_record(50, part=part, run=run) for part in ("est", "val") for run in (1, 2)]
    trials = read_runs(tmp_path, *runs)["measured_trials"]
    assert trials["record"].unique().tolist() == ["est 1", "est 2", "val 1", "val 2"]


@pytest.mark.parametrize("rate_hz", [300.0, 250.0, 1000.0 / 3.0])
def test_records_of_unequal_rate_are_resampled_to_the_lowest_and_that_is_said(tmp_path, rate_hz):
    slow, fast = make_record(600, 100.0, run="slow"), make_record(round(6 * rate_hz), rate_hz, run="fast")
    hum = 0.5 * np.sin(2 * np.pi * 98.0 * fast["t"])
    tables = read_runs(tmp_path, slow, fast.assign(F=fast["F"] + hum))
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(100.0)
    np.testing.assert_array_equal(spread(tables, "force_n", "slow")[1], slow["F"])
    time, force = spread(tables, "force_n", "fast")
    assert len(time) == pytest.approx(600, abs=1)
    np.testing.assert_allclose(np.diff(time), 0.01, rtol=1e-6)
    true = 3.0 * np.sin(2 * np.pi * 0.7 * time)
    assert np.abs(force - true)[25:-25].max() < 0.003  # the hum would stand at 2 Hz with its 0.5 N
    assert np.abs(spread(tables, "position_m", "fast")[1] - 0.01 * np.cos(2 * np.pi * 1.1 * time)).max() < 2e-5
    (note,) = tables["measured_notes"].to_numpy().tolist()
    said = "to 100 Hz, the lowest rate of all records, behind a filter against aliases"
    assert note == ["record fast", f"resampled from {rate_hz:.6g} Hz {said}"]


def test_what_was_not_measured_stays_so_when_it_is_resampled(tmp_path):
    slow, fast = make_record(100, 100.0, run="slow"), make_record(300, 300.0, run="fast")
    fast.loc[150:180, "F"] = np.nan
    tables = read_runs(tmp_path, slow, fast)
    time, force = spread(tables, "force_n", "fast")
    assert np.flatnonzero(np.isnan(force)).tolist() == list(range(49, 62))
    assert np.isfinite(spread(tables, "position_m", "fast")[1]).all()
    assert time[60] == pytest.approx(0.6)


def test_a_key_that_lacks_its_plus_is_told_how_to_be_added(pamid, tmp_path):
    path = keep(make_record(), tmp_path / "run.csv")
    result = pamid("workflow=discrepancy", MAP[0], f"measured={path}", "columns.force_n=F", "plan=true")
    assert result.returncode == 2
    told = "unknown key 'columns.force_n': choose from: part, record, time_s; to add it, type +columns.force_n=..."
    assert told in result.stderr.replace("\n", " ")
    result = pamid("workflow=discrepancy", MAP[0], f"measured={path}", "columns.recrod=F", "plan=true")
    told = "unknown key 'columns.recrod': did you mean 'record'? To add it, type +columns.recrod=..."
    assert told in result.stderr.replace("\n", " ")
