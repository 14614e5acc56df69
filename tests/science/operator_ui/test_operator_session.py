"""A study whose trials an operator decides on in the terminal, as a person types; stops between phases of a trial."""

import queue
import re
import shlex
import signal
import subprocess
import threading
from types import SimpleNamespace
from unittest.mock import patch

import pandas as pd
import pytest

from stages.science.operator_ui import ui
from stages.science.operator_ui.terminal import Terminal
from stages.science.rig import clock
from stages.science.rig.attendance import TrialDeclined
from tests.conftest import Command
from tests.science.operator_ui.attended import Study, make_session, make_trial, read, wait_until

SMALL = shlex.split("""
budget=tiny figures=[] bank.trajectories=5 subsampling.initial_trials=1 active_loop.trials=2 active_loop.controls=[]
task=bank stages=[bank,subsampling,hyperprior,task,hardware,active_loop]
operator_ui=terminal operator_ui.countdown_s=0.0 operator_ui.result_s=0.0
""")
FIRST = "p1 experiment 1 integrated_variance trial 1"
DECISIONS = {
    "bank 1": ["a", "r it slipped", "a", "k"],
    FIRST: ["s too fast", "a", "x the strap came off", "a in order", "k calm"],
}
PRESSED = "the participant pressed stop"
LONGEST_S = 120.0
"""After which an operator who is asked nothing leaves."""


class Operator:
    """Reads what the terminal prints and answers each question: by the trial's label, else with accept and keep.

    ``^C`` sends a signal, None ends the input, and a number is the time, s, after which Enter stops a running trial.
    """

    def __init__(self, answers=None):
        self.answers = {label: list(its) for label, its in (answers or {}).items()}
        self.printed, self.asked = [], []
        self.lines, self.label = queue.SimpleQueue(), None
        self.type, self.readline = self.lines.put, self.lines.get

    def attend(self, command, *more):
        """Sit at the terminal of a command in this process, until its input ends."""
        watchdog = threading.Timer(LONGEST_S, self.type, [""])
        watchdog.start()
        try:
            with patch.object(ui, "Terminal", self.sit_at):
                return command(*more)
        finally:
            watchdog.cancel()
            self.type("")

    def sit_at(self, session):
        self.session = session
        return Terminal(session, source=self, sink=self)

    def flush(self):
        pass

    def write(self, text):
        for line in text.splitlines():
            self.printed.append(line)
            named = re.match(r"trial \d+ of \d+: .*, [\d.]+ s \((.*)\)$", line)
            self.label = named[1] if named else self.label
            waiting = self.answers.get(self.label)
            if "= accept" in line or "= repeat" in line:
                self.answer(waiting.pop(0) if waiting else "a" if "= accept" in line else "k")
            elif line.startswith("running") and waiting and isinstance(waiting[0], float):
                clock.sleep(waiting.pop(0))
                self.type("\n")
                wait_until(lambda: self.session.see()["stop"])

    def answer(self, answer):
        self.asked.append((self.label, answer))
        if answer == "^C":
            signal.raise_signal(signal.SIGINT)
        else:
            self.type("" if answer is None else f"{answer}\n")


@pytest.fixture(scope="session")
def decided(make_once):
    """A command whose study somebody decided on, made once for all and not to be changed."""

    def decide(folder):
        operator = Operator(DECISIONS)
        result = operator.attend(Command(folder / "outputs", *SMALL))
        assert result.returncode == 0, result.stderr
        (folder / "printed.txt").write_text("\n".join(operator.printed))

    return Command(make_once("decided", decide) / "outputs", *SMALL)


def test_skipped_repeated_and_rejected_trials_lie_where_they_belong(decided):
    (run,) = decided.runs
    decisions = read(run, "decisions")
    assert decisions["decision"].tolist() == ["skip", "reject", "keep", "keep"]
    assert decisions["attempt"].tolist() == [1, 2, 3, 1]
    assert decisions["note"].tolist() == ["too fast", "the strap came off", "in order; calm", ""]
    assert decisions["trajectory"].iloc[:3].nunique() == 3
    trials, points = read(run, "trials"), read(run, "points")
    assert trials["trajectory"].tolist() == decisions["trajectory"].iloc[2:].tolist()
    rejected = decisions["trajectory"].iloc[1]
    assert rejected not in trials["trajectory"].tolist()
    assert sorted(read(run, "active_recordings")["trial"].unique()) == [1, 2]
    assert sorted(points["trial"].unique()) == [0, 1, 2]
    aside = {path.name: pd.read_parquet(path) for path in (run / "interrupted").iterdir()}
    assert set(aside) == {"bank~1~1.parquet", "active_loop~p1~1~integrated_variance~01~1.parquet"}
    assert aside["bank~1~1.parquet"]["stopped_by"].unique() == ["to be repeated, says the operator: it slipped"]
    told = aside["active_loop~p1~1~integrated_variance~01~1.parquet"]
    assert told["stopped_by"].unique() == ["rejected by the operator: the strap came off"]
    assert len(told) == len(read(run, "active_recordings")) / 2
    assert len(read(run, "bank")["trajectory"].unique()) == 5
    printed = (decided.outputs.parent / "printed.txt").read_text()
    told = re.findall(r"tells most(.*): utility integrated_variance", printed)
    assert told == ["", *[" of those not skipped or rejected"] * 3]


