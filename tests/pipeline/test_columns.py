"""The command that looks at a recorded file: what it prints, and that what it prints can be typed."""

import re
import shlex
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pipeline.columns import main
from tests.conftest import ROOT
from tests.measured_data import make_samples, write_dataset
from tests.pipeline.conftest import success


@pytest.fixture
def look(capsys, tmp_path):
    """Return what the command prints of a file, or of columns in one; the last line is the command to type."""

    def call(held):
        path = tmp_path / "x.csv" if isinstance(held, dict | pd.DataFrame) else held
        if path is not held:
            pd.DataFrame(held).to_csv(path, index=False)
        assert main([str(path)]) == 0
        return capsys.readouterr().out.splitlines()

    return call


def arguments(lines):
    words = shlex.split(lines[-1])
    return [word for word in words[words.index("pipeline") + 1 :] if not word.startswith("measured=")]


def make_run(samples=200, rate_hz=100.0):
    time = np.arange(samples) / rate_hz
    return time, np.sin(3.0 * time), 10.0 * np.cos(2.0 * time)


@pytest.mark.parametrize(("heading", "rate_hz"), [("Date/Time", 0.1), ("time", 100.0)])
def test_days_of_a_spreadsheet_are_times(look, heading, rate_hz):
    time, drive, way = make_run(rate_hz=rate_hz)
    typed = arguments(look({heading: 46356.5 + time / 86400.0, "Drive (V)": drive, "Way (mm)": way}))
    assert f"columns.time_s={heading}" in typed
    assert "units.time_s=d" in typed
    assert "units.time_s=d" not in arguments(look({heading: 300.0 + time, "Drive (V)": drive, "Way (mm)": way}))


@pytest.mark.parametrize(("heading", "step", "asked"), [("t", 10, True), ("t_s", 10, False), ("t", 0.01, False)])
def test_the_unit_of_times_that_are_counted_is_asked_for(look, heading, step, asked):
    _, drive, way = make_run()
    lines = look({heading: step * np.arange(200), "Drive (V)": drive, "Way (mm)": way})
    assert any("the unit of t, in steps of 10: s is assumed; type units.time_s=ms" in each for each in lines) == asked


def test_it_tells_type_range_gaps_unit_and_use_of_every_column(look, tmp_path):
    time, force, way = make_run()
    way[50:60] = np.nan
    run = np.repeat([1, 2], 100)
    frame = pd.DataFrame({"Time (ms)": 1e3 * time, "Force [kN]": force, "x_mm": way, "run": run, "note": "a"})
    frame.to_csv(tmp_path / "bench.csv", sep=";", decimal=",", index=False)
    lines = look(tmp_path / "bench.csv")
    assert lines[0] == f"{tmp_path}/bench.csv: 5 columns, 200 rows"
    assert lines[1:3] == ["  columns separated by semicolons", "  decimal commas"]
    rows = {re.split(r"\s{2,}", line)[0]: re.split(r"\s{2,}", line)[1:] for line in lines[4:10]}
    assert rows["Time (ms)"] == ["numbers", "0", "1990", "0", "ms", "time_s"]
    assert rows["Force [kN]"] == ["numbers", f"{force.min():.6g}", f"{force.max():.6g}", "0", "kN", "force_n"]
    assert rows["x_mm"] == ["numbers", f"{np.nanmin(way):.6g}", "10", "10", "mm", "x_m"]
    assert rows["run"] == ["whole numbers", "1", "2", "0", "record"]
    assert rows["note"] == ["text", "a", "a", "0", "-"]
    assert "time: even steps, 100 Hz" in lines
    assert "records: 1 (100 rows), 2 (100 rows)" in lines
    assert " ".join(arguments(lines)) == (
        'workflow=discrepancy measurement=records columns.time_s="Time (ms)" columns.record=run '
        '+columns.force_n="Force [kN]" +columns.x_m=x_mm units.time_s=ms +units.force_n=kN +units.x_m=mm '
        "plant=damper plant.along=x_m plant.drive=null plant.output=force_n plan=true"
    )


