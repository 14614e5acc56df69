"""The verdict's sentences say what its numbers say, and no more."""

import numpy as np
import pandas as pd
import pytest

from stages.science.discrepancy.report_text import (
    describe_blocks,
    describe_bounds,
    describe_few_trials,
    describe_high_floor,
    describe_scales,
    describe_times,
    describe_together,
    describe_unsettled,
    describe_verdict,
)
from stages.science.discrepancy.verdict import summarise_remainder
from stages.science.discrepancy.verification import find_unsettled
from tests.science.discrepancy.searches import DISCREPANCY
from tests.science.plant.machines import configured, read_plant

GAP = {
    "before": 0.081,
    "after": 0.021,
    "noise_floor": 0.02,
    "low": 0.019,
    "high": 0.023,
    "p_value": 0.031,
    "channels": ["force_n"],
    "over_floor": {"value": 1.02, "low": 1.0, "high": 1.05, "smallest": 1.15},
}
EFFECT = {
    "name": "hysteresis",
    "form": "maxwell_slip",
    "channel": "force",
    "muscles": ["pam1", "pam3"],
    "probability": 0.93,
    "reproduced": True,
    "step": {"before": 0.081, "after": 0.021, "p_value": 0.016},
    "indistinguishable_from": [],
    "by_muscle": {},
}
GONE = {**EFFECT, "reproduced": False, "step": {"before": 0.034, "after": 0.033, "p_value": 0.43}}
ELSEWHERE = {**EFFECT, "channel": "pressure"}
LEAKAGE = {"name": "leakage", "channel": "pressure", "muscles": ["pam2"], "probability": 0.4, "p_value": 0.03}
CANDIDATES = (("hysteresis", 0.93, 0.021), ("coulomb_friction", 0.05, 0.05), ("none", 0.02, 0.081))
RESOLVED = {"status": "none", "share": 0.1, "family": None, "line_hz": None, "imitated": 0.0, "learned_maps": []}
DOUBTED = {**RESOLVED, "imitated": 0.6, "share": 0.08}
LEFT_OVER = {**RESOLVED, "status": "unexplained", "share": 0.4}
NAMED = {
    "status": "named",
    "missing_probability": 0.97,
    "effects": [EFFECT],
    "suspected": [],
    "ranking": [{"name": n, "probability": p, "heldout_gap": gap, "absorbed": False} for n, p, gap in CANDIDATES],
    "gap": GAP,
    "remainder": RESOLVED,
    "verification_trials": [2, 5, 8],
}
IMITATOR = {"name": "memory", "probability": 0.07, "heldout_gap": 0.02, "absorbed": False}
LARGE = {**GAP, "over_floor": {**GAP["over_floor"], "value": 4.0}}
UNEXPLAINED = {**NAMED, "status": "unexplained", "effects": [], "gap": LARGE, "remainder": LEFT_OVER}
CLEAN = {**NAMED, "status": "no_discrepancy", "missing_probability": 0.2, "effects": []}
DEEP = {**GAP, "noise_floor": 0.09}
CLOSED = "hysteresis on pam1 and pam3 (probability 0.93; next is coulomb friction, 0.05)"
STAYS = "Trials not fitted do not show it: with it the gap there goes from 3.4 % to 3.3 % of range (one-sided p = 0.43)"
SO_MUCH = "So much remains: a flexible model would still take away 40 % of what was above the noise"
LITTLE = "Something remains: a flexible model predicts trials left out better, by less than 2.0 % of what"
LEFT = "a flexible model takes away 40 % of what is above the noise"
NEAREST = "hysteresis comes nearest (probability 0.93): with it the gap of trials left out of the fit goes from 8.1 %"
BLIND = "cannot be told: the gap is 1.02 times the noise floor, but so much counts as noise"
SUSPECTED = "Suspected, and not added to the plant: leakage on pam2 (probability 0.40; p = 0.03 that"
IMITATION = "On trials left out of the fits 8.0 % of the gap above the noise is left, more than forms of one effect"
MANY = "So many names in one channel may stand in for one effect"


