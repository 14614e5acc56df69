"""A stop that comes between two phases of a trial is not lost."""

import pytest

from stages.science.rig.attendance import TrialDeclined
from tests.science.operator_ui.attended import Study, make_session, make_trial

PRESSED = "the participant pressed stop"


@pytest.fixture
def run(turned):
    """Run a study here; what answers it is called every hundredth of a second, by phase, once something is asked."""

    def run(session, trials, **answers):
        def attend():
            assert turned.now_s() < begun_s + 60.0, session.see()
            scene = session.see()
            if scene["phase"] in answers and (scene["choices"] or scene["phase"] == "running"):
                answers[scene["phase"]](scene)
            return 0.01

        begun_s = turned.now_s()
        turned.at(begun_s + 0.01, attend)
        study = Study(session, *(make_trial(session.machine) for _ in range(trials)))
        study.run()
        return study

    return run


@pytest.mark.parametrize("countdown_s", [0.0, 0.2])
def test_a_stop_right_after_the_decision_is_heard(run, countdown_s):
    session = make_session(countdown_s=countdown_s)
    scenes = []

    def answer(scene):
        scenes.append(scene)
        if len(scenes) == 1:
            session.decide("accept", "", scene["question"])
            session.stop(PRESSED)
        else:
            session.decide("pause", "", scene["question"])

    run(session, 1, proposed=answer)
    assert scenes[1]["question"] > 1
    assert scenes[1]["outcome"] == {"stopped": f"stopped before it began: {PRESSED}"}
    assert scenes[1]["stop"] == ""


@pytest.mark.parametrize(("after_s", "phase"), [(0.5, "proposed"), (0.65, "judging"), (0.8, "judging")])
def test_a_stop_of_trials_that_follow_by_themselves_is_heard(run, turned, after_s, phase):
    """It comes in the second one's countdown, while muscles are filled for it, or within it."""
    session = make_session(trial_s=0.3, result_s=0.0, countdown_s=0.1)
    asked = []

    def wait_and_leave(scene):
        asked.append((turned.now_s(), scene["phase"], len(scene["history"])))
        if turned.now_s() > asked[0][0] + 1.0:
            session.decide("pause", "", scene["question"])

    session.go_on(True)
    turned.after(after_s, lambda: session.stop(PRESSED))
    study = run(session, 50, proposed=wait_and_leave, judging=wait_and_leave)
    assert {each[1:] for each in asked} == {(phase, 1)}
    assert len(study.ended) == 2


def test_a_stop_while_a_trial_runs_outlives_the_wish_to_go_on(run):
    session = make_session(trial_s=3.0, countdown_s=0.0)

    def stop_and_go_on(scene):
        session.stop(PRESSED)
        session.go_on(True)

    def answer(scene):
        assert PRESSED in scene["outcome"]["stopped"]
        session.decide("repeat", "", scene["question"])

    session.go_on(True)
    study = run(session, 1, running=stop_and_go_on, judging=answer)
    assert isinstance(study.ended[0], TrialDeclined)


def test_a_stop_while_a_result_is_judged_stops_no_trial_that_is_accepted_later(run):
    session = make_session(trial_s=0.3, countdown_s=0.0)

    def stop_and_keep(scene):
        session.stop(PRESSED)
        session.decide("keep", "", scene["question"])

    study = run(
        session, 2, proposed=lambda scene: session.decide("accept", "", scene["question"]), judging=stop_and_keep
    )
    assert len(study.ended) == 2
    assert [each["decision"] for each in session.see()["history"]] == ["keep", "keep"]
