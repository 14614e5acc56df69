"""An effect is confirmed by trials that were not fitted, or it is not, whatever the fitted ones say."""

import json

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.verdict import confirm_effects, confirm_status
from stages.science.discrepancy.verification import Verified, list_hidden
from tests.science.discrepancy.searches import DISCREPANCY, SETTINGS
from tests.science.discrepancy.simulated_records import move, slide
from tests.science.discrepancy.toys import make_toy

STEP_S, SAMPLES = 0.02, 1600
PARTS = ("parts.fitted=[est]", "parts.verification=[val]")


def judge(p_step, trials=6, shown=False, hidden=()):
    row = {"probability": 0.9, "shown": shown}
    named = pd.DataFrame([{"order": k + 1, "name": f"e{k}", "channel": "xy"[k], **row} for k in range(2)])
    driven = pd.DataFrame({"step": range(4), "gap": [0.4, 0.2, 0.1, 0.1], "trials": trials, "p_step": [1, *p_step, 1]})
    return confirm_effects(named, driven, DISCREPANCY, hidden)


def test_what_takes_nothing_away_is_half_as_probable():
    told = judge([0.016, 0.3])
    assert told["confirmed"].tolist() == [True, False]
    assert told["probability"].tolist() == [0.9, 0.45]
    assert told["gap_before"].tolist() == [0.4, 0.2]
    assert told["gap_after"].tolist() == [0.2, 0.1]


def test_what_exact_values_show_needs_no_confirmation():
    assert judge([0.4, 0.3], shown=True)["probability"].tolist() == [0.9, 0.9]


@pytest.mark.parametrize(("p_step", "confirmed"), [(0.125, True), (0.25, False)])
def test_of_few_trials_the_least_p_that_there_can_be_is_asked(p_step, confirmed):
    assert judge([0.01, p_step], trials=3)["confirmed"].tolist()[1] == confirmed


def test_beside_a_floor_that_hides_what_there_is_a_name_is_at_most_as_likely_as_not():
    assert judge([0.016, 0.016], hidden=["y"])["probability"].tolist() == [0.9, 0.5]
    assert judge([0.016, 0.3], hidden=["y"])["probability"].tolist() == [0.9, 0.25]
    assert judge([0.016, 0.016], shown=True, hidden=["y"])["probability"].tolist() == [0.9, 0.9]


@pytest.mark.parametrize(
    ("floor", "white", "hidden"), [(0.06, 0.01, ["y"]), (0.06, 0.03, []), (0.03, 0.001, [])], ids=str
)
def test_whether_a_floor_hides_what_there_is_the_opened_trials_say(floor, white, hidden):
    output = make_toy(0)
    left = np.array([0.001] * 5 + [floor] * 3) ** 2 * output.present.sum(axis=0)
    channels = pd.DataFrame([{"channel": "y", "muscle": "toy", "white": white * output.range}])
    seen = [Verified(output, [], [], left)]
    assert list_hidden(seen, channels, [5, 6, 7], SETTINGS.remainder) == hidden
    assert list_hidden(seen, channels, [0, 1], SETTINGS.remainder) == []


@pytest.mark.parametrize(
    ("status", "over_floor", "blind", "said"),
    [
        ("unexplained", 1.1, False, "no_discrepancy"),
        ("unexplained", 1.2, False, "unexplained"),
        ("no_discrepancy", 1.1, False, "no_discrepancy"),
        ("no_discrepancy", 1.2, False, "unexplained"),
        ("no_discrepancy", 1.0, True, "unexplained"),
        ("named", 1.0, True, "named"),
    ],
)
def test_whether_there_is_a_gap_the_opened_trials_say(status, over_floor, blind, said):
    assert confirm_status(status, over_floor, 1.15, blind) == said


def judge_bench(pamid, path, frame, *overrides):
    """Return what the command prints of a record of an element, and its verdict."""
    frame.to_csv(path, index=False)
    columns = ("columns.time_s=t", "+columns.position_m=x", "+columns.force_n=F", "plant=static_map", "figures=[]")
    told = pamid("workflow=discrepancy", "measurement=records", f"measured={path}", *columns, *overrides)
    assert told.returncode == 0, told.stderr
    return " ".join(told.stdout.split()), json.loads((pamid.runs[-1] / "verdict.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.8, 0.0], ids=["there", "gone"])
def test_a_loop_that_the_kept_record_lacks_is_named_and_not_confirmed(pamid, tmp_path, kept):
    parts = []
    for seed, (part, loop) in enumerate((("est", 0.8), ("val", kept))):
        way, noise = move(seed, SAMPLES), 0.05 * np.random.default_rng(seed).standard_normal(SAMPLES)
        force = 300.0 * way + 2.0 + loop * slide(way, 0.004) + noise
        parts.append(pd.DataFrame({"t": np.arange(SAMPLES) * STEP_S, "x": way, "F": force, "part": part}))
    told, verdict = judge_bench(pamid, tmp_path / "bench.csv", pd.concat(parts), *PARTS)
    (effect,) = verdict["effects"]
    assert effect["name"] == "hysteresis"
    assert effect["confirmed"] == (kept > 0.0)
    assert (effect["probability"] > 0.5) == (kept > 0.0)
    assert (effect["step"]["after"] < effect["step"]["before"]) == (kept > 0.0)
    assert ("Trials not fitted do not confirm it" in told) == (kept == 0.0)


@pytest.mark.slow
def test_a_wrong_column_gets_no_clean_bill(pamid, tmp_path, generator):
    way = np.convolve(generator.standard_normal(SAMPLES), np.ones(40) / 40.0, mode="same")
    frame = pd.DataFrame({"t": np.arange(SAMPLES) * STEP_S, "x": way, "F": generator.standard_normal(SAMPLES)})
    told, verdict = judge_bench(pamid, tmp_path / "bench.csv", frame)
    assert (verdict["status"], verdict["effects"]) == ("unexplained", [])
    assert "look whether columns, units and signs are right" in told