@pytest.mark.parametrize(
    ("verdict", "said", "unsaid"),
    [
        (
            NAMED,
            [
                CLOSED,
                "the gap of force on 3 trials not fitted goes from 8.1 % to 2.1 %",
                "p = 0.031",
                "1.05 times the noise floor (2.0 %)",
            ],
            ["remains"],
        ),
        ({**NAMED, "ranking": [*NAMED["ranking"], IMITATOR]}, ["0.93; next is a memory without a name, 0.07)"], []),
        ({**NAMED, "effects": [EFFECT, GONE]}, [STAYS], []),
        ({**NAMED, "remainder": LEFT_OVER}, [CLOSED, SO_MUCH], []),
        ({**NAMED, "remainder": {**LEFT_OVER, "share": 0.004}}, [LITTLE], ["0.40 %"]),
        (
            {**NAMED, "remainder": {**LEFT_OVER, "line_hz": 10.3}},
            [SO_MUCH, "an oscillation at 10.3 Hz runs through"],
            [],
        ),
        (
            {**NAMED, "remainder": LEFT_OVER, "gap": DEEP},
            ["On trials left out of the fits something remains"],
            [SO_MUCH],
        ),
        ({**NAMED, "suspected": [LEAKAGE]}, [SUSPECTED], []),
        (
            {**NAMED, "remainder": {**LEFT_OVER, "imitated": 0.6}, "suspected": [{**LEAKAGE, "probability": 0.5}]},
            ["it may be what is suspected below", "may stand in for what is suspected below"],
            ["the library"],
        ),
        ({**NAMED, "remainder": DOUBTED}, [IMITATION], []),
        ({**NAMED, "remainder": {**DOUBTED, "imitated": 0.4}}, [], [IMITATION]),
        ({**NAMED, "remainder": DOUBTED, "effects": [EFFECT] * 3}, [MANY], []),
        ({**NAMED, "remainder": DOUBTED, "effects": [EFFECT, EFFECT, ELSEWHERE]}, [], [MANY]),
        ({**NAMED, "gap": DEEP}, ["that is not above the noise floor (9.0 %): no gap is resolved"], ["times"]),
        (UNEXPLAINED, [LEFT, "(probability 0.97)", NEAREST], []),
        ({**UNEXPLAINED, "missing_probability": 0.2, "remainder": RESOLVED, "gap": GAP}, [BLIND], ["takes away"]),
        ({**UNEXPLAINED, "remainder": {**LEFT_OVER, "family": "memory"}}, ["a memory of the inputs (such as"], []),
        (
            {**UNEXPLAINED, "remainder": {**LEFT_OVER, "line_hz": 49.94}},
            ["an oscillation at 49.9 Hz runs through all trials"],
            ["flexible model"],
        ),
        (
            CLEAN,
            ["with probability 0.80: on", "in its worst channel it is at most 1.05 times the floor"],
            ["Suspected"],
        ),
    ],
)
def test_a_verdict_says_what_its_numbers_say(verdict, said, unsaid):
    text = " ".join(describe_verdict(verdict, [], DISCREPANCY))
    assert [words for words in said if words not in text] == []
    assert [words for words in unsaid if words in text] == []


@pytest.mark.parametrize(("memory", "told"), [(0.003, True), (0.02, False)])
def test_an_effect_that_alone_leaves_more_than_a_memory_is_told_with_the_next(memory, told):
    gaps = [(1, "transport_delay", 0.004), (1, "memory", memory), (2, "hysteresis", 0.001), (3, "none", 0.001)]
    ranking = pd.DataFrame(gaps, columns=["round", "name", "heldout_gap"])
    named = pd.DataFrame({"round": [1, 1, 2], "name": ["transport_delay", "transport_delay", "hysteresis"]})
    said = " ".join(describe_together(ranking, named))
    for part in (
        "Alone, transport delay leaves 0.40 %",
        "a memory of the inputs less",
        "with hysteresis it leaves 0.10 %",
    ):
        assert (part in said) is told


def test_a_channel_is_off_by_a_size_in_its_unit_once():
    place = {"channel": "speed_rad_per_s", "muscle": "motor", "unit": "rad/s", "largest": 64.2}
    place |= {"regime": "low speed", "share_of_gap": 0.5, "share_of_time": 0.5}
    *_, where = describe_verdict(UNEXPLAINED, [place], DISCREPANCY)
    assert where.startswith("motor: nominal speed is off by up to 64 rad/s, in no regime")