def test_columns_that_have_their_names_already_and_letters_of_other_languages_can_be_typed(look, pamid, tmp_path):
    time, drive, answer = make_run()
    path = tmp_path / "record.csv"
    pd.DataFrame({"time_s": time, "Länge/mm": drive, "力 (N)": answer, "force_n": answer}).to_csv(path, index=False)
    line = shlex.split(look(path)[-1])
    told = line[line.index("pipeline") + 1 : -1]
    assert "+columns.force_n=force_n" in told
    assert "+columns.laenge_m=Länge/mm" in [each.replace('"', "") for each in told]
    success(pamid, *told, "stages=[measurement]")
    found = pd.read_parquet(pamid.runs[0] / "tables/measured_signals.parquet").groupby("signal")["value"]
    assert found.ngroups == 3
    np.testing.assert_allclose(found.get_group("laenge_m"), drive / 1000.0)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat", "txt"])
def test_what_it_prints_can_be_typed(look, pamid, tmp_path, suffix):
    time, drive, answer = make_run()
    path = tmp_path / f"a record.{suffix}"
    if suffix == "mat":
        savemat(path, {"data": {"t": time, "u": drive, "y": answer}})
    elif suffix == "parquet":
        pd.DataFrame({"t": time, "u": drive, "y": answer}).to_parquet(path)
    else:
        np.savetxt(path, np.stack([time, drive, answer], axis=1), header="t u y")
        text = path.read_text()
        path.write_text(text if suffix == "txt" else text.replace(" ", ",").replace("#,", "# "))
    line = shlex.split(look(path)[-1])
    told = line[line.index("pipeline") + 1 :]
    assert told[-4:] == ["plant=second_order", "plant.input=drive_v", "plant.output=response_v", "plan=true"]
    assert re.search(r"drive_v +<- (data\.)?u\n", success(pamid, *told))
    success(pamid, *told[:-1], "stages=[measurement]")
    found = pd.read_parquet(pamid.runs[0] / "tables/measured_signals.parquet")
    for signal, expected in (("drive_v", drive), ("response_v", answer)):
        np.testing.assert_allclose(found.loc[found["signal"] == signal, "value"], expected)


def test_parts_by_name_and_a_sampling_time_come_into_the_command(look, tmp_path):
    _, drive, answer = make_run()
    savemat(tmp_path / "x.mat", {"uEst": drive, "yEst": answer, "uVal": drive[:90], "yVal": answer[:90], "Ts": 4.0})
    lines = look(tmp_path / "x.mat")
    assert lines[0].endswith("x.mat: 4 columns, 90 or 200 rows")
    assert "parts, by the ends of names: Est (200 rows), Val (90 rows)" in lines
    assert " ".join(arguments(lines)[2:8]) == (
        "+columns.drive_v=u +columns.response_v=y measurement.rate_hz=0.25 measurement.part_endings=[Est,Val] "
        "parts.fitted=[Est] parts.verification=[Val]"
    )


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("Train", "Test"), ["parts.fitted=[Train]", "parts.verification=[Test]"]),
        (("val", "est"), ["parts.fitted=[est]", "parts.verification=[val]"]),
        (("monday", "tuesday"), []),
    ],
)
def test_a_column_of_parts_comes_into_the_command_if_its_values_say_what_they_are_for(look, names, told):
    time, drive, answer = make_run()
    lines = look({"t": time, "u": drive, "y": answer, "part": np.repeat(names, [120, len(time) - 120])})
    assert [each for each in arguments(lines) if each.startswith("parts")] == told


