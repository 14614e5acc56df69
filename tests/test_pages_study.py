"""A whole study of ten designed trials, decided on and followed on pages in a browser."""

import contextlib
import os
import re
import shutil
import subprocess
import threading
import time

import pandas as pd
import pytest

from tests.conftest import ROOT, Command

pytest.importorskip("aiohttp", reason="aiohttp is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.realtime, pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")]

STUDY = [
    "budget=tiny",
    "bank.trajectories=14",
    "subsampling.initial_trials=1",
    "active_loop.trials=10",
    "active_loop.controls=[]",
    "exoskeleton.trial_s=0.8",
    "rig.lead_in_s=0.2",
    "rig.realtime=true",
    "stages=[bank,subsampling,hyperprior,hardware,active_loop,tracking_delay,comparison]",
    "desk=pages",
    "desk.port=0",
    "desk.countdown_s=0.1",
    "desk.result_s=0.0",
]
KEYS = {"accept": "a", "skip": "s", "keep": "k", "repeat": "r", "reject": "x"}
ANSWERS = {
    "p1 experiment 1 y_y trial 1": ["skip", "accept", "reject", "accept", "keep"],
    "p1 experiment 1 y_y trial 4": ["accept", "repeat", "accept", "keep"],
}


class Served:
    """The command, and the addresses that it tells."""

    def __init__(self, command):
        self.process = subprocess.Popen(
            command.line(),
            cwd=ROOT,
            env={**command.environment, "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
        )
        self.printed = []
        self.reading = threading.Thread(target=lambda: self.printed.extend(self.process.stdout), daemon=True)
        self.reading.start()

    def find(self, role):
        until = time.monotonic() + 60
        while time.monotonic() < until:
            found = re.search(rf"{role}'s page: (\S+)", "".join(self.printed))
            if found:
                return found[1]
            time.sleep(0.05)
        raise AssertionError("".join(self.printed))

    def close(self):
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=60)
        self.process.kill()
        self.process.wait()
        self.reading.join()
        self.process.stdout.close()
        return self.process.returncode


@pytest.fixture
def served(tmp_path):
    command = Command(tmp_path / "outputs", *STUDY)
    found = Served(command)
    yield command, found
    found.process.kill()
    found.close()


def read(run, table):
    return pd.read_parquet(run / "tables" / f"{table}.parquet")


def test_a_study_of_ten_trials_is_driven_through_its_pages(served):
    command, study = served
    waiting = {label: list(words) for label, words in ANSWERS.items()}
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"] if os.getuid() == 0 else [])
        participant, operator = (browser.new_page() for _ in range(2))
        complaints = []
        for page in (participant, operator):
            page.on("pageerror", lambda error: complaints.append(str(error)))
        participant.goto(study.find("participant"))
        operator.goto(study.find("operator"))
        until = time.monotonic() + 240
        while study.process.poll() is None and time.monotonic() < until:
            with contextlib.suppress(playwright.Error):  # the server goes with the study
                offered = operator.eval_on_selector_all(
                    "#choices button:not([disabled])", "all => all.map(each => each.dataset.word)"
                )
                if not offered:
                    time.sleep(0.02)
                    continue
                label = operator.text_content("#label")
                usual = "accept" if "accept" in offered else "keep"
                word = waiting[label].pop(0) if waiting.get(label) else usual
                operator.fill("#note", f"{word} {label}" if label in ANSWERS else "")
                operator.evaluate("document.activeElement.blur()")
                operator.keyboard.press(KEYS[word])
                operator.wait_for_function(
                    f"() => !document.querySelector('#choices [data-word={word}]:not([disabled])')"
                )
        browser.close()
    assert study.close() == 0, "".join(study.printed)
    assert complaints == []
    (run,) = command.runs
    decisions = read(run, "decisions").set_index(["trial", "attempt"])
    assert decisions.loc[1, "decision"].tolist() == ["skip", "reject", "keep"]
    assert decisions.loc[4, "decision"].tolist() == ["repeat", "keep"]
    assert decisions.loc[(1, 2), "note"] == "accept p1 experiment 1 y_y trial 1; reject p1 experiment 1 y_y trial 1"
    assert len(decisions) == 13
    trials, recordings = read(run, "trials"), read(run, "active_recordings")
    assert trials["trial"].tolist() == list(range(1, 11))
    assert recordings.groupby("trial").ngroups == 10
    assert len(list((run / "interrupted").iterdir())) == 2
    late_s = recordings["reference_shown_s"] - recordings["time_s"]
    assert late_s.notna().mean() > 0.95
    assert 0.0 <= late_s.median() < 0.1
    delays = read(run, "tracking_delays")
    assert delays["display_delay_s"].between(0.0, 0.1).all()


def test_a_signal_closes_pages_and_study(served):
    _, study = served
    study.find("operator")
    study.process.terminate()
    assert study.close() == 143
    assert "to continue, type: " in "".join(study.printed)


def test_what_an_operator_never_saw_is_not_begun(served):
    command, study = served
    study.find("operator")
    time.sleep(1.0)
    assert study.process.poll() is None
    assert not list((command.runs[0] / "parts").glob("*/0"))
