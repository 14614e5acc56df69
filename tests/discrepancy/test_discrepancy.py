"""The discrepancy workflow as a person types it: what it leaves, and that bad data never bring a confident name."""

import functools
import json

import numpy as np
import pandas as pd
import pytest
import yaml

from stages.science.discrepancy.settings import choose_verification
from tests.measured_data import write_dataset
from tests.science.discrepancy import sessions
from tests.science.discrepancy.sessions import record_session

STATUSES = ("no_discrepancy", "named", "unexplained")
SITES = ("command", "valve", "pressure", "muscle", "transmission", "joint", "sensor", "oscillator", "drive", "tank")
CONFIDENT = 0.8


def check_verdict(verdict, muscles):
    """Each key of the verdict, its type and its range."""

    def check_numbers(row, *names, low=0.0, high=np.inf):
        assert all(isinstance(row[name], float) and low <= row[name] <= high for name in names)

    assert verdict["status"] in STATUSES
    assert bool(verdict["effects"]) == (verdict["status"] == "named")
    for effect in verdict["effects"]:
        assert effect["site"] in SITES
        assert set(effect["muscles"]) <= set(muscles)
        check_numbers(effect, "probability", high=1.0)
        assert all(isinstance(each, str) for each in effect["indistinguishable_from"])
        assert effect["parameters"]
        assert all(each["low"] <= each["value"] <= each["high"] for each in effect["parameters"].values())
    names = [row["name"] for row in verdict["ranking"]]
    assert {"none", "unknown"} < set(names)
    assert len(names) == len(set(names))
    assert sum(row["probability"] for row in verdict["ranking"]) == pytest.approx(1.0, abs=1e-6)
    for row in verdict["ranking"]:
        check_numbers(row, "probability", high=1.0)
        check_numbers(row, "heldout_gap")
        assert isinstance(row["absorbed"], bool)
    for place in verdict["where"]:
        assert place["channel"] in ("pressure_kpa", "force_n")
        assert place["muscle"] in muscles
        assert place["regime"]
        check_numbers(place, "p_value", low=1e-4, high=1.0)
        check_numbers(place, "share_of_gap", low=0.0, high=1.0)
    gap, trials = verdict["gap"], verdict["verification_trials"]
    check_numbers(gap, "before", "after", "noise_floor", "low", "high")
    assert gap["low"] <= gap["after"] <= gap["high"]
    assert gap["unit"] == "RMSE / range, verification trials"
    assert trials
    assert all(isinstance(each, int) for each in trials)
    check_numbers(gap, "p_value", low=min(2.0 * 0.5 ** len(trials), 1.0), high=1.0)


def pool_gap(predictions, channels, signal):
    """The gap as anyone would compute it from the samples that are kept."""
    rows = predictions[predictions["channel"].isin(channels)]
    cells = rows.groupby(["channel", "muscle"])["measured"]
    wide = cells.transform("max") - cells.transform("min")
    relative = ((rows["measured"] - rows[signal]) / wide) ** 2
    opened = rows["part"] == "verification"
    cell_means = relative[opened].groupby([rows[name][opened] for name in ("trial", "channel", "muscle")]).mean()
    return float(np.sqrt(cell_means.groupby("trial").mean().mean()))


def run(pamid, tmp_path, samples, meta, *more):
    """Run the workflow on a session."""
    numbers = list(dict.fromkeys(samples["trial"]))
    meta = {**meta, "trials": len(numbers), "trial_start_s": meta["trial_start_s"][: len(numbers)]}
    folder = write_dataset(tmp_path / "rig", samples, meta)
    return pamid("workflow=discrepancy", f"measured={folder}", "workers=1", *more)


def judge(pamid, tmp_path, samples, meta, *more):
    """Return what the workflow prints of a session, in one line, and the verdict, which is checked."""
    result = run(pamid, tmp_path, samples, meta, *more)
    assert result.returncode == 0, result.stderr
    verdict = json.loads((pamid.runs[0] / "verdict.json").read_text())
    check_verdict(verdict, meta["muscles"])
    return " ".join(result.stdout.split()), verdict