def test_the_machines_that_it_may_be_are_told_with_their_signals(look):
    time, drive, answer = make_run(20)
    lines = look({"t": time, "u": drive, "way_mm": answer})
    at = lines.index("  which machine it is: plant=second_order is put here; in place of it and its signals may stand")
    input_of = {"cascaded_tanks": "plant.input=drive_v", "first_order": "plant.input=drive_v"}
    input_of |= {"servo_drive": "plant.force=drive_v", "static_map": "plant.along=drive_v"}
    expected = {f"    plant={name} {told} plant.output=way_m" for name, told in input_of.items()}
    assert expected <= set(lines[at + 1 :])
    assert "    plant=finger plant.along=drive_v plant.output=way_m [plant.against=NAME]" in lines
    assert not any("plant=pam_joint" in each for each in lines)  # it takes three signals
    assert arguments(lines)[-4:-1] == ["plant=second_order", "plant.input=drive_v", "plant.output=way_m"]


def test_what_was_set_for_each_record_labels_it_although_it_has_a_unit(look):
    time, drive, answer = make_run(300)
    loads = (0.5, 1.0, 2.5)
    runs = [pd.DataFrame({"t": time, "p_bar": 2.0 + drive, "x_mm": answer, "Load (kg)": load}) for load in loads]
    lines = look(pd.concat(runs))
    assert "records: 0.5 (300 rows), 1.0 (300 rows), 2.5 (300 rows)" in lines
    told = arguments(lines)
    assert 'columns.record="Load (kg)"' in told
    assert [each for each in told if "load" in each.lower()] == ['columns.record="Load (kg)"']


@pytest.mark.parametrize(
    ("headings", "machine"),
    [
        ("p_bar F[N] contraction", "muscle plant.pressure=p_kpa plant.length=contraction plant.output=f_n"),
        ("p_bar F[N]", "muscle plant.pressure=p_kpa plant.output=f_n"),
        ("p1_bar p_set_bar F_N s_mm", "muscle plant.pressure=p1_kpa plant.length=s_m plant.output=f_n"),
        (
            "p1_bar p2_bar s_mm F_N",
            "cylinder plant.along=s_m plant.pressure=p1_kpa plant.second_pressure=p2_kpa plant.output=f_n",
        ),
        (
            "current_a x_mm v[mm/s] F_N",
            "damper plant.along=x_m plant.speed=v_m_per_s plant.drive=current_a plant.output=f_n",
        ),
        ("pump_v level_cm", "first_order plant.input=pump_v plant.output=level_m"),
        ("theta_deg", "second_order plant.input=nothing plant.output=theta_rad"),
        ("p_kpa bend_deg", "finger plant.along=p_kpa plant.output=bend_rad"),
        ("p1_kpa p2_kpa q_deg", "pam_joint plant.pressures=[p1_kpa,p2_kpa] plant.output=q_rad"),
        ("Command_V Pressure_bar", "first_order plant.input=command_v plant.output=pressure_kpa"),
        ("valve_cmd_V chamber_bar", "first_order plant.input=valve_cmd_v plant.output=chamber_kpa"),
        ("u_V p_bar", "first_order plant.input=u_v plant.output=p_kpa"),
        ("M[Nm] speed[rpm]", "first_order plant.input=m_nm plant.output=speed_rad_per_s"),
        ("Motorstrom[A] Winkel[deg]", "servo_drive plant.force=motorstrom_a plant.output=winkel_rad"),
        ("M[Nm] Position[mm]", "servo_drive plant.force=m_nm plant.output=position_m"),
        ("Weg[mm] Kraft[N]", "damper plant.along=weg_m plant.drive=null plant.output=kraft_n"),
        ("u[V] y[V]", "second_order plant.input=u_v plant.output=y_v"),
        ("x[mm] y[N] z[m]", "damper plant.along=x_m plant.drive=null plant.output=y_n"),
    ],
)
def test_a_machine_is_put_into_the_command_by_its_quantities(look, headings, machine):
    time, drive, answer = make_run(20)
    lines = look({"t": time} | {name: drive * (k + 1.0) + answer for k, name in enumerate(headings.split())})
    assert f"plant={machine}" in " ".join(arguments(lines))


