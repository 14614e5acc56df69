"""A study whose trials an operator decides on in the terminal, as a person types."""

import contextlib
import os
import re
import signal
import subprocess
import threading
import time

import pandas as pd
import pytest

from tests.conftest import Command

SMALL = [
    "budget=tiny",
    "bank.trajectories=5",
    "subsampling.initial_trials=1",
    "active_loop.trials=2",
    "active_loop.controls=[]",
    "stages=[bank,subsampling,hyperprior,hardware,active_loop]",
    "desk=terminal",
    "desk.countdown_s=0.0",
    "desk.result_s=0.0",
]

SHORT = ["exoskeleton.trial_s=1.5", "bank.trajectories=3", "stages=[bank]"]


class Operator:
    """Reads what the command prints and answers each question: by the trial's label, else with accept and keep."""

    def __init__(self, command, answers=None, extra=()):
        self.answers = {label: list(its) for label, its in (answers or {}).items()}
        self.printed, self.asked = [], []
        self.process = subprocess.Popen(
            command.line(*extra),
            cwd=command.root,
            env={**command.environment, "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.errors = []
        self.hearing = threading.Thread(target=lambda: self.errors.extend(self.process.stderr), daemon=True)
        self.hearing.start()

    def type(self, line):
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def attend(self):
        watchdog = threading.Timer(120, self.process.kill)
        watchdog.start()
        try:
            self.answer()
            code = self.process.wait()
        finally:
            watchdog.cancel()
            self.process.kill()
            self.hearing.join()
            for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        return code

    def watch(self, line):
        """See a line before it is answered."""

    def answer(self):
        label = None
        for line in self.process.stdout:
            self.watch(line)
            self.printed.append(line)
            named = re.match(r"\d+ of \d+: (.*) \(.*, [\d.]+ s\)$", line)
            label = named[1] if named else label
            if "= accept" in line or "= repeat" in line:
                usual = "a" if "= accept" in line else "k"
                waiting = self.answers.get(label)
                answer = waiting.pop(0) if waiting else usual
                self.asked.append((label, answer))
                if answer is None:
                    self.process.stdin.close()
                elif callable(answer):
                    answer(self.process)
                else:
                    self.type(answer)


@pytest.fixture
def command(tmp_path):
    return Command(tmp_path / "outputs", *SMALL)


def read(run, table):
    return pd.read_parquet(run / "tables" / f"{table}.parquet")


DECISIONS = {
    "bank 1": ["a", "r it slipped", "a", "k"],
    "p1 experiment 1 y_y trial 1": ["s too fast", "a", "x the strap came off", "a in order", "k calm"],
}


def test_skipped_repeated_and_rejected_trials_lie_where_they_belong(command):
    operator = Operator(command, DECISIONS)
    assert operator.attend() == 0, operator.errors
    (run,) = command.runs
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
    assert set(aside) == {"bank~1~1.parquet", "active_loop~p1~1~y_y~01~1.parquet"}
    assert aside["bank~1~1.parquet"]["stopped_by"].unique() == ["to be repeated, says the operator: it slipped"]
    told = aside["active_loop~p1~1~y_y~01~1.parquet"]
    assert told["stopped_by"].unique() == ["rejected by the operator: the strap came off"]
    assert len(told) == len(read(run, "active_recordings")) / 2
    assert len(read(run, "bank")["trajectory"].unique()) == 5
    first_proposal = [line for line in operator.printed if "tells most: utility y_y" in line]
    assert len(first_proposal) == 4


@pytest.mark.slow
def test_a_study_that_is_stopped_and_continued_is_the_same_study(tmp_path):
    whole = Command(tmp_path / "whole", *SMALL)
    assert Operator(whole, DECISIONS).attend() == 0
    broken = Command(tmp_path / "broken", *SMALL)
    today = {**DECISIONS, "bank 3": ["q lunch"]}
    operator = Operator(broken, today)
    assert operator.attend() == 3
    (line,) = operator.errors
    assert "bank paused: the operator stopped for today; next is bank 3 (lunch); to continue, type: " in line
    after = {**DECISIONS, "p1 experiment 1 y_y trial 1": DECISIONS["p1 experiment 1 y_y trial 1"][:3]}
    after["p1 experiment 1 y_y trial 1"].append("q")
    assert Operator(broken, after).attend() == 3
    last = {"p1 experiment 1 y_y trial 1": ["a in order", "k calm"]}
    operator = Operator(broken, last)
    assert operator.attend() == 0, operator.errors
    assert [label for label, _ in operator.asked] == [
        *["p1 experiment 1 y_y trial 1"] * 2,
        *["p1 experiment 1 y_y trial 2"] * 2,
    ]
    (run,), (reference,) = broken.runs, whole.runs
    for path in sorted((reference / "tables").glob("*.parquet")):
        assert (run / "tables" / path.name).read_bytes() == path.read_bytes(), path.name


def test_nobody_at_the_terminal_any_more_pauses_the_study(command):
    operator = Operator(command, {"bank 2": [None]})
    assert operator.attend() == 3
    assert "bank paused: the operator stopped for today; next is bank 2 (the terminal's input had ended)" in "".join(
        operator.errors
    )


def test_ctrl_c_at_a_question_ends_the_run_with_the_command_that_continues(command):
    operator = Operator(command, {"bank 1": [lambda process: os.kill(process.pid, signal.SIGINT)]})
    assert operator.attend() == 130
    assert "stopped by Ctrl-C; to continue, type: " in "".join(operator.errors)


@pytest.mark.slow
def test_a_trial_in_real_time_is_the_same_and_can_be_stopped(command, tmp_path):
    still = Command(tmp_path / "still", *SMALL, *SHORT)
    assert Operator(still).attend() == 0
    real = Command(tmp_path / "real", *SMALL, *SHORT, "rig.realtime=true")

    class Impatient(Operator):
        stops = 1

        def watch(self, line):
            if line.startswith("running") and self.asked[-1][0] == "bank 1" and self.stops:
                self.stops -= 1
                time.sleep(1.6)  # the muscles are filled for a second first
                self.type("")

    operator = Impatient(real, {"bank 1": ["a", "r too early"]})
    assert operator.attend() == 0, operator.errors
    (run,), (reference,) = real.runs, still.runs
    assert (run / "tables" / "bank.parquet").read_bytes() == (reference / "tables" / "bank.parquet").read_bytes()
    (aside,) = (run / "interrupted").iterdir()
    told = pd.read_parquet(aside)
    (why,) = told["stopped_by"].unique()
    assert re.fullmatch(
        r"stopped 0\.\d+ s into the trial: the operator pressed Enter; to be repeated, says the operator: too early",
        why,
    )
    assert "stopped" in "".join(operator.printed)


@pytest.mark.parametrize("desk", [("desk=terminal",), ()], ids=["terminal", "none"])
def test_a_pointer_needs_a_page_before_anything_is_recorded(pamid, desk):
    result = pamid("budget=tiny", "participant=mouse", *desk)
    assert result.returncode == 1
    (line,) = [each for each in result.stderr.splitlines() if "failed" in each]
    assert "points at postures" in line
    assert "set desk=pages" in line
    assert not list(pamid.outputs.glob("runs/*/parts/*/*"))


def test_movements_that_are_all_skipped_are_proposed_again_and_enough_are_kept(command):
    label = "p1 experiment 1 y_y trial 1"
    answers = {label: [*["s"] * 4, "a", "x no", "a", "x no", "a", "k"]}
    operator = Operator(command, answers)
    assert operator.attend() == 0, operator.errors
    (run,) = command.runs
    decisions = read(run, "decisions")
    skipped = decisions.loc[decisions["decision"] == "skip", "trajectory"]
    assert sorted(skipped) == sorted(set(skipped))
    assert len(skipped) == 4
    assert decisions["decision"].tolist()[4:] == ["reject", "reject", "keep", "keep"]
    offers = [line for line in operator.printed if "= repeat" in line]
    assert ["= reject" in line for line in offers[-4:]] == [True, True, False, False]
    assert len(read(run, "trials")) == 2


def test_where_nothing_asks_an_operator_a_desk_is_refused(pamid):
    result = pamid("workflow=hidden_effect", "desk=terminal")
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith("desk: expected null, as nothing that workflow hidden_effect drives asks an operator")
    assert not pamid.outputs.exists()