record_sound = functools.cache(record_session)
"""Muscles without any hidden effect, in six short trials."""


def test_a_hidden_effect_is_named_explained_drawn_and_simulated(pamid, tmp_path):
    samples, meta = record_session(["hysteresis"], trials=8, seconds=1.6, muscles=("pam1",))
    said, verdict = judge(pamid, tmp_path, samples, meta, "figures=[png]")
    assert [effect["name"] for effect in verdict["effects"]] == ["hysteresis"]
    assert verdict["gap"]["channels"] == ["force_n"]
    run = pamid.runs[0]
    predictions = pd.read_parquet(run / "tables" / "predictions.parquet")
    for signal in ("before", "after"):
        assert pool_gap(predictions, ["force_n"], signal) == pytest.approx(verdict["gap"][signal], rel=1e-9)
    for words in ("pam1: nominal force is off by up to", "This is hysteresis on pam1", "the noise floor ("):
        assert words in said
    drawn = {"gap_bars", "gap_map", "residual_plane", "residual_loops", "ranking", "gap_waterfall", "verified_trials"}
    assert drawn | {"signature_hysteresis"} <= {path.stem for path in (run / "figures").iterdir()}
    proposed = pd.read_parquet(run / "tables" / "proposed_trials.parquet")
    assert "No further trial is proposed" in said  # hysteresis is sure
    assert (proposed["probability"].round(3).diff().dropna() <= 0.0).all()
    step = verdict["effects"][0]["step"]
    falls = f"With it the gap goes from {100 * step['before']:.1f} % to {100 * step['after']:.2f} % of range"
    assert falls in (run / "report.html").read_text()
    check_amended(pamid, run)


@pytest.mark.parametrize(("counts", "names"), [(0.7, []), (5.0, ["quantisation"])])
def test_counts_of_a_sensor_are_named_where_their_rounding_is_noise_that_matters(counts, names, pamid, tmp_path):
    samples, meta = record_sound(muscles=("pam1",))
    size_n = counts * np.median(np.abs(np.diff(samples["force_n"], n=2))) / 0.6745 / 6.0**0.5
    coarse = samples.assign(force_n=np.round(samples["force_n"] / size_n) * size_n)
    said, verdict = judge(pamid, tmp_path, coarse, meta, "figures=[]")
    assert [effect["name"] for effect in verdict["effects"]] == names
    assert all(effect["reproduced"] and effect["probability"] > 0.98 for effect in verdict["effects"])
    assert ("force moves in equal steps and stands between them" in said) == bool(names)
    check_amended(pamid, pamid.runs[0])


def check_amended(pamid, run):
    """What was fitted stands in the amended plant, and the simulator takes it as it is."""
    path = run / "documents" / "amended.yaml"
    plant = yaml.safe_load(path.read_text())
    values = pd.read_parquet(run / "tables" / "amended_values.parquet")
    for row in values.to_dict("records"):
        entry = plant["muscles"][row["muscle"]]
        if row["effect"]:
            key = (row["effect"], [row["muscle"]])
            entry = next(each for each in plant["effects"] if (each["name"], each["muscles"]) == key)
        assert entry[row["parameter"]] == row["value"]
    assert (values["parameter"] == "passive_linear_n").any()
    result = pamid(f"plant={path}", "budget=tiny", "stages=[bank]", "exoskeleton.load_cell_site=joint_end")
    assert result.returncode == 0, result.stderr
    assert len(pd.read_parquet(pamid.runs[-1] / "tables" / "bank.parquet"))


