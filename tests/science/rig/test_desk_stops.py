"""A stop that comes between two phases of a trial is not lost."""

import pytest

from stages.science.rig.attendance import TrialDeclined
from tests.science.rig.attended import Study, make_desk, make_trial

PRESSED = "the participant pressed stop"


@pytest.fixture
def run(turned):
    """Run a study here; what answers it is called every hundredth of a second, by phase, once something is asked."""

    def run(desk, trials, **answers):
        def attend():
            assert turned.now_s() < begun_s + 60.0, desk.see()
            scene = desk.see()
            if scene["phase"] in answers and (scene["choices"] or scene["phase"] == "running"):
                answers[scene["phase"]](scene)
            return 0.01

        begun_s = turned.now_s()
        turned.at(begun_s + 0.01, attend)
        study = Study(desk, *(make_trial(desk.machine) for _ in range(trials)))
        study.run()
        return study

    return run


@pytest.mark.parametrize("countdown_s", [0.0, 0.2])
def test_a_stop_right_after_the_decision_is_heard(run, countdown_s):
    desk = make_desk(countdown_s=countdown_s)
    scenes = []

    def answer(scene):
        scenes.append(scene)
        if len(scenes) == 1:
            desk.decide("accept", "", scene["question"])
            desk.stop(PRESSED)
        else:
            desk.decide("pause", "", scene["question"])

    run(desk, 1, proposed=answer)
    assert scenes[1]["question"] > 1
    assert scenes[1]["outcome"] == {"stopped": f"stopped before it began: {PRESSED}"}
    assert scenes[1]["stop"] == ""


@pytest.mark.parametrize(("after_s", "phase"), [(0.5, "proposed"), (0.65, "judging"), (0.8, "judging")])
def test_a_stop_of_trials_that_follow_by_themselves_is_heard(run, turned, after_s, phase):
    """It comes in the second one's countdown, while muscles are filled for it, or within it."""
    desk = make_desk(trial_s=0.3, result_s=0.0, countdown_s=0.1)
    asked = []

    def wait_and_leave(scene):
        asked.append((turned.now_s(), scene["phase"], len(scene["history"])))
        if turned.now_s() > asked[0][0] + 1.0:
            desk.decide("pause", "", scene["question"])

    desk.go_on(True)
    turned.after(after_s, lambda: desk.stop(PRESSED))
    study = run(desk, 50, proposed=wait_and_leave, judging=wait_and_leave)
    assert {each[1:] for each in asked} == {(phase, 1)}
    assert len(study.ended) == 2


def test_a_stop_while_a_trial_runs_outlives_the_wish_to_go_on(run):
    desk = make_desk(trial_s=3.0, countdown_s=0.0)

    def stop_and_go_on(scene):
        desk.stop(PRESSED)
        desk.go_on(True)

    def answer(scene):
        assert PRESSED in scene["outcome"]["stopped"]
        desk.decide("repeat", "", scene["question"])

    desk.go_on(True)
    study = run(desk, 1, running=stop_and_go_on, judging=answer)
    assert isinstance(study.ended[0], TrialDeclined)


def test_a_stop_while_a_result_is_judged_stops_no_trial_that_is_accepted_later(run):
    desk = make_desk(trial_s=0.3, countdown_s=0.0)

    def stop_and_keep(scene):
        desk.stop(PRESSED)
        desk.decide("keep", "", scene["question"])

    study = run(
        desk,
        2,
        proposed=lambda scene: desk.decide("accept", "", scene["question"]),
        judging=stop_and_keep,
    )
    assert len(study.ended) == 2
    assert [each["decision"] for each in desk.see()["history"]] == ["keep", "keep"]