def join_runs(*times):
    return {"t": np.concatenate(times), "run": np.repeat(np.arange(len(times)), [len(each) for each in times])}


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({"t": np.arange(20.0)}, "time: even steps, 1 Hz"),
        ({"t": np.delete(np.arange(20.0), [5, 9, 10])}, "time: even steps, 1 Hz, but for 2 gaps"),
        ({"t": np.cumsum(np.linspace(1.0, 1.5, 20))}, "time: uneven steps of 1.026 to 1.5 s about 1.263 s"),
        ({"t": np.tile(np.arange(10.0), 2)}, "records: given (10 rows), given_2 (10 rows)"),
        ({"t": np.append(np.arange(30.0), 20.5)}, "time: goes back; sort the rows or, if a column tells records apart"),
        ({"t": (np.arange(40) / 300.0).round(2)}, "time: steps rounded to 0.01 s; the samples will be counted, at 300"),
        ({"t": np.zeros(20)}, "time: stands still"),
        (join_runs(np.arange(50) / 50, np.arange(50) / 100), "time: 50 to 100 Hz, by record; they are resampled to"),
        (join_runs(*[np.arange(10) / 50] * 20), "records: 20, of 10 rows"),
        (join_runs(*[np.arange(10) / 50] * 19, np.arange(14) / 50), "records: 20, of 10 to 14 rows"),
        (
            {"Time": [f"5/{k}/2026 10:00:00" for k in range(1, 9)]},
            "column Time: expected dates that tell the day from the month, got '5/2/2026 10:00:00'; write",
        ),
    ],
)
def test_it_tells_how_the_clock_runs(look, columns, told):
    lines = look(pd.DataFrame(columns).assign(u=lambda frame: 1.0 * np.arange(len(frame))))
    assert any(line.startswith(told) for line in lines)


def test_what_it_cannot_guess_is_left_to_the_person(look):
    lines = look({"a": [0.0, 1.0, 2.0], "qm": [1.0, 2.0, 4.0]})
    assert "  which column is time: columns.time_s=NAME; or, without one, its rate: measurement.rate_hz=..." in lines
    assert "  the unit of a, qm, left out: +columns.NAME_UNIT=COLUMN takes one, as in +columns.force_n=F" in lines
    untold = ["plant=second_order", "plant.input=NAME", "plant.output=NAME"]
    assert arguments(lines) == ["workflow=discrepancy", "measurement=records", *untold, "plan=true"]
    lines = look({"t": [0.0, 1.0, 2.0], "a [V]": [1.0, 2.0, 4.0], "b [V]": [1.0, 2.0, 5.0]})
    assert "  which signal drives the machine: plant.input=NAME, of a_v, b_v" in lines
    assert arguments(lines)[-4:-1] == untold


def test_a_second_signal_without_a_unit_has_its_place_in_the_command(look):
    time, drive, answer = make_run()
    lines = look({"t": time, "F": drive, "pos_mm": answer})
    assert "  which signal answers: plant.output=NAME, of pos_m or what is left out, once it has a name" in lines
    assert "+columns.NAME_UNIT=F" in arguments(lines)


def test_a_word_among_numbers_is_told_with_its_row(look, pamid, tmp_path):
    time, drive, answer = make_run()
    rows = [f"{one};{two};{three}".replace(".", ",") for one, two, three in zip(time, drive, answer, strict=True)]
    rows[7] = rows[7].rpartition(";")[0] + ";broken"
    path = tmp_path / "x.csv"
    path.write_text("\n".join(["t;F (N);x (mm)", *rows]))
    lines = look(path)
    told = "  in x (mm) 'broken' in row 7 is no number: leave empty in the file what was not read, so"
    assert any(line.startswith(told) for line in lines)
    low, high = np.delete(answer, 7).min(), np.delete(answer, 7).max()
    assert any(re.match(rf"x \(mm\) +numbers +{low:.6g} +{high:.6g} +1 +mm +x_m", line) for line in lines)
    refused = pamid(*shlex.split(lines[-1])[3:])
    assert refused.returncode == 2
    assert "got 'broken' in row 7; leave empty in the file what was not read" in refused.stderr.replace("\n", " ")


