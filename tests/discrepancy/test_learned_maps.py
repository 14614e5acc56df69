"""What has no name is mended all the same: the learned map stands in the amended plant, apart from names."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.signal import lfilter

from tests.discrepancy.test_discrepancy import pool_gap
from tests.science.discrepancy.test_effect_file import load

NOISE_MM = 0.02
MAPPED = "columns.time_s=t", "columns.record=run", "+columns.input_v=input_v", "+columns.output_mm=output_mm"
SPRING = "plant=static_map", "plant.along=input_v", "plant.output=output_mm", "plant.constants.stiffness.of=[input_v]"


def bend(input_v):
    """Two bumps beside the straight line, mm, as no effect of the library makes them."""
    return 0.35 * np.exp(-0.5 * ((input_v - 0.6) / 0.35) ** 2) - 0.25 * np.exp(-0.5 * ((input_v + 1.0) / 0.3) ** 2)


def write_runs(path, seed=1, runs=12, samples=300, step_s=0.02):
    generator, frames = np.random.default_rng(seed), []
    for run in range(runs):
        wander = lfilter([0.06], [1.0, -0.94], generator.standard_normal(samples + 400))
        input_v = lfilter([0.06], [1.0, -0.94], wander)[400:] / 0.13
        output_mm = 2.0 * input_v + bend(input_v) + NOISE_MM * generator.standard_normal(samples)
        frames.append(
            pd.DataFrame({"run": run, "t": np.arange(samples) * step_s, "input_v": input_v, "output_mm": output_mm})
        )
    pd.concat(frames).to_csv(path, index=False)


@pytest.mark.slow
def test_a_law_without_a_name_is_learned_and_the_amended_plant_simulates_with_it(pamid, tmp_path):
    write_runs(tmp_path / "runs.csv")
    line = "workflow=discrepancy", "measurement=records", f"measured={tmp_path / 'runs.csv'}", *MAPPED, "figures=[]"

    def judge(*more):
        result = pamid(*line, *more)
        assert result.returncode == 0, result.stderr
        run = pamid.runs[-1]
        rows = pd.read_parquet(run / "tables" / "verification.parquet")
        gaps = rows[rows["part"] == "verification"].set_index("label")["gap"]
        return run, json.loads((run / "verdict.json").read_text()), gaps, " ".join(result.stdout.split())

    run, verdict, gaps, said = judge(*SPRING, "discrepancy.write_effect=my_bend")
    assert (verdict["status"], verdict["effects"]) == ("unexplained", [])
    left = verdict["remainder"]
    assert left["patch"] == "documents/amended.yaml"
    (learned,) = left["learned_maps"]
    assert (learned["kinds"], learned["inputs"], learned["muscles"]) == (["learned_static"], ["input_v"], ["element"])
    assert list(gaps.index) == ["nominal", "+ learned map", "noise floor"]
    noise = NOISE_MM / pd.read_csv(tmp_path / "runs.csv")["output_mm"].agg(np.ptp)
    assert gaps["nominal"] > 5.0 * noise
    assert gaps["+ learned map"] < 1.1 * noise
    assert gaps["noise floor"] == gaps["+ learned map"]  # which leaves less than generic features do
    predictions = pd.read_parquet(run / "tables" / "predictions.parquet")
    assert pool_gap(predictions, ["output_mm"], "patched") == pytest.approx(learned["after"], rel=1e-9)
    assert pool_gap(predictions, ["output_mm"], "after") == pytest.approx(verdict["gap"]["after"], rel=1e-9)
    bands = verdict["bands"]
    opened = predictions[predictions["part"] == "verification"]
    inside = (opened["low"] <= opened["measured"]) & (opened["measured"] <= opened["high"])
    assert inside.mean() == pytest.approx(bands["coverage"], abs=1e-9)
    assert bands["low"] <= bands["coverage"] <= bands["high"]
    assert 0.9 < bands["coverage"] < 0.99
    assert (opened["deviation"] > 0.0).all()
    assert "is mended by a learned map, of input: on trials not fitted the gap there goes from" in said
    effect, _ = load((run / "documents" / "my_bend.py").read_text())
    assert (effect.name, effect.site) == ("my_bend", "element")
    assert f"is an effect now: type cp '{run}/documents/my_bend.py' stages/science/effects/" in said
    assert "documents/amended.yaml discrepancy.write_effect=null" in said
    amended = run / "documents" / "amended.yaml"
    (kept,) = yaml.safe_load(amended.read_text())["learned"]
    assert kept["inputs"][0]["low"] < -1.0 < 1.0 < kept["inputs"][0]["high"]
    assert kept["deviation"] == pytest.approx(NOISE_MM, rel=0.2)

    wrong = tmp_path / "wrong.yaml"
    for what, other in (("channel", "pressure_kpa"), ("element", "pam1")):
        plant = yaml.safe_load(amended.read_text())
        plant["learned"][0][what] = other
        wrong.write_text(yaml.safe_dump(plant))
        refused = pamid(*line, f"plant={wrong}", "plan=true")
        assert refused.returncode == 2
        assert f"plant.learned.0.{what}: expected " in refused.stderr
    plant = yaml.safe_load(amended.read_text())
    plant["learned"][0]["inputs"][0]["name"] = "recent water_degc"
    wrong.write_text(yaml.safe_dump(plant))
    refused = pamid(*line, f"plant={wrong}", "plan=true")
    assert refused.returncode == 2
    assert "add +columns.water_degc=COLUMN, or take all maps out with plant.learned=[]" in refused.stderr

    _, again, mended, said = judge(f"plant={amended}")
    assert "has a learned map of input from before (plant.learned): " in said
    assert again["status"] == "no_discrepancy"
    assert mended["nominal"] == pytest.approx(gaps["+ learned map"], rel=0.02)

    _, without, plain, _ = judge(*SPRING, "discrepancy.patch=none")
    assert (without["remainder"]["patch"], without["remainder"]["learned_maps"]) == (None, [])
    assert list(plain.index) == ["nominal", "noise floor"]
    assert plain["nominal"] == gaps["nominal"]
