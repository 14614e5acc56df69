"""A whole study of designed trials, decided on and followed on pages in a browser."""

import asyncio
import contextlib
import re
import shlex
import threading
import time

import pytest

from tests import browsing
from tests.browsing import browser as browser
from tests.conftest import Command
from tests.science.operator_ui.attended import read

aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed")

STUDY = shlex.split("""
budget=tiny bank.trajectories=8 subsampling.initial_trials=1 active_loop.trials=5 active_loop.controls=[]
exoskeleton.trial_s=0.8 rig.lead_in_s=0.2 rig.realtime=true
stages=[bank,subsampling,hyperprior,hardware,active_loop,tracking_delay,comparison]
operator_ui=pages operator_ui.port=0 operator_ui.countdown_s=0.1 operator_ui.lost_after_s=5.0 operator_ui.result_s=0.0
""")
KEYS = {"accept": "a", "skip": "s", "keep": "k", "repeat": "r", "reject": "x"}
ANSWERS = {
    "p1 experiment 1 y_y trial 1": ["skip", "accept", "reject", "accept", "keep"],
    "p1 experiment 1 y_y trial 4": ["accept", "repeat", "accept", "keep"],
}


@contextlib.contextmanager
def serve(outputs, **how):
    """Start the study; the command, its process and the addresses that it tells. It ends with the test."""
    command, addresses = Command(outputs, *STUDY), {}
    with command.start(**how) as process:
        watchdog = threading.Timer(300.0, process.kill)
        watchdog.start()
        try:
            while len(addresses) < 2:
                line = process.stdout.readline()
                assert line, process.stderr.read()
                addresses |= re.findall(r"(\w+)'s page: (\S+)", line)
            yield command, process, addresses
        finally:
            process.kill()
            watchdog.cancel()


def test_what_an_operator_never_saw_is_not_begun_and_a_signal_closes_the_study(tmp_path):
    async def see_proposed(address):
        async with aiohttp.ClientSession() as client, client.ws_connect(address) as socket:
            while (await socket.receive_json(timeout=60.0)).get("phase") != "proposed":
                pass
            until = time.monotonic() + 0.5
            while time.monotonic() < until:
                assert (await socket.receive_json(timeout=60.0)).get("phase", "proposed") == "proposed"

    with serve(tmp_path / "outputs") as (command, process, addresses):
        asyncio.run(see_proposed(addresses["participant"].replace("/participant?", "/ws/participant?")))
        assert process.poll() is None
        assert not list((command.runs[0] / "parts").glob("*/0"))
        process.terminate()
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 143
    assert "to continue, type: " in errors


def answer(operator, waiting):
    """Answer what the operator's page asks, if it asks anything, by a key and with a note."""
    offered = operator.eval_on_selector_all(
        "#choices button:not([disabled])", "all => all.map(each => each.dataset.word)"
    )
    if not offered:
        time.sleep(0.02)
        return
    label = operator.text_content("#label")
    usual = "accept" if "accept" in offered else "keep"
    word = waiting[label].pop(0) if waiting.get(label) else usual
    operator.fill("#note", f"{word} {label}" if label in ANSWERS else "")
    operator.evaluate("document.activeElement.blur()")
    operator.keyboard.press(KEYS[word])
    operator.wait_for_function(f"() => !document.querySelector('#choices [data-word={word}]:not([disabled])')")


@pytest.mark.realtime
def test_a_study_is_driven_through_its_pages(browser, tmp_path):
    waiting = {label: list(words) for label, words in ANSWERS.items()}
    looks = {role: browsing.Look(browser, (1280, 800)) for role in ("participant", "operator")}
    with serve(tmp_path / "outputs", anew=True) as (command, process, addresses):
        for role, look in looks.items():
            look.page.goto(addresses[role])
        while process.poll() is None:
            try:
                answer(looks["operator"].page, waiting)
            except browsing.playwright.Error:  # the server goes with the study
                time.sleep(0.02)
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 0, errors
    assert [each for look in looks.values() for each in look.errors] == []
    (run,) = command.runs
    decisions = read(run, "decisions").set_index(["trial", "attempt"])
    assert decisions.loc[1, "decision"].tolist() == ["skip", "reject", "keep"]
    assert decisions.loc[4, "decision"].tolist() == ["repeat", "keep"]
    assert decisions.loc[(1, 2), "note"] == "accept p1 experiment 1 y_y trial 1; reject p1 experiment 1 y_y trial 1"
    assert len(decisions) == 8
    trials, recordings = read(run, "trials"), read(run, "active_recordings")
    assert trials["trial"].tolist() == list(range(1, 6))
    assert recordings.groupby("trial").ngroups == 5
    assert len(list((run / "interrupted").iterdir())) == 2
    late_s = recordings["reference_shown_s"] - recordings["time_s"]
    assert late_s.notna().mean() > 0.95
    assert 0.0 <= late_s.median() < 0.1
    delays = read(run, "tracking_delays")
    assert delays["display_delay_s"].between(0.0, 0.1).all()