def test_units_below_a_date_that_has_none_and_a_column_of_labview_are_understood(look, tmp_path):
    rows = "\n".join(f"26.03.2026 14:03:{k:02};{k % 7},5;{k % 5},25" for k in range(60))
    (tmp_path / "a.csv").write_text(f"Datum/Uhrzeit;Druck;Winkel\n;mbar;\u00b0\n{rows}\n")
    told = " ".join(arguments(look(tmp_path / "a.csv")))
    assert "+units.druck_kpa=mbar +units.winkel_rad=deg plant=finger plant.along=druck_kpa" in told
    time, drive, answer = make_run()
    lines = look({"X_Value": time, "p (bar)": drive, "F (N)": answer, "Comment": np.nan})
    assert "columns.time_s=X_Value" in arguments(lines)
    assert not [line for line in lines if "left out" in line]


def test_a_unit_with_a_slash_is_read_whole_or_asked_for(look):
    time, drive, answer = make_run()
    lines = look({"t": time, "Q_l/min": drive, "k_N/mm": answer, "Temp °C": answer, "Level %": drive})
    assert "  the unit of k_N/mm, left out: +columns.NAME_UNIT=COLUMN takes one, as in +columns.force_n=F" in lines
    assert " ".join(arguments(lines)[2:9]) == (
        'columns.time_s=t +columns.q_m3_per_s=Q_l/min +columns.temp_k="Temp °C" +columns.level_ratio="Level %" '
        "+units.q_m3_per_s=l/min +units.temp_k=degC +units.level_ratio=percent"
    )


@pytest.mark.parametrize(
    ("name", "times", "told"),
    [
        ("stamp", [f"05.05.2026 10:00:{k:02}" for k in range(20)], "columns.time_s=stamp"),
        ("wann", [f"2026/05/05 10:{k:02}" for k in range(20)], "columns.time_s=wann"),
        ("Uhrzeit", [f"08:30:{k:02}" for k in range(20)], "columns.time_s=Uhrzeit"),
        ("sec", np.arange(20.0), "columns.time_s=sec"),
        ("zeit_s", np.arange(20.0), "columns.time_s=zeit_s"),
        ("msec", np.arange(20.0), "units.time_s=ms"),
        ("hours", np.arange(20.0), "units.time_s=h"),
        ("h", np.tile(np.arange(10.0), 2), "columns.time_s=h"),
    ],
)
def test_time_is_found_by_dates_and_by_its_usual_names(look, name, times, told):
    lines = look({"F [N]": 1.0 * np.arange(20), "Date": "05.05.2026", name: times})
    assert told in arguments(lines)
    assert any(line.startswith("time: even steps") for line in lines)


@pytest.mark.parametrize("names", [("T_degC", "h"), ("T [K]", "h"), ("h", "t")])
def test_what_its_unit_or_its_values_show_to_be_no_time_is_none(look, names):
    time, drive, _ = make_run()
    told = arguments(look({names[0]: 20.0 + drive, "P_kW": drive, names[1]: time}))
    assert f"columns.time_s={names[1]}" in told


@pytest.mark.parametrize("name", ["Lauf", "Nr", "Versuch", "rec", "serie"])
@pytest.mark.parametrize(("values", "names"), [([1, 2, 3], "123"), ([0.0, 1.0, 5.0], "015"), (["a", "c", "b"], "acb")])
def test_what_changes_where_time_begins_anew_tells_records_apart(look, name, values, names):
    time, drive, answer = make_run(60)
    frame = pd.DataFrame({"t": np.tile(time[:20], 3), "F_N": drive, "x_mm": answer, name: np.repeat(values, 20)})
    lines = look(frame.assign(gear=np.tile(np.repeat([1, 2], 10), 3), Zeile=np.arange(60)))
    assert f"columns.record={name}" in arguments(lines)
    assert f"records: {', '.join(f'{each} (20 rows)' for each in names)}" in lines
    assert any("the unit of gear, Zeile, left out" in line for line in lines)


