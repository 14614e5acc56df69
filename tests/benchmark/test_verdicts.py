"""Figures in docs were counted by the search as it is: it still says the same of twelve short sessions."""

from pathlib import Path

import pytest
import yaml

from tests.benchmark.verdicts import SESSIONS, STORED, TRIALS, decide_on, describe

SCORECARD = Path(__file__).resolve().parents[2] / "docs" / "scorecard.md"
OUTDATED = "**Outdated"
ABOUT = 0.1


def find_difference(name, said, stored):
    """Return what differs in a session, in a line; nothing where a probability moves by less than `ABOUT`."""
    kinds = ({**each, "named": list(each["named"])} for each in (said, stored))
    if next(kinds) == next(kinds) and all(abs(said["named"][each] - p) < ABOUT for each, p in stored["named"].items()):
        return []
    return [f"{name}: {stored} became {said}"]


@pytest.mark.slow
def test_the_figures_in_docs_are_those_of_this_search_or_are_marked_outdated():
    stored = yaml.safe_load(STORED.read_text())
    assert list(stored) == list(SESSIONS)
    found = [find_difference(name, describe(decide_on(name, TRIALS)), stored[name]) for name in SESSIONS]
    told = "\n".join(line for lines in found for line in lines)
    if told and OUTDATED not in SCORECARD.read_text():
        pytest.fail(
            f"verdicts changed:\n{told}\nRun workflow=scorecard anew, put its figures into docs/scorecard.md, and run "
            f"python -m tests.benchmark.verdicts; until then write {OUTDATED}** above the figures."
        )


def test_a_change_of_a_name_is_a_difference_and_a_small_change_of_its_probability_is_none():
    stored = {"status": "named", "named": {"creep": 0.9}, "left": {}}
    assert not find_difference("s", stored | {"named": {"creep": 0.85}}, stored)
    for other in ({"named": {"creep": 0.7}}, {"named": {"hysteresis": 0.9}}, {"status": "unexplained"}):
        assert find_difference("s", stored | other, stored)
