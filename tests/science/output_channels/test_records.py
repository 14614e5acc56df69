"""Records of an oscillator through the whole workflow: foreign names and units, and recordings of others."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.integrate import solve_ivp

RECORDED = Path("/work/shared/data/silverbox/silverbox.parquet")
HERTZ, DAMPING, STIFFNESS_N_PER_M, RATE_HZ = 2.0, 0.1, 200.0, 50.0
NOISE_M, SCALE_M = 0.0003, 0.04
LINE = ("workflow=discrepancy", "measurement=records", "columns.time_s=t_ms", "units.time_s=ms", "+columns.force_n=F")
PLANT = ("plant=second_order", "plant.input=force_n", "plant.output=position_m", "plant.time_scale_s=0.08")
PLANT += ("plant.between_samples=band_limited", f"plant.output_scale={SCALE_M}")


def write_record(path, share, seconds=96.0):
    """Write a record of a mass on a spring, whose cube pulls by `share` of the linear part at the usual motion."""
    generator = np.random.default_rng(7)
    lines = np.arange(0.25, 5.0, 0.05)
    phase, omega = generator.uniform(0, 2 * np.pi, len(lines)), 2 * np.pi * HERTZ

    def force(now):
        return 1.6 * np.sqrt(2 / len(lines)) * np.sin(2 * np.pi * lines * now + phase).sum()

    def rates(now, state):
        x, v = state
        spring = x * (1.0 + share * (x / SCALE_M) ** 2)
        return v, omega**2 * (force(now) / STIFFNESS_N_PER_M - spring - 2.0 * DAMPING * v / omega)

    instants = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    tight = {"rtol": 1e-7, "atol": 1e-9, "max_step": 0.05}
    motion = solve_ivp(rates, (0.0, instants[-1]), (0.0, 0.0), t_eval=instants, **tight).y[0]
    position = motion + NOISE_M * generator.standard_normal(len(instants))
    columns = {"t_ms": 1e3 * instants, "F": [force(now) for now in instants], "pos": 1e3 * position}
    pd.DataFrame(columns).to_csv(path, sep=";", index=False)
    return position


def run(pamid, path, *overrides):
    """Run the workflow on a record of foreign columns; return its folder and its verdict."""
    position = ("+columns.position_m=pos", "+units.position_m=mm")
    result = pamid(*LINE, f"measured={path}", *position, "figures=[]", *overrides)
    assert result.returncode == 0, result.stderr
    return pamid.runs[-1], json.loads((pamid.runs[-1] / "verdict.json").read_text())


@pytest.mark.slow
def test_a_hidden_cubic_spring_is_named_and_the_amended_plant_lacks_nothing(pamid, tmp_path):
    position = write_record(tmp_path / "run.csv", share=0.3)
    folder, verdict = run(pamid, tmp_path / "run.csv", *PLANT)
    assert verdict["status"] == "named"
    (effect,) = verdict["effects"]
    assert (effect["name"], effect["site"], effect["muscles"]) == ("cubic_stiffness", "motion", ["oscillator"])
    share = effect["parameters"]["share"]
    assert share["low"] <= share["value"] <= share["high"]
    assert share["value"] == pytest.approx(0.3, rel=0.03)
    assert verdict["gap"]["after"] == pytest.approx(NOISE_M / np.ptp(position), rel=0.1)
    assert verdict["gap"]["before"] > 3.0 * verdict["gap"]["after"]
    amended = folder / "documents" / "amended.yaml"
    constants = yaml.safe_load(amended.read_text())["constants"]
    assert constants["static_gain"]["start"] == pytest.approx(1.0 / STIFFNESS_N_PER_M, rel=0.01)
    assert constants["natural_frequency_hz"]["start"] == pytest.approx(HERTZ, rel=0.01)
    _, again = run(pamid, tmp_path / "run.csv", f"plant={amended}")
    assert (again["status"], again["effects"]) == ("no_discrepancy", [])
    assert sum(each["probability"] for each in again["ranking"]) == pytest.approx(1.0)
    rows = pd.read_parquet(pamid.runs[-1] / "tables" / "verification.parquet")
    assert set(rows["simulation"]) == {"measured upstream"}
    assert again["gap"]["before"] == pytest.approx(verdict["gap"]["after"], rel=0.05)


def test_a_plant_that_does_not_fit_the_recording_is_refused_in_one_line(pamid, tmp_path):
    write_record(tmp_path / "run.csv", share=0.0, seconds=20.0)
    for plant, told in (
        ("nominal", "or second_order or"),
        ("second_order", "signal drive_v, named by plant.input: expected it to be measured; known are force_n"),
        ("second_order", "; type plant.input=NAME, or add +columns.drive_v=COLUMN"),
        ("static_map", "signal position_m, named by plant.constants.stiffness.of and plant.along: expected"),
        ("static_map +columns.way_m=F", "known are force_n, way_m; type plant.along=way_m, or add"),
    ):
        result = pamid(*LINE, f"measured={tmp_path}/run.csv", *f"plant={plant}".split(), "plan=true")
        assert result.returncode == 2
        assert not pamid.runs
        (message,) = result.stderr.strip().splitlines()
        assert told in message


@pytest.mark.slow
@pytest.mark.skipif(not RECORDED.exists(), reason=f"needs the recorded oscillator, {RECORDED}")
def test_the_spring_of_a_recorded_oscillator_is_named_by_one_command(pamid, tmp_path):
    """Of a third of the random motion, and told of where the arrow is widest, beyond what was fitted."""
    frame = pd.read_parquet(RECORDED)
    motion, arrow = (frame[frame["part"] == part] for part in ("multisine", "arrow_test"))
    pd.concat([motion[:16000], arrow[-10000:]]).to_parquet(tmp_path / "record.parquet")
    result = pamid(LINE[0], "measurement=silverbox", f"measured={tmp_path}/record.parquet", "figures=[]")
    assert result.returncode == 0, result.stderr
    (folder,) = pamid.runs
    verdict = json.loads((folder / "verdict.json").read_text())
    assert [each["name"] for each in verdict["effects"]] == ["cubic_stiffness"]
    rows = pd.read_parquet(folder / "tables" / "verification.parquet").set_index(["part", "step"])["gap_over_std"]
    assert rows["verification", 0] > 0.1
    assert rows["verification", 1] < 0.020
    assert rows["arrow_test", 1] < 0.020
    samples = pd.read_parquet(folder / "tables" / "predictions.parquet")
    opened = samples[samples["part"] == "verification"]
    error = np.sqrt(np.mean((opened["measured"] - opened["after"]) ** 2)) / opened["measured"].std(ddof=0)
    assert error == pytest.approx(rows["verification", 1], rel=1e-9)
    kept = pd.read_parquet(folder / "tables" / "trial_parts.parquet")["part"].value_counts()
    assert kept.to_dict() == {"other": 16, "fitted": 10, "verification": 6}
