"""What was measured: read as it was recorded, completed where that is possible, refused in one line otherwise."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from pipeline.config import read_study
from pipeline.errors import ConfigError
from tests.composing import compose_values
from tests.measured_data import make_meta, make_samples, refuse_measured, write_dataset
from tests.measured_data import read_measured as read
from tests.studies import run_stage

EXOSKELETON = Path("/work/shared/data/exoskeleton_example")


def refusal(tmp_path, samples=None, meta=None, *overrides):
    """Return how a dataset is refused."""
    return refuse_measured(tmp_path, write_dataset(tmp_path / "dataset", samples, meta), *overrides)


def put(column, rows, value):
    """Return a change of samples: another value in some rows."""

    def change(samples):
        changed = samples if column == "muscle" else samples.astype({column: type(value)})
        changed.loc[rows, column] = value
        return changed

    return change


def scale(column, factor):
    return lambda samples: samples.assign(**{column: factor * samples[column]})


def in_order(samples):
    """Return samples in the order in which they are read."""
    return samples.sort_values(["trial", "muscle", "time_s"]).reset_index(drop=True)


def test_a_dataset_comes_out_as_it_was_measured(tmp_path):
    samples = make_samples()
    tables = read(tmp_path, write_dataset(tmp_path / "arm", samples))
    for name, values in in_order(samples).items():
        np.testing.assert_array_equal(tables["measured"][name], values, err_msg=name)
    assert tables["measured_session"].to_numpy().tolist() == [["arm", "muscles", 250.0, "joint_end", "", 3, 2]]
    assert tables["measured_trials"][["samples", "duration_s", "part"]].to_numpy().tolist() == [[100, 0.4, "given"]] * 3
    assert tables["measured_trials"]["start_s"].isna().all()
    muscles = tables["measured_muscles"].set_index("muscle")
    assert muscles["damping_n_s"].to_dict() == {"pam1": 90.0, "pam2": 7.5}
    assert muscles["braid_angle_deg"].isna().all()
    assert tables["measured_notes"].empty
    assert tables["measured_signals"].empty


@pytest.mark.skipif(not EXOSKELETON.is_dir(), reason=f"no recorded session in {EXOSKELETON}")
def test_reads_a_session_of_the_exoskeleton(tmp_path):
    tables = read(tmp_path, EXOSKELETON)
    samples = in_order(pd.read_parquet(EXOSKELETON / "samples.parquet"))
    np.testing.assert_array_equal(tables["measured"]["force_n"], samples["force_n"])
    told = json.loads((EXOSKELETON / "meta.json").read_text())
    assert list(tables["measured_trials"]["start_s"]) == told["trial_start_s"]
    assert list(tables["measured_muscles"]["moment_arm_m"]) == [0.042, 0.036, 0.036, 0.032]


def test_the_hardware_stages_recordings_serve_where_there_is_no_path(tmp_path):
    composed = {**compose_values("budget=tiny", "bank.trajectories=4"), **compose_values("workflow=discrepancy")}
    order = ["bank", "subsampling", "hardware", "measurement"]
    composed["workflow"].update(stages=order, quoted=list(composed), headline=[])
    study, stages = read_study(OmegaConf.create(composed))
    tables = {}
    for stage in stages:
        tables.update(run_stage(study, stage, tmp_path, tables))
    recordings = tables["hardware_recordings"]
    lead_in = recordings["time_s"] < 0.0
    turns = recordings[["participant", "experiment", "position"]].drop_duplicates()
    assert len(tables["measured_trials"]) == len(turns) > 0
    for name in ("pressure_kpa", "joint_angle_rad"):
        np.testing.assert_array_equal(tables["measured"][name], recordings[name])
    np.testing.assert_array_equal(tables["measured"]["force_n"], recordings["force_n"].mask(lead_in))
    assert list(tables["measured_muscles"]["muscle"]) == ["pam1", "pam2", "pam3", "pam4"]
    left_out = "left out where muscles were filled, which tells the state that trials begin in"
    notes = tables["measured_notes"]
    assert notes[notes["note"].str.contains("left out")].to_numpy().tolist() == [["force_n", left_out]]
    frozen = recordings.index[(recordings["muscle"] == "pam3") & ~lead_in][100:130]
    amiss = recordings.assign(status=recordings["status"].mask(recordings.index.isin(frozen), "frozen"))
    again = run_stage(study, stages[-1], tmp_path / "amiss", {**tables, "hardware_recordings": amiss})
    assert again["measured"].loc[frozen, "force_n"].isna().all()
    assert again["measured"]["force_n"].isna().sum() == 30 + lead_in.sum()
    assert again["measured"].loc[frozen, "pressure_command_kpa"].notna().all()
    assert ("pam3", "30 samples left out: frozen") in list(again["measured_notes"].itertuples(index=False, name=None))


def test_nothing_measured_is_refused_before_anything_runs():
    with pytest.raises(ConfigError, match="got null; set measured=PATH"):
        read_study(compose_values("workflow=discrepancy"))


FOREIGN = {
    "time_s": ("t_ms", "ms", 1000.0),
    "pressure_kpa": ("p_bar", "bar", 0.01),
    "force_n": ("F_kN", "kN", 0.001),
    "joint_angle_rad": ("phi", "deg", 180.0 / np.pi),
}


def test_foreign_names_and_units_are_converted(tmp_path):
    samples, path = make_samples(), tmp_path / "foreign.csv"
    foreign = samples[["trial", "muscle"]].set_axis(["run", "who"], axis=1)
    overrides = ["columns.trial=run", "columns.muscle=who"]
    for name, (column, unit, factor) in FOREIGN.items():
        foreign[column] = factor * samples[name]
        overrides += [f"columns.{name}={column}", f"units.{name}={unit}"]
    foreign.to_csv(path, sep=";", index=False)
    tables = read(tmp_path, path, *overrides)
    expected = in_order(samples)[list(FOREIGN)]
    np.testing.assert_allclose(tables["measured"][list(FOREIGN)], expected, rtol=1e-12, atol=1e-12)
    assert tables["measured_session"]["sampling_rate_hz"].iloc[0] == pytest.approx(250.0)
    missing = ["contraction", "contraction_velocity_per_s", "pressure_command_kpa"]
    assert list(tables["measured_notes"]["about"]) == ["pam3", "pam4", *missing]
    assert tables["measured"]["pressure_command_kpa"].isna().all()


def test_contraction_and_its_velocity_follow_from_the_angle(tmp_path):
    samples = make_samples()
    bare = samples.drop(columns=["contraction", "contraction_velocity_per_s", "joint_velocity_rad_per_s"])
    found = read(tmp_path, write_dataset(tmp_path / "dataset", bare))["measured"]
    expected = in_order(samples)
    np.testing.assert_allclose(found["contraction"], expected["contraction"], atol=1e-15)
    middle, name = expected["time_s"].between(0.05, 0.34), "contraction_velocity_per_s"
    np.testing.assert_allclose(found[name][middle], expected[name][middle], atol=0.002)


def test_trials_of_unequal_length_and_gaps_stay_as_they_are(tmp_path):
    samples = make_samples()
    samples.loc[samples["time_s"].between(0.1, 0.14) & (samples["muscle"] == "pam2"), "force_n"] = np.nan
    dropped = (samples["trial"] == 1) & (samples["time_s"].between(0.2, 0.23)) & (samples["muscle"] == "pam1")
    short = (samples["trial"] == 2) & (samples["time_s"] > 0.3)
    tables = read(tmp_path, write_dataset(tmp_path / "dataset", samples[~dropped & ~short]))
    assert list(tables["measured_trials"]["samples"]) == [100, 100, 76]
    found = tables["measured"].set_index(["trial", "muscle"])
    assert found.loc[(0, "pam2"), "force_n"].isna().sum() == 11
    gap = found.loc[(1, "pam1")]
    assert gap["force_n"].isna().sum() == dropped.sum() == 8
    assert gap.loc[gap["force_n"].isna(), "time_s"].between(0.199, 0.231).all()
    assert found.loc[(1, "pam2"), "force_n"].notna().sum() == 89


def test_derivatives_do_not_reach_across_gaps(tmp_path):
    samples = make_samples(trials=1, muscles=("pam1",)).drop(columns="contraction_velocity_per_s")
    hole = samples["time_s"].between(0.2, 0.24)
    samples["contraction"] = (samples["contraction"] + 0.1 * (samples["time_s"] > 0.24)).mask(hole)
    meta = make_meta(muscles={"pam1": make_meta()["muscles"]["pam1"]})
    found = read(tmp_path, write_dataset(tmp_path / "dataset", samples, meta))["measured"]
    assert found["contraction"].isna().sum() == hole.sum() == 11
    assert list(found["contraction_velocity_per_s"].isna()) == list(found["contraction"].isna())
    assert found["contraction_velocity_per_s"].abs().max() < 0.25


@pytest.mark.parametrize("how", ["no rows", "no values in column force_n"])
def test_a_muscle_without_data_is_left_out_and_said(tmp_path, how):
    samples = make_samples()
    silent = samples["muscle"] == "pam2"
    samples = samples[~silent] if how == "no rows" else samples.assign(force_n=samples["force_n"].where(~silent))
    tables = read(tmp_path, write_dataset(tmp_path / "dataset", samples))
    assert list(tables["measured_muscles"]["muscle"]) == ["pam1"]
    assert tables["measured"]["muscle"].eq("pam1").all()
    assert tables["measured_notes"].to_numpy().tolist() == [["pam2", f"left out: {how}"]]


def test_a_part_belongs_to_its_trial(tmp_path):
    samples = make_samples()
    parts = samples["trial"].map({0: "fit", 1: "verify", 2: "fit"})
    tables = read(tmp_path, write_dataset(tmp_path / "dataset", samples.assign(part=parts)))
    assert list(tables["measured_trials"]["part"]) == ["fit", "verify", "fit"]
    told = refusal(tmp_path, samples.assign(part=parts.where(samples.index != 7, "verify")))
    assert "column part: expected one for each trial" in told


def test_a_clock_that_runs_through_the_session_tells_when_trials_start(tmp_path):
    samples = make_samples()
    samples["time_s"] += 20.0 * samples["trial"]
    tables = read(tmp_path, write_dataset(tmp_path / "dataset", samples))
    assert list(tables["measured_trials"]["start_s"]) == [0.0, 20.0, 40.0]
    assert tables["measured"].groupby("trial")["time_s"].max().tolist() == [0.396] * 3


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda samples: samples.drop(columns="force_n"), "samples.parquet: no column force_n; "),
        (
            lambda samples: samples.rename(columns={"pressure_kpa": "pressure_kPa"}),
            "did you mean 'pressure_kPa'?; say which with",
        ),
        (
            put("force_n", [5], "n/a"),
            "column force_n: expected numbers, got 'n/a' in row 5; leave empty in the file what",
        ),
        (put("pressure_kpa", [1, 2, 8, 9], np.inf), "expected finite numbers, got inf in rows 1, 2, 8 and"),
        (put("muscle", [3], "pam9"), "meta.json has no muscle 'pam9' of row 3; it has pam"),
        (put("time_s", [4], np.nan), "column time_s: expected a value in every row, got none in row 4"),
        (put("trial", [4], 0.5), "column trial: expected whole numbers from 0, got others in row 4"),
        (put("muscle", [4], None), "column muscle: expected text, got nothing in row 4"),
        (lambda samples: pd.concat([samples, samples.head(2)]), "column time_s: rows 600, 601 repeat"),
        (lambda samples: samples.iloc[::-1], "column time_s: time goes back in rows 2, 3, 4 and"),
        (put("force_n", [0], 1e6), "expected -2000 to 20000 N, got 1e+06 in row 0; remove what is no"),
        (put("force_n", range(20), 1e6), "or leave it empty; if its column is another's, set columns.force_n=COLUMN"),
        (scale("pressure_kpa", 1000.0), "in rows 0, 1, 2 and 597 more; set units.pressure_kpa=Pa"),
        (scale("pressure_kpa", 0.01), "set units.pressure_kpa=bar, or units.pressure_kpa=kPa if they are right"),
        (scale("force_n", 0.001), "set units.force_n=kN"),
        (scale("contraction", 100.0), "set units.contraction=percent"),
        (scale("time_s", 1000.0), "set units.time_s=ms"),
        (scale("force_n", np.nan), "expected values of both for some muscle, got none"),
        (lambda samples: samples.iloc[:0], "expected samples, got no rows"),
        (
            lambda samples: samples.drop(columns=["contraction", "joint_angle_rad"]),
            "no column contraction and no joint_angle_rad, of which one is needed",
        ),
    ],
)
def test_refuses_samples_in_one_line(tmp_path, change, told):
    message = refusal(tmp_path, change(make_samples()).reset_index(drop=True))
    assert told in message
    assert "samples.parquet" in message


def without(muscle, key):
    muscles = make_meta()["muscles"]
    return {**muscles, muscle: {name: value for name, value in muscles[muscle].items() if name != key}}


@pytest.mark.parametrize(
    ("meta", "told"),
    [
        ([], "meta.json: expected a mapping with sampling_rate_hz and muscles"),
        ({"muscles": make_meta()["muscles"]}, "meta.json: lacks sampling_rate_hz"),
        (make_meta(muscles=without("pam1", "sign")), "meta.json: lacks muscles.pam1.sign"),
        (
            make_meta(muscles={"pam1": make_meta()["muscles"]["pam1"]}),
            "has no muscle 'pam2' of rows 1, 3, 5 and 297 more",
        ),
        (make_meta(load_cell_site="tip"), "load_cell_site: input should be 'muscle_tip', 'joint_end'"),
        (make_meta(sampling_rate_hz=100.0), "expected steps of 0.01 s (100 Hz are stated), got 0.004 s; correct"),
        (
            make_meta(muscles={"pam1": {**make_meta()["muscles"]["pam1"], "rest_length_m": 320.0}}),
            "muscles.pam1.rest_length_m: input should be less than or equal to 10, got '320.0'",
        ),
        (make_meta(nominal={"braid_angel_deg": 20.0}), "nominal.braid_angel_deg: did you mean 'braid_angle_deg'?"),
        (
            make_meta(nominal={"damping_n_s": {"pam9": 20.0}}),
            "nominal.damping_n_s: no muscle 'pam9'; did you mean 'pam",
        ),
        (make_meta(trial_start_s=[0.0, 5.0]), "trial_start_s: expected one for each of 3 trials, got 2"),
        (make_meta(trial_start_s=[0.0, 5.0, 4.0]), "trial_start_s: expected each trial to start after the one before"),
    ],
)
def test_refuses_meta_in_one_line(tmp_path, meta, told):
    assert told in refusal(tmp_path, None, meta)


def test_refuses_columns_and_units_that_are_not_there(tmp_path):
    told = refusal(tmp_path, make_samples().drop(columns="muscle"))
    assert told.endswith(
        "of another machine, set measurement=records: python -m pipeline.columns FILE prints the command"
    )
    assert "no column 'F', which columns.force_n names" in refusal(tmp_path, None, None, "columns.force_n=F")
    with pytest.raises(ConfigError, match=r"units\.force_n: no unit 'pound'; choose from: N, mN"):
        read(tmp_path, write_dataset(tmp_path / "dataset"), "units.force_n=pound")
    with pytest.raises(ConfigError, match=r"columns: no column 'force'; did you mean 'force_n'\?"):
        read(tmp_path, write_dataset(tmp_path / "dataset"), "+columns.force=F")


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("meta.json", b'{"muscles": {', "expected JSON, got Expecting property name"),
        ("meta.json", None, "expected samples.parquet and meta.json in this folder, meta.json is missing"),
        ("samples.parquet", None, "expected samples.parquet and meta.json in this folder, samples.parquet is missing"),
        ("samples.parquet", b"PAR1 not really PAR1", "samples.parquet: cannot be read as PARQUET ("),
    ],
)
def test_refuses_broken_files(tmp_path, name, content, told):
    folder = write_dataset(tmp_path / "dataset")
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    assert told in refuse_measured(tmp_path, folder)


def test_a_rounded_clock_is_borne_on_request(tmp_path):
    samples = make_samples()
    samples["time_s"] = (samples["time_s"] * 250.0 / 300.0).round(3)
    folder = write_dataset(tmp_path / "dataset", samples, make_meta(sampling_rate_hz=300.0))
    assert "resample it, or raise measurement.largest_jitter" in refuse_measured(tmp_path, folder)
    assert read(tmp_path, folder, "measurement.largest_jitter=0.25")["measured"]["force_n"].notna().all()


def test_another_gap_than_a_gap_is_refused(tmp_path):
    samples = make_samples(trials=1)
    samples.loc[samples["time_s"] > 0.2, "time_s"] += 1000.0
    assert "nothing for 250001 samples before rows 102, 103; tell what begins" in refusal(tmp_path, samples).replace(
        ", longer than what was recorded", ""
    )


def test_small_pressures_are_believed_when_their_unit_is_stated(tmp_path):
    samples = make_samples().assign(pressure_kpa=0.05 * make_samples()["pressure_kpa"])
    folder = write_dataset(tmp_path / "dataset", samples)
    found = read(tmp_path, folder, "units.pressure_kpa=kPa")["measured"]
    assert found["pressure_kpa"].max() == pytest.approx(samples["pressure_kpa"].max())


def test_the_plan_tells_each_column_and_the_command_what_is_missing_in_a_line(pamid, tmp_path):
    folder = write_dataset(tmp_path / "dataset", make_samples().drop(columns="force_n"))
    plan = pamid("workflow=discrepancy", f"measured={folder}", "plan=true")
    assert re.search(r"pressure_kpa +<- pressure_kpa\n", plan.stdout)
    assert re.search(r"force_n +<- MISSING \(force_n\); say which with columns.force_n=NAME", plan.stdout)
    result = pamid("workflow=discrepancy", f"measured={folder}")
    assert (plan.returncode != 0, result.returncode) == (True, 1)
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith(f"measurement failed: {folder}/samples.parquet: no column force_n; ")
    assert line.removeprefix("measurement failed: ").startswith(plan.stderr.strip())


def test_the_plan_reads_the_file_so_that_it_tells_and_refuses_what_the_run_does(pamid, tmp_path):
    folder = write_dataset(tmp_path / "dataset")
    told = pamid("workflow=discrepancy", f"measured={folder}", "plan=true")
    trials = make_samples()["trial"].nunique()
    assert re.search(rf"\n +{trials} trials of .* at \S+ Hz\n", told.stdout), told.stdout
    write_dataset(folder, make_samples().assign(force_n="none"))
    refused = pamid("workflow=discrepancy", f"measured={folder}", "plan=true")
    assert refused.returncode != 0
    assert "force_n" in refused.stderr


def test_the_plan_of_a_folder_without_meta_is_refused_as_its_run_is(pamid, tmp_path):
    folder = write_dataset(tmp_path / "dataset")
    (folder / "meta.json").unlink()
    plan = pamid("workflow=discrepancy", f"measured={folder}", "plan=true")
    assert plan.returncode != 0
    assert "expected samples.parquet and meta.json in this folder, meta.json is missing" in plan.stderr