def test_trials_that_are_blocks_of_few_records_are_told_and_records_that_are_trials_are_not():
    assert "16 blocks of one record, which share" in describe_blocks(["given"] * 16)[0]
    assert "4 blocks of 3 records, which share within each" in describe_blocks(["a", "a", "b", "b", "c"])[0]
    assert describe_blocks(list("abcdef")) == []
    assert describe_blocks([""] * 8) == []


def test_few_trials_are_told():
    assert [len(describe_few_trials(fitted, 1, 6)) for fitted in (2, 5, 6)] == [1, 1, 0]


def test_trials_that_begin_under_another_pressure_are_told():
    time_s = np.arange(200) * 0.01
    late = {1: 40.0 * np.exp(-time_s / 0.1), 2: 0.0, 3: 80.0 * np.exp(-time_s / 0.1), 4: 30.0 + 0.0 * time_s}
    noise = np.random.default_rng(1).standard_normal(200)
    rows = [
        pd.DataFrame({"trial": trial, "muscle": "pam1", "channel": channel, "measured": off + noise, "after": 0.0})
        for trial, off in late.items()
        for channel in ("pressure_kpa", "force_n")
    ]
    found = find_unsettled(pd.concat(rows), 8.0, 5.0)
    assert found == {1: pytest.approx(40.0, abs=4.0), 3: pytest.approx(80.0, abs=4.0)}
    assert describe_unsettled(found, 4)[0].startswith(
        "Of 4 trials 2 begin up to 80 kPa off the pressure that the first"
    )
    assert describe_unsettled({}, 4) == []


def test_scales_are_told_in_units():
    (told,) = describe_scales(read_plant(along_scale=0.02, output_scale=150.0, time_scale_s=0.5))
    assert told.endswith("a scale of force is 150 N, a scale of position is 0.02 m and a pace is 0.5 s.")
    assert describe_scales(read_plant()) == []
    assert describe_scales(configured().plant) == []


def test_times_are_told_in_seconds():
    late = {"name": "transport_delay", "form": "late_input", "parameters": {"periods": {"value": 0.08}}}
    slow = {"name": "creep", "form": "element", "parameters": {"share": {"value": 0.1}, "paces": {"value": 3.0}}}
    (told,) = describe_times([late, slow], read_plant(time_scale_s=0.5))
    assert told == (
        "In seconds, transport delay: how late the input acts, 0.251 s; creep: time in which it yields, 1.5 s."
    )
    assert describe_times([EFFECT], read_plant(time_scale_s=0.5)) == []
    assert describe_times([late], configured().plant) == []


def test_a_floor_far_above_the_sensor_s_noise_is_told_with_its_place():
    channels = pd.DataFrame({"channel": "force_n", "muscle": ["pam1", "pam2"], "noise_floor": [9.0, 2.0], "white": 1.0})
    (sentence,) = describe_high_floor(channels, 3.0)
    assert "(force of pam1)" in sentence
    assert "pam2" not in sentence
    assert describe_high_floor(channels.assign(noise_floor=2.0), 3.0) == []


def test_the_remainder_is_that_of_the_channel_in_which_it_is_most_probable():
    table = pd.DataFrame({"channel": ["x", "y"], "share": [-0.2, 0.9], "probability": [0.1, 1.0]})
    table = table.assign(family=["", "memory"], line_hz=[13.0, np.nan], imitated=[0.3, 0.0])
    left = summarise_remainder(table, pd.DataFrame({"inputs": []}), [], 0.5)
    told = {"status": "unexplained", "family": "memory", "share": 0.9, "probability": 1.0, "channel": "y"}
    assert left == {**told, "line_hz": None, "imitated": 0.3, "patch": None, "learned_maps": [], "depends_on": []}
    faint = summarise_remainder(table.iloc[:1], pd.DataFrame({"inputs": []}), [], 0.5)
    assert (faint["status"], faint["share"], faint["line_hz"]) == ("none", 0.0, 13.0)


def test_values_at_a_bound_are_told_once_for_all_muscles():
    rows = [("", "mass_kg", 5.0, "high"), *[("coulomb_friction", "level", 0.0, "low")] * 2]
    values = pd.DataFrame(rows, columns=["effect", "parameter", "value", "at_bound"])
    (sentence,) = describe_bounds(values)
    assert sentence.endswith("stand mass_kg (5, high) and level of coulomb friction (0, low).")
    assert describe_bounds(values.assign(at_bound="")) == []
