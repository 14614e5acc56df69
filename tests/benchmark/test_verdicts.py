"""Figures in docs were counted by the search as it is: it still says the same of twelve short sessions.

`python -m tests.benchmark.test_verdicts` stores anew what it says, beside this file.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.scenarios import named_scenario
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.settings import choose_verification
from stages.science.recording.datasets import tabulate_session
from stages.science.scorecard.judgement import judge
from tests.science.discrepancy.searches import DISCREPANCY

STORED = Path(__file__).with_name("verdicts.yaml")
SCORECARD = Path(__file__).resolve().parents[2] / "docs" / "scorecard.md"
OUTDATED = "**Outdated"
ABOUT = 0.1
TRIALS = 10


def judge_session(recorded, trials):
    """Return what is found in a session of the blinded rig."""
    outputs = build_muscle_channels(tabulate_session(recorded.samples, recorded.meta, ""), DISCREPANCY)
    test = choose_verification(trials, DISCREPANCY.verification_share)
    return judge(outputs, test, DISCREPANCY, lambda *purpose: np.random.default_rng(len(purpose)))


def decide_on(name, trials=16):
    """Return what is said of a named session."""
    return judge_session(simulate(replace(named_scenario(name), trials=trials)), trials).decision


def describe(name):
    """Return what is said of a short session: status, names with probabilities, and what is left by channel."""
    said = decide_on(name, TRIALS)
    return {
        "status": said.status,
        "named": {each.name: round(float(each.probability), 2) for each in said.effects},
        "left": {channel: each.family for channel, each in said.remainders.items() if each.unknown > 0.5},
    }


def is_same(said, stored):
    """Return whether two sessions differ in no more than by `ABOUT` in a probability."""
    now, then = said["named"], stored["named"]
    alike = {**said, "named": list(now)} == {**stored, "named": list(then)}
    return alike and all(abs(now[each] - then[each]) < ABOUT for each in then)


@pytest.mark.slow
def test_the_figures_in_docs_are_those_of_this_search_or_are_marked_outdated():
    stored = yaml.safe_load(STORED.read_text())
    assert len(stored) == 12
    found = {name: describe(name) for name in stored}
    told = [f"{name}: {stored[name]} became {said}" for name, said in found.items() if not is_same(said, stored[name])]
    if told and OUTDATED not in SCORECARD.read_text():
        pytest.fail(
            "\n".join(["verdicts changed:", *told, "Run workflow=scorecard anew, put its figures into"])
            + " docs/scorecard.md, and run python -m tests.benchmark.test_verdicts; until then write "
            f"{OUTDATED}** above the figures."
        )


def test_a_change_of_a_name_is_a_difference_and_a_small_change_of_its_probability_is_none():
    stored = {"status": "named", "named": {"creep": 0.9}, "left": {}}
    assert is_same(stored | {"named": {"creep": 0.85}}, stored)
    for other in ({"named": {"creep": 0.7}}, {"named": {"hysteresis": 0.9}}, {"status": "unexplained"}):
        assert not is_same(stored | other, stored)


if __name__ == "__main__":
    names = yaml.safe_load(STORED.read_text())
    STORED.write_text(yaml.safe_dump({name: describe(name) for name in names}, sort_keys=False))
