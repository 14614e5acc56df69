"""Figures in docs were counted by the search as it is: it still says the same of twelve short sessions.

`python -m tests.benchmark.test_verdicts` stores anew what it says, beside this file.
"""

import tempfile
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
from tests.benchmark.small_scorecard import SESSIONS, describe_scored, score
from tests.benchmark.small_scorecard import scored as scored
from tests.science.discrepancy.searches import DISCREPANCY

STORED = Path(__file__).with_name("verdicts.yaml")
NAMES = list(yaml.safe_load(STORED.read_text()))
SCORECARD = Path(__file__).resolve().parents[2] / "docs" / "scorecard.md"
OUTDATED = "**Outdated"
ABOUT = 0.1
TRIALS = 10


def judge_session(recorded, trials):
    """Return what is found in a session of the blinded rig."""
    outputs = build_muscle_channels(tabulate_session(recorded.samples, recorded.meta, ""), DISCREPANCY)
    test = choose_verification(trials, DISCREPANCY.verification_share)
    return judge(outputs, test, DISCREPANCY, lambda *purpose: np.random.default_rng(len(purpose)))


def decide_on(name, trials=TRIALS):
    """Return what is said of a named session."""
    return judge_session(simulate(replace(named_scenario(name), trials=trials)), trials).decision


def describe(name, trials=TRIALS):
    """Return what is said of a session: status, names with probabilities and channels, what is left by channel."""
    said = decide_on(name, trials)
    return {
        "status": said.status,
        "named": {each.name: round(float(each.probability), 4) for each in said.effects},
        "seen_in": {each.name: each.channel for each in said.effects},
        "left": {channel: each.family for channel, each in said.remainders.items() if each.unknown > 0.5},
    }


@pytest.fixture(scope="session")
def said_of(make_once):
    """Return ``said_of(name, trials)``: what is said of a short session, which is searched once for all tests."""

    def describe_once(name, trials=TRIALS):
        def write(folder):
            (folder / "said.yaml").write_text(yaml.safe_dump(describe(name, trials), sort_keys=False))

        place = make_once(f"session {name} of {trials}", write)
        return yaml.safe_load((place / "said.yaml").read_text())

    return describe_once


def is_same(said, stored):
    """Return whether two sessions differ in no more than by `ABOUT` in a probability."""
    now, then = said["named"], stored["named"]
    alike = [list(now), said["status"], said["left"]] == [list(then), stored["status"], stored["left"]]
    return alike and all(abs(now[each] - then[each]) < ABOUT for each in then)


def look_at(name, request):
    """Return what is said of a session: of those of the small scorecard, what stands there."""
    if name in SESSIONS:
        return describe_scored(request.getfixturevalue("scored"), name)
    return request.getfixturevalue("said_of")(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_figures_in_docs_are_those_of_this_search_or_are_marked_outdated(name, request):
    if OUTDATED in SCORECARD.read_text():
        pytest.skip("docs/scorecard.md is marked outdated, whatever the search says now")
    said, stored = look_at(name, request), yaml.safe_load(STORED.read_text())[name]
    assert is_same(said, stored), (
        f"{name}: {stored} became {said}. Run workflow=scorecard anew, put its figures into docs/scorecard.md, and run "
        f"python -m tests.benchmark.test_verdicts; until then write {OUTDATED}** above the figures."
    )


def test_a_change_of_a_name_is_a_difference_and_a_small_change_of_its_probability_is_none():
    stored = {"status": "named", "named": {"creep": 0.9}, "left": {}}
    assert is_same(stored | {"named": {"creep": 0.85}}, stored)
    for other in ({"named": {"creep": 0.7}}, {"named": {"hysteresis": 0.9}}, {"status": "unexplained"}):
        assert not is_same(stored | other, stored)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        tables = score(Path(made))
    found = {name: describe_scored(tables, name) if name in SESSIONS else describe(name) for name in NAMES}
    STORED.write_text(yaml.safe_dump(found, sort_keys=False))