def test_a_study_that_is_stopped_and_continued_is_the_same_study(decided, tmp_path):
    broken = Command(tmp_path / "broken", *SMALL)
    for answers, code, told in (
        ({**DECISIONS, "bank 2": [None]}, 3, "next is bank 2 (the terminal's input had ended)"),
        ({"bank 3": ["^C"]}, 130, "stopped by Ctrl-C; to continue, type: "),
        ({"bank 4": ["q lunch"]}, 3, "bank paused: the operator stopped for today; next is bank 4 (lunch); to "),
        ({FIRST: [*DECISIONS[FIRST][:3], "q"]}, 3, "; to continue, type: "),
    ):
        left = Operator(answers).attend(broken)
        (line,) = left.stderr.splitlines()
        assert (left.returncode, told in line) == (code, True)
    last = Operator({FIRST: ["a in order", "k calm"]})
    result = last.attend(broken)
    assert result.returncode == 0, result.stderr
    assert [label for label, _ in last.asked] == [FIRST, FIRST, *[FIRST.replace("trial 1", "trial 2")] * 2]
    (run,), (reference,) = broken.runs, decided.runs
    for path in sorted((reference / "tables").glob("*.parquet")):
        assert (run / "tables" / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.slow
def test_ctrl_c_ends_a_process_that_waits_for_its_own_terminal(tmp_path):
    command = Command(tmp_path / "outputs", *SMALL)
    pipes, asked = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE), 0
    environment = {**command.environment, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command.line(), cwd=command.root, env=environment, text=True, **pipes) as process:
        watchdog = threading.Timer(LONGEST_S, process.kill)
        watchdog.start()
        for line in process.stdout:
            asked += "= accept" in line or "= repeat" in line
            if "= accept" in line and asked == 3:
                process.send_signal(signal.SIGINT)
            elif "= accept" in line or "= repeat" in line:
                print("a" if "= accept" in line else "k", file=process.stdin, flush=True)
        errors = process.stderr.read()
        watchdog.cancel()
    assert (process.returncode, asked, "stopped by Ctrl-C; to continue, type: " in errors) == (130, 3, True)


def test_movements_that_are_all_skipped_are_proposed_again_and_enough_are_kept(decided, tmp_path):
    command = decided.copy(tmp_path / "outputs")
    operator = Operator({FIRST: [*["s"] * 4, "a", "x no", "a", "x no", "a", "k"]})
    result = operator.attend(command, "stages=[active_loop]")
    assert result.returncode == 0, result.stderr
    run = command.runs[-1]
    decisions = read(run, "decisions")
    skipped = decisions.loc[decisions["decision"] == "skip", "trajectory"]
    assert sorted(skipped) == sorted(set(skipped))
    assert len(skipped) == 4
    assert decisions["decision"].tolist()[4:] == ["reject", "reject", "keep", "keep"]
    told = [line for line in operator.printed if "tells most" in line][:5]
    assert ["of those not skipped or rejected" in line for line in told] == [False, True, True, True, False]
    assert "no other is left that was not skipped or rejected" in told[3]
    offers = [line for line in operator.printed if "= repeat" in line]
    assert ["= reject" in line for line in offers[-4:]] == [True, True, False, False]
    assert len(read(run, "trials")) == 2


def test_a_terminal_tells_what_is_so_when_it_opens():
    operator = Operator()
    scene = {"number": 1, "phase": "running", "question": "", "stop": "", "choices": []}
    terminal = Terminal(SimpleNamespace(number=1, see=lambda: scene), operator, operator)
    terminal.open()
    wait_until(lambda: operator.printed == ["running; Enter stops it"])
    terminal.close()


