"""Sessions of machines whose static law is not the textbook's: what has no name gets none, what has one keeps it."""

from dataclasses import replace

import numpy as np
import pytest

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.scenarios import named_scenario
from tests.benchmark.test_verdicts import TRIALS, decide_on, judge_session
from tests.benchmark.test_verdicts import said_of as said_of


@pytest.mark.parametrize("seed", [100000, pytest.param(100001, marks=pytest.mark.slow)])
def test_a_law_that_is_not_the_nominal_one_gets_no_name(seed, said_of):
    said = said_of(f"foreign_building:none-{seed}")
    assert (said["status"], said["named"]) == ("unexplained", {})
    assert said["left"]["force_n"] == "static_map"


@pytest.mark.slow
def test_a_law_wrong_by_8_in_1000_with_gains_of_1_in_100_gets_no_name():
    made = simulate(replace(named_scenario("none-300"), trials=TRIALS))
    rows, rng = made.samples, np.random.default_rng(0)
    full, pressed = (rows.groupby("muscle")[name].transform("max") for name in ("force_n", "pressure_kpa"))
    bent = np.sin(5.0 * rows["pressure_kpa"] / pressed + 20.0 * rows["contraction"] + rng.uniform(0.0, 6.0))
    trial = rows.groupby(["trial", "muscle"]).ngroup()
    gain = 1.0 + 0.01 * rng.standard_normal(trial.max() + 1)[trial]
    measured = gain * (rows["force_n"] + 0.008 * np.sqrt(2.0) * full * bent)
    said = judge_session(replace(made, samples=rows.assign(force_n=measured)), TRIALS).decision
    assert (said.status, said.effects) == ("unexplained", [])


@pytest.mark.slow
@pytest.mark.parametrize("session", ["eccentric_pulley-medium-100248", "valve_current-strong-100265"])
def test_what_the_library_does_not_hold_gets_no_name(session):
    said = decide_on(f"foreign_building:{session}")
    assert (said.status, said.effects) == ("unexplained", [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("session", "trials", "name", "channel"),
    [
        ("force_late-strong-100169", TRIALS, "channel_misalignment", "force_n"),
        ("duhem-strong-100241", TRIALS, "hysteresis", "force_n"),
        ("transport_delay-strong-100160", TRIALS, "transport_delay", "pressure_kpa"),
        ("pressure_late-strong-100179", TRIALS, "channel_misalignment", "pressure_kpa"),
        ("angle_late-strong-100183", 16, "channel_misalignment", "force_n"),
        ("slack_opening-strong-100126", TRIALS, "cable_slack", "force_n"),
    ],
)
def test_what_is_there_beside_a_wrong_law_is_named(session, trials, name, channel, said_of):
    said = said_of(f"foreign_building:{session}", trials)
    assert next(iter(said["seen_in"].items())) == (name, channel)
    assert said["named"][name] > 0.8


@pytest.mark.slow
def test_a_pressure_sensor_is_a_candidate_beside_a_static_effect_of_the_force():
    made = simulate(replace(named_scenario("pressure_dead_band+valve_asymmetry-strong-4007"), trials=14))
    first = replace(made, samples=made.samples[made.samples["trial"] < TRIALS])
    said = judge_session(first, TRIALS).decision
    assert {each.name for each in said.effects} == {"pressure_dead_band", "valve_asymmetry"}