def test_labels_of_which_few_are_no_numbers_stay_labels(look):
    time, drive, answer = make_run(300)
    runs = np.repeat([*map(str, range(19)), "18b"], 15)
    lines = look({"t": np.tile(time[:15], 20), "F_N": drive, "x_mm": answer, "run": runs})
    assert "columns.record=run" in arguments(lines)
    assert "records: 20, of 15 rows" in lines


def test_a_row_number_a_repeated_name_and_parts_whose_time_begins_anew_are_no_records(look, tmp_path):
    time, drive, _ = make_run(60)
    (tmp_path / "again.csv").write_text("t,F,F\n" + "".join(f"{k},1,{k % 7}\n" for k in range(40)))
    parts = {"set": np.repeat(["est", "val"], 30), "k": np.repeat([1, 2], 30)}
    for held in (
        {"Nr": np.arange(60), "t": time, "F_N": drive},
        tmp_path / "again.csv",
        {"t": np.tile(time[:30], 2), "F_N": drive, **parts},
    ):
        told = arguments(look(held))
        assert not any("record" in each for each in told[2:])
    assert "columns.part=set" in told


@pytest.mark.parametrize("begins_anew", [True, False])
def test_structs_of_an_array_are_records(look, tmp_path, begins_anew):
    time, drive, _ = make_run(60)
    clock = np.tile(time[:20], 3) if begins_anew else time
    runs = [{"zeit": clock[k : k + 20], "F_N": drive[k : k + 20]} for k in (0, 20, 40)]
    savemat(tmp_path / "x.mat", {"versuch": np.array(runs, dtype=object)})
    assert "columns.record=versuch" in arguments(look(tmp_path / "x.mat"))


def test_a_number_that_marks_what_was_not_read_is_told(look):
    time, drive, answer = make_run()
    lines = look({"t": time, "u": drive, "y": np.where(np.arange(len(time)) % 50 == 7, -999.0, answer)})
    assert any("in y " in each and "values are -999, far from all readings" in each for each in lines)


def test_a_folder_of_muscles_needs_no_map(look, tmp_path):
    assert arguments(look(write_dataset(tmp_path / "arm"))) == ["workflow=discrepancy", "plan=true"]


def test_muscles_under_names_of_others_are_found(look):
    names = {"trial": "run", "pressure_kpa": "p [bar]", "pressure_command_kpa": "p_ref [bar]", "force_n": "F_kN"}
    samples = make_samples()[["trial", "time_s", "muscle", *list(names)[1:], "joint_angle_rad"]]
    assert " ".join(arguments(look(samples.rename(columns=names)))[1:]) == (
        'columns.trial=run columns.pressure_kpa="p [bar]" columns.pressure_command_kpa="p_ref [bar]" '
        "columns.force_n=F_kN units.pressure_kpa=bar units.pressure_command_kpa=bar units.force_n=kN plan=true"
    )


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("x.csv", None, "expected the path of a file, got"),
        ("x.xlsx", b"PK", ".asc, .log or .lvm file, got 'x.xlsx'; save the sheet as CSV"),
        ("x.csv", b"t,u\n", "x.csv: cannot be read as CSV (expected rows of numbers, got 't,u'"),
        ("arm", None, "arm: expected samples.parquet in this folder, got none"),
    ],
)
def test_bad_input_is_one_line_and_no_success(capsys, tmp_path, name, content, told):
    path = tmp_path / name
    if name == "arm":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    assert main([str(path)]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert told in shown.err
    assert len(shown.err.strip().splitlines()) == 1


def test_by_the_command_line(tmp_path):
    pd.DataFrame({"t": [0.0, 1.0], "u": [1.0, 2.0]}).to_csv(tmp_path / "x.csv", index=False)
    line = [sys.executable, "-m", "pipeline.columns", str(tmp_path / "x.csv")]
    result = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0
    assert "time: even steps, 1 Hz" in result.stdout
    assert result.stderr == ""