def test_a_trial_in_real_time_is_the_same_and_can_be_stopped(turned, tmp_path):
    short = [*SMALL, "exoskeleton.trial_s=1.5", "bank.trajectories=3", "stages=[bank]"]
    still, real = Command(tmp_path / "still", *short), Command(tmp_path / "real", *short, "rig.realtime=true")
    impatient = Operator({"bank 1": ["a", 1.6, "r too early"]})  # after the second that fills the muscles
    for command, operator in ((still, Operator()), (real, impatient)):
        result = operator.attend(command)
        assert result.returncode == 0, result.stderr
        turned.sleep(0.1)  # the terminal's threads see that it was closed
    (run,), (reference,) = real.runs, still.runs
    assert (run / "tables" / "bank.parquet").read_bytes() == (reference / "tables" / "bank.parquet").read_bytes()
    (aside,) = (run / "interrupted").iterdir()
    (why,) = pd.read_parquet(aside)["stopped_by"].unique()
    then = "the operator pressed Enter; to be repeated, says the operator: too early"
    assert re.fullmatch(rf"stopped 0\.[56]\d s into the trial: {then}", why)
    assert "stopped" in "".join(impatient.printed)


@pytest.mark.parametrize("interface", [("operator_ui=terminal",), ()], ids=["terminal", "none"])
def test_a_pointer_needs_a_page_before_anything_is_recorded(pamid, interface):
    result = Operator().attend(pamid, "budget=tiny", "participant=mouse", *interface)
    assert result.returncode == 1
    (line,) = [each for each in result.stderr.splitlines() if "failed" in each]
    assert "points at postures" in line
    assert "set operator_ui=pages" in line
    assert not list(pamid.outputs.glob("runs/*/parts/*/*"))


def test_where_nothing_asks_an_operator_an_interface_is_refused_and_so_is_an_impossible_one(pamid):
    result = pamid("workflow=hidden_effect", "operator_ui=terminal")
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    told = "operator_ui: expected null, as workflow hidden_effect has no device that can be connected to it"
    assert line.startswith(told)
    result = pamid("operator_ui=pages", "operator_ui.port=70000")
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert result.stderr.startswith("operator_ui.port: input should be less than or equal to 65535, got 70000")
    assert not pamid.outputs.exists()


@pytest.fixture
def run(turned):
    """Run a study of one trial or more, and answer what each phase asks, or does, every hundredth of a second."""

    def run(session, trials=1, **answers):
        def attend():
            assert turned.now_s() < begun_s + 60.0, session.see()
            scene = session.see()
            answer = answers.get(scene["phase"])
            if answer and (scene["choices"] or scene["phase"] == "running"):
                word = answer if isinstance(answer, str) else answer(scene)
                if word:
                    session.decide(word, "", scene["question"])
            return 0.01

        begun_s = turned.now_s()
        turned.at(begun_s + 0.01, attend)
        study = Study(session, *(make_trial(session.machine) for _ in range(trials)))
        study.run()
        return study

    return run


@pytest.mark.parametrize("countdown_s", [0.0, 0.2])
def test_a_stop_right_after_the_decision_is_heard(run, countdown_s):
    session, scenes = make_session(countdown_s=countdown_s), []

    def answer(scene):
        scenes.append(scene)
        if len(scenes) > 1:
            return "pause"
        session.decide("accept", "", scene["question"])
        return session.stop(PRESSED)

    run(session, proposed=answer)
    assert scenes[1]["question"] > 1
    assert scenes[1]["outcome"] == {"stopped": f"stopped before it began: {PRESSED}"}
    assert scenes[1]["stop"] == ""


def test_a_note_that_is_no_text_is_written_out_and_loses_no_trial(run):
    session = make_session()

    def answer(scene):
        session.decide("pause", " f\udcfcr ", scene["question"])

    (paused,) = run(session, proposed=answer).ended
    assert str(paused).endswith("(f?r)")


@pytest.mark.parametrize(("after_s", "phase"), [(0.5, "proposed"), (0.65, "judging"), (0.8, "judging")])
def test_a_stop_of_trials_that_follow_by_themselves_is_heard(run, turned, after_s, phase):
    """It comes in the second one's countdown, while muscles are filled for it, or within it."""
    session, asked = make_session(trial_s=0.3, result_s=0.0, countdown_s=0.1), []

    def wait_and_leave(scene):
        asked.append((turned.now_s(), scene["phase"], len(scene["history"])))
        return "pause" if turned.now_s() > asked[0][0] + 1.0 else None

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
        return "repeat"

    session.go_on(True)
    assert isinstance(run(session, running=stop_and_go_on, judging=answer).ended[0], TrialDeclined)


def test_a_stop_while_a_result_is_judged_stops_no_trial_that_is_accepted_later(run):
    session = make_session(trial_s=0.3, countdown_s=0.0)
    study = run(session, 2, proposed="accept", judging=lambda scene: session.stop(PRESSED) or "keep")
    assert len(study.ended) == 2
    assert [each["decision"] for each in session.see()["history"]] == ["keep", "keep"]
