"""A stop that comes between two phases of a trial is not lost."""

import time

import pytest

from stages.rig.attendance import TrialDeclined
from tests.rig.attended import Study, make_desk, make_trial, wait_until

pytestmark = pytest.mark.realtime


def reach(desk, phase):
    return wait_until(lambda: (scene := desk.see())["phase"] == phase and scene)


@pytest.mark.parametrize("countdown_s", [0.0, 0.2])
def test_a_stop_right_after_the_decision_is_heard(countdown_s):
    desk = make_desk(countdown_s=countdown_s)
    Study(desk, make_trial(desk.machine)).start()
    desk.decide("accept", "", reach(desk, "proposed")["question"])
    desk.stop("the participant pressed stop")
    scene = wait_until(lambda: (seen := desk.see())["question"] > 1 and seen)
    assert scene["phase"] == "proposed"
    assert scene["outcome"] == {"stopped": "stopped before it began: the participant pressed stop"}
    assert scene["stop"] == ""


def test_a_stop_between_trials_that_follow_by_themselves_is_heard():
    desk = make_desk(trial_s=0.3, result_s=0.0, countdown_s=0.1)
    study = Study(desk, *(make_trial(desk.machine) for _ in range(50)))
    desk.go_on(True)
    study.start()
    wait_until(lambda: study.ended)
    desk.stop("the operator pressed stop")
    time.sleep(0.5)
    ended = len(study.ended)
    scene = desk.see()
    assert scene["phase"] in ("proposed", "judging")
    time.sleep(0.5)
    assert len(study.ended) == ended


def test_a_stop_while_a_trial_runs_outlives_the_wish_to_go_on():
    desk = make_desk(trial_s=3.0, countdown_s=0.0)
    study = Study(desk, make_trial(desk.machine))
    desk.go_on(True)
    study.start()
    reach(desk, "running")
    desk.stop("the participant pressed stop")
    desk.go_on(True)
    scene = reach(desk, "judging")
    assert "the participant pressed stop" in scene["outcome"]["stopped"]
    desk.decide("repeat", "", wait_until(lambda: (seen := desk.see())["choices"] and seen)["question"])
    assert isinstance(wait_until(lambda: study.ended)[0], TrialDeclined)


def test_a_stop_while_a_result_is_judged_stops_no_trial_that_is_accepted_later():
    desk = make_desk(trial_s=0.3, countdown_s=0.0)
    study = Study(desk, make_trial(desk.machine), make_trial(desk.machine))
    study.start()
    for _ in range(2):
        desk.decide("accept", "", reach(desk, "proposed")["question"])
        scene = wait_until(lambda: (seen := desk.see())["phase"] == "judging" and seen["choices"] and seen)
        desk.stop("the operator pressed stop")
        desk.decide("keep", "", scene["question"])
        wait_until(lambda: desk.see()["phase"] in ("proposed", "busy"))
    wait_until(lambda: len(study.ended) == 2)
    assert [each["decision"] for each in desk.see()["history"]] == ["keep", "keep"]
