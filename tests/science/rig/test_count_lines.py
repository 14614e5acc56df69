"""Lines through known points, and the refusal of points that determine none; nothing is recorded here."""

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from stages.science.rig.festo.channels import COUNTER_SPAN, CountRange, EncoderPlace, ForcePlace
from stages.science.rig.festo.count_lines import find_followers, fit_line, judge_point
from stages.science.rig.festo.known_points import CalibrationSettings, find_reading, list_turns
from tests.conftest import ROOT

SETTINGS = CalibrationSettings.model_validate(
    OmegaConf.to_container(OmegaConf.load(ROOT / "conf" / "calibration" / "default.yaml"))
)
VALID = CountRange(low=-500, high=32000, none=[-32768, 32767])
CELL = ForcePlace(module=3, channel=0, n_per_count=0.1, zero_count=0.0, sign=1)
ENCODER = EncoderPlace(module=4, rad_per_count=6.283e-4, zero_count=0.0, sign=1)


def fit(known, count, problems=None, channel="pam1.force", place=CELL, followers=()):
    told = {"known": np.array(known, dtype=float), "count": np.array(count, dtype=float), "spread_count": 2.0}
    points = pd.DataFrame(told | {"problem": problems or ""})
    return fit_line(channel, points, place, VALID, SETTINGS, followers)


def test_a_line_is_the_inverse_of_what_the_channel_does(generator):
    value = np.repeat([0.0, 50.0, 100.0, 150.0], 2)
    line = fit(value, 700.0 - value / 0.12 + generator.normal(0.0, 0.5, len(value)))
    assert (line.status, line.sign, line.points) == ("calibrated", -1, 8)
    assert line.per_count == pytest.approx(0.12, rel=0.002)
    assert line.zero_count == pytest.approx(700.0, abs=1.0)
    assert 0.0 < line.residual_rms <= line.residual_largest < 0.3
    assert 0.0 < line.repeatability < 0.5
    assert not line.plausible
    assert line.told == "the sign is -1, configured 1"
    assert np.isnan(fit([0.0, 100.0], [0.0, 1000.0]).repeatability)


def test_a_point_that_was_taken_again_for_another_channel_is_not_used():
    again, once = fit([0.0, np.nan, 100.0], [0.0, 700.0, 1000.0]), fit([0.0, 100.0], [0.0, 1000.0])
    assert (again.status, again.points, again.per_count) == ("calibrated", 2, once.per_count)


@pytest.mark.parametrize(
    ("known", "count", "problems", "told"),
    [
        ([0.0], [0.0], [""], "expected points of use at two known values at least, got 1 of 1"),
        ([50.0, 50.0], [500.0, 501.0], ["", ""], "at two known values at least, got 1 of 2"),
        ([0.0, 50.0], [0.0, 32100.0], ["", "it was at its end"], "got 1 of 2, as it was at its end"),
        ([0.0, 50.0, 100.0], [11.0, 12.0, 11.0], [""] * 3, "the counts are the same at all points (11.0 to 12.0); is"),
        ([0.0, 50.0, 100.0], [0.0, 800.0, 1000.0], [""] * 3, "the point at 50 N lies 20 N from the line, 5 are"),
    ],
)
def test_points_that_determine_no_line_are_refused(known, count, problems, told):
    line = fit(known, count, problems)
    assert line.status == "refused"
    assert told in line.told
    assert np.isnan(line.per_count)


@pytest.mark.parametrize(
    ("count", "told"),
    [
        ([0.0, 500.0, 1000.0], ""),
        ([0.0, 250.0, 500.0], "a count is worth 2 times what is configured"),
        ([-600.0, -100.0, 400.0], "zero at count -600 lies out of the range -500 to 32000"),
    ],
)
def test_a_line_far_from_the_configuration_is_told(count, told):
    line = fit([0.0, 50.0, 100.0], count)
    assert line.status == "calibrated"
    assert line.told == told
    assert line.plausible == (not told)


def test_a_point_is_the_mean_the_spread_and_the_drift_of_its_counts():
    judged = judge_point(np.repeat([100.0, 101.0, 103.0, 104.0], 2), "force", CELL, VALID, SETTINGS)
    assert (judged.count, judged.drift_count, judged.samples, judged.problem) == (102.0, 4.0, 8, "")
    assert judged.spread_count == pytest.approx(np.sqrt(2.5))


@pytest.mark.parametrize(
    ("counts", "problem"),
    [
        ([500.0, 500.0, 500.0, -32768.0], "the channel told no value (count -32768)"),
        ([500.0, 500.0, 32000.0, 500.0], "the channel was at its end (count 32000, range -500 to 32000)"),
        ([500.0, 510.0, 520.0, 530.0], "it changed by 3 N meanwhile, 2 are permitted"),
        ([], "nothing was recorded"),
    ],
)
def test_a_record_of_no_use_says_why(counts, problem):
    assert judge_point(np.array(counts, dtype=float), "force", CELL, VALID, SETTINGS).problem == problem


def test_an_encoder_that_begins_anew_within_a_record_is_counted_on():
    counts = np.array([COUNTER_SPAN - 1.0, 0.0, 1.0, COUNTER_SPAN - 2.0])
    judged = judge_point(counts, "encoder", ENCODER, VALID, SETTINGS)
    assert judged.count == -0.5
    assert judged.problem == ""


def test_the_channel_that_follows_anothers_points_is_found():
    still, rising, noisy = np.array([[10.0, 10.0, 10.0], [0.0, 500.0, 1000.0], [5.0, 7.0, 6.0]])
    means = {"pam1.force": still, "pam2.force": rising, "pam3.force": noisy, "pam2.pressure": rising}
    noise = dict.fromkeys(means, 2.0)
    assert find_followers("pam1.force", np.array([0.0, 50.0, 100.0]), means, noise, SETTINGS) == ["pam2.force"]
    assert find_followers("pam1.command", np.array([50.0, 100.0, 150.0]), means, noise, SETTINGS) == ["pam2.pressure"]


def test_one_gauge_serves_a_sensor_and_its_regulator():
    turns = list_turns({"pam1.pressure": [0.0, 50.0, 50.0], "pam1.command": [50.0, 80.0], "pam2.command": [50.0]})
    assert [(turn.point, turn.channels, turn.value, turn.held) for turn in turns] == [
        (1, ("pam1.pressure",), 0.0, ""),
        (2, ("pam1.pressure", "pam1.command"), 50.0, "pam1"),
        (3, ("pam1.pressure",), 50.0, "pam1"),
        (4, ("pam1.command",), 80.0, "pam1"),
        (5, ("pam2.command",), 50.0, "pam2"),
    ]


def test_the_last_line_of_a_reading_counts():
    text = "point,kpa\n3,99.0\n3.2, 101.5\n3,98.5\n"
    assert find_reading(text, "3") == 98.5
    assert find_reading(text, "3.2") == 101.5
    assert find_reading(text, "4") is None
    for line in ("3,high", "3", "3,98,5", "3,nan", "3,1e6"):
        with pytest.raises(ValueError, match=r"expected 3,KPA with a pressure as the gauge shows it, got '3"):
            find_reading(text + line, "3")
