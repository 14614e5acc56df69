"""What the opened trials show is told beside what was named, and decides nothing."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.verdict import reproduce_effects
from stages.science.discrepancy.verification import Opened
from tests.science.discrepancy.searches import DISCREPANCY, run_records
from tests.science.discrepancy.simulated_records import move, slide

STEP_S, SAMPLES = 0.02, 1600
PLACE = {"channel": "force_n", "muscle": "pam1"}
PARTS = ("parts.fitted=[est]", "parts.verification=[val]")


@pytest.mark.parametrize(
    ("p_step", "trials", "reproduced"), [(0.016, 6, True), (0.3, 6, False), (0.125, 3, True), (0.25, 3, False)]
)
def test_the_opened_trials_tell_whether_an_effect_is_reproduced(p_step, trials, reproduced):
    named = pd.DataFrame([{"order": k + 1, "name": f"e{k}", "probability": 0.9, **PLACE} for k in range(2)])
    steps = {"step": range(4), "gap": [0.4, 0.2, 0.1, 0.1], "trials": trials, "p_step": [1, 0.01, p_step, 1]}
    told = reproduce_effects(named, pd.DataFrame(steps), {tuple(PLACE.values())}, DISCREPANCY)
    assert told["reproduced"].tolist() == [True, reproduced]
    assert told["probability"].tolist() == [0.9, 0.9]
    assert told[["gap_before", "gap_after"]].to_numpy().tolist() == [[0.4, 0.2], [0.2, 0.1]]


def judge_bench(pamid, path, frame, *overrides):
    """Return what the command prints of a record of an element, and its verdict."""
    frame.to_csv(path, index=False)
    return run_records(pamid, path, "+columns.position_m=x", "+columns.force_n=F", "plant=static_map", *overrides)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.8, 0.0], ids=["there", "gone"])
def test_a_loop_that_the_kept_record_lacks_is_named_and_not_reproduced(pamid, tmp_path, kept):
    parts = []
    for seed, (part, loop) in enumerate((("est", 0.8), ("val", kept))):
        way, noise = move(seed, SAMPLES), 0.05 * np.random.default_rng(seed).standard_normal(SAMPLES)
        force = 300.0 * way + 2.0 + loop * slide(way, 0.004) + noise
        parts.append(pd.DataFrame({"t": np.arange(SAMPLES) * STEP_S, "x": way, "F": force, "part": part}))
    told, verdict = judge_bench(pamid, tmp_path / "bench.csv", pd.concat(parts), *PARTS)
    (effect,) = verdict["effects"]
    assert effect["name"] == "hysteresis"
    assert effect["reproduced"] == (kept > 0.0)
    assert (effect["step"]["after"] < effect["step"]["before"]) == (kept > 0.0)
    assert ("Trials not fitted do not show it" in told) == (kept == 0.0)


@pytest.mark.slow
def test_a_wrong_column_gets_no_clean_bill(pamid, tmp_path, generator):
    way = np.convolve(generator.standard_normal(SAMPLES), np.ones(40) / 40.0, mode="same")
    frame = pd.DataFrame({"t": np.arange(SAMPLES) * STEP_S, "x": way, "F": generator.standard_normal(SAMPLES)})
    told, verdict = judge_bench(pamid, tmp_path / "bench.csv", frame)
    assert (verdict["status"], verdict["effects"]) == ("unexplained", [])
    assert "look whether columns, units and signs are right" in told


@pytest.mark.parametrize("order", [1, -1])
def test_the_gap_over_the_floor_is_that_of_the_channel_where_it_is_largest(order):
    def channel(name, gap, floor, trials=3, samples=10):
        """An output of a channel with the same squared gap and floor in every trial."""
        return SimpleNamespace(
            output=SimpleNamespace(channel=name, present=np.ones((samples, trials), dtype=bool)),
            floor=samples * np.full(trials, floor**2),
            steps=[samples * np.full(trials, gap**2)],
            squares=lambda step: step,
        )

    found = [channel("force_n", 0.03, 0.01), channel("pressure_kpa", 0.08, 0.04)][::order]
    opened = Opened(found, DISCREPANCY, lambda *purpose: np.random.default_rng(0))
    ratio = opened.bound_ratio(0, "verification", range(3))
    assert ratio == {name: pytest.approx(3.0) for name in ("value", "low", "high")}