@pytest.mark.slow
def test_what_has_no_name_is_described_as_a_hint(pamid, tmp_path):
    samples, meta = record_session(["neighbour_pressure"], trials=6, seconds=2.0)
    said, verdict = judge(pamid, tmp_path, samples, meta, "figures=[png]")
    assert verdict["status"] == "unexplained"
    rows = {row["muscle"]: row for row in verdict["remainder"]["depends_on"] if row["channel"] == "force_n"}
    assert rows["pam1"]["inputs"][0] == "pam2 pressure_kpa"
    assert 0.0 < rows["pam1"]["low"] < rows["pam1"]["share"] < rows["pam1"]["high"] < 1.0
    assert "What stays unexplained in force of pam" in said
    (learned,) = verdict["remainder"]["learned_maps"]
    assert learned["channel"] == "force_n"
    assert "pam2 pressure_kpa" in learned["inputs"]
    assert learned["after"] < 0.7 * learned["before"]
    amended = pamid.runs[0] / "documents" / "amended.yaml"
    assert {each["element"] for each in yaml.safe_load(amended.read_text())["learned"]} == set(learned["muscles"])
    result = pamid(f"plant={amended}", "budget=tiny", "stages=[bank]", "exoskeleton.load_cell_site=joint_end")
    assert result.returncode == 0, result.stderr
    assert "A hint, no finding: on pam" in said
    assert "unexplained.png" in {path.name for path in (pamid.runs[0] / "figures").iterdir()}


SPOILT = {
    "unequal trials and stretches without values": sessions.lose_stretches,
    "three trials": lambda samples: samples[samples["trial"] < 3],
    "no force": lambda samples: samples.assign(force_n=0.0),
    "constant pressure": sessions.hold_pressure,
    "a silent muscle": sessions.silence,
    "no command": lambda samples: samples.drop(columns="pressure_command_kpa"),
    "a wild trial": sessions.shake,
    "half a second": lambda samples: samples[samples["time_s"] < 0.5],
    "100 Hz": lambda samples: sessions.resample(samples, 100.0),
    "1000 Hz": lambda samples: sessions.resample(samples, 1000.0),
}
TOLD = {
    "no force": "never change: force of pam1",
    "a silent muscle": "pam2 left out",
    "no command": "never change: pressure of pam1",
    "a wild trial": "Look at trial 1",
}
OF_TWO = ("a silent muscle", "constant pressure", "a wild trial")
CASES = [pytest.param(name, marks=[] if name == "no force" else [pytest.mark.slow]) for name in SPOILT]


@pytest.mark.parametrize("how", CASES)
def test_bad_data_and_other_rates_bring_no_confident_name(how, pamid, tmp_path):
    samples, meta = record_sound(muscles=("pam1", "pam2") if how in OF_TWO else ("pam1",))
    meta = {**meta, "sampling_rate_hz": float(how.split()[0]) if how.endswith("Hz") else meta["sampling_rate_hz"]}
    said, verdict = judge(pamid, tmp_path, SPOILT[how](samples), meta, "figures=[]")
    assert not [each for each in verdict["effects"] if each["probability"] > CONFIDENT]
    assert TOLD.get(how, "What was found") in said


@pytest.mark.slow
@pytest.mark.parametrize(("slip_n", "status"), [(0.0, "no_discrepancy"), (60.0, "unexplained")])
def test_what_only_opened_trials_show_is_not_called_nothing(slip_n, status, pamid, tmp_path):
    samples, meta = record_sound()
    opened = choose_verification(samples["trial"].nunique(), 0.375)[-1]
    late = (samples["trial"] == opened) & (samples["time_s"] > 0.5 * samples["time_s"].max())
    said, verdict = judge(
        pamid, tmp_path, samples.assign(force_n=samples["force_n"] + slip_n * late), meta, "figures=[]"
    )
    assert opened in verdict["verification_trials"]
    assert (verdict["status"], verdict["effects"]) == (status, [])
    assert (verdict["missing_probability"] >= 0.5) == (slip_n > 0.0)
    assert (f"Look at trial {opened}" in said, "cannot be told" in said) == (slip_n > 0.0, slip_n > 0.0)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda samples: samples[samples["trial"] < 2], "expected at least 3 trials"),
        (lambda samples: samples.drop(columns="pressure_command_kpa").assign(force_n=0.0), "that changes"),
    ],
)
def test_what_cannot_be_judged_is_refused_in_a_line(spoil, message, pamid, tmp_path):
    samples, meta = record_sound()
    result = run(pamid, tmp_path, spoil(samples), meta)
    assert result.returncode == 1
    assert not list(tmp_path.rglob("verdict.json"))
    (line,) = result.stderr.strip().splitlines()
    assert message in line
    assert "Traceback" not in line + result.stdout
