"""The pages of a trial as a browser shows them: what moves, what stops it, how soon; a study driven through them."""

import contextlib
import threading
import time
from functools import partial

import numpy as np
import pytest

from stages.science.rig.attendance import TrialDeclined
from tests import browsing
from tests.browsing import HOSTILE
from tests.browsing import browser as browser
from tests.science.operator_ui.attended import Study, make_trial, open_pages, read, serve, wait_until

pytest.importorskip("aiohttp", reason="aiohttp is not installed")
SIZES = {"wide": (1280, 800), "tall": (720, 1280), "small": (720, 450), "phone": (390, 844)}
OFFERED = """() => new Promise(resolve => {
    const before = pamid.frames, began = performance.now();
    let offered = 0;
    requestAnimationFrame(function count(now) {
        offered += 1;
        if (now - began < 1000) requestAnimationFrame(count);
        else resolve([offered, pamid.frames - before]);
    });
})"""
NOTE_WRITTEN = """() => {
    const fillText = CanvasRenderingContext2D.prototype.fillText;
    window.written = new Set();
    CanvasRenderingContext2D.prototype.fillText = function (text, ...where) {
        written.add(text);
        fillText.call(this, text, ...where);
    };
}"""
CHOSEN = "document.activeElement.dataset.word ?? document.activeElement.id"
SWEEPS = "getComputedStyle(document.getElementById('progress')).stroke !== 'none'"
SHOWS_GREEN = """() => {
    const canvas = document.querySelector("canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.some((green, at) => at % 4 === 1 && green > data[at - 1] + 60 && green > data[at + 1] + 30);
}"""
BACKGROUND = "getComputedStyle(document.body).backgroundColor"
WHITE, BLACK = "rgb(255, 255, 255)", "rgb(18, 22, 28)"
CLICK = "document.getElementById('stop').click()"
HIDDEN = """Object.defineProperty(document, "hidden", {value: true});
document.dispatchEvent(new Event("visibilitychange", {bubbles: true}))"""
PICTURE = "document.querySelector('canvas').toDataURL()"
ACROSS = "h1, h2, p, dd, dt, li, button, textarea, canvas, figcaption, .ring, kbd, footer, table"
DOWN = "h1, p, dl, button, canvas, footer, .ring"
ROLES = ("participant", "operator")
POLLED_S = 0.02
TITLE = "trial 4 of 12: p1 follows the reference"


class Look(browsing.Look):
    """A page of a trial; where the clock of rigs is turned, its own one stands still unless it is told to go on."""

    def __init__(self, room, role, theme="light"):
        super().__init__(room.browser, SIZES["wide"], color_scheme=theme)
        self.room, self.press = room, self.page.keyboard.press
        self.address = room.server.address(role)
        if room.turned:
            self.page.clock.install(time=0)
            self.page.clock.pause_at(1000)
        self.open()

    def open(self):
        self.page.goto(self.address)
        self.wait("!['connecting', 'lost'].includes(pamid.phase)")

    def wait(self, holds):
        self.room.wait(lambda: self.page.evaluate(holds))

    def wait_phase(self, phase):
        self.wait(f"pamid.phase === '{phase}'")

    def wait_text(self, text):
        self.room.wait(self.page.get_by_text(text).first.is_visible)


class Room:
    """An operator session with its server and the pages that show it; both go by a clock that is turned, if any."""

    def __init__(self, browser, turned=None, **settings):
        self.browser, self.turned = browser, turned
        self.session, self.server = open_pages(**settings)
        self.looks, self.studies = [], []

    def look(self, role, **how):
        self.looks.append(Look(self, role, **how))
        self.wait(lambda: self.session.see()["pages"][role])
        return self.looks[-1]

    def start(self, *kinds, **how):
        trials = [make_trial(self.session.machine, kind, position, **how) for position, kind in enumerate(kinds, 4)]
        study = Study(self.session, *trials, fill_s=0.3)
        self.studies.append(study)
        (self.turned.start if self.turned else threading.Thread.start)(study)
        return study

    def pass_time(self, for_s):
        (self.turned or time).sleep(for_s)
        for look in self.looks if self.turned else []:
            if not look.page.is_closed():
                look.page.clock.run_for(1000 * for_s)

    def wait(self, holds):
        return wait_until(lambda: holds() or self.pass_time(POLLED_S))

    def close(self):
        for study in self.studies:
            study.leave()
        for look in self.looks:
            look.page.close()
        self.server.close()


@pytest.fixture
def room(browser):
    with contextlib.ExitStack() as stack:
        yield lambda *turned, **how: stack.enter_context(contextlib.closing(Room(browser, *turned, **how)))


@pytest.fixture
def still(turned, room):
    """A room whose clocks stand still unless they are told to go on."""
    turned.sleep(0.001)
    return partial(room, turned)


@pytest.mark.realtime
def test_a_browser_draws_frames_as_they_are_offered_and_soon(room):
    room = room(countdown_s=0.0, trial_s=2.0, result_s=0.0)
    participant, _ = map(room.look, ROLES)
    room.session.go_on(True)
    study = room.start("tracked", "free", "passive")
    participant.wait_text("Follow the red arm")
    offered, drawn = participant.page.evaluate(OFFERED)
    assert drawn >= 0.9 * offered  # of the frames that the browser had time for
    assert drawn > 30
    room.wait(lambda: len(study.ended) == 3)
    for recording, kind in zip(study.ended, ("tracked", "free", "passive"), strict=True):
        for name in ["measured_shown_s"] + ["reference_shown_s"] * (kind == "tracked"):
            delay_s = (getattr(recording, name) - recording.time_s)[:-20]
            assert np.isfinite(delay_s).all(), (kind, name)
            assert -0.02 < np.median(delay_s) < 0.1, (kind, name)
            assert np.quantile(delay_s, 0.95) < 0.1, (kind, name)


BY_HAND = (lambda look: look.press(" "), lambda look: look.press("Escape"), lambda look: look.page.evaluate(CLICK))
GONE = (
    lambda look: look.page.evaluate(HIDDEN),
    lambda look: look.page.goto("about:blank"),
    lambda look: look.page.close(),
)
WAYS = [(role, stop, 0.2) for role in ROLES for stop in BY_HAND] + [("participant", leave, 1.0) for leave in GONE]


@pytest.mark.realtime
def test_a_trial_is_stopped_within_a_fifth_of_a_second(room):
    """A page that is gone stops it within a second."""
    room = room(countdown_s=0.0, trial_s=5.0, needed=["participant"])
    looks = {role: room.look(role) for role in ROLES}
    participant, operator = looks.values()
    study = room.start(*["tracked"] * len(WAYS))
    for count, (role, stop, within_s) in enumerate(WAYS, 1):
        operator.wait_phase("proposed")
        operator.press("a")
        participant.wait_text("Follow the red arm")
        looks[role].wait("!document.getElementById('stop').disabled")
        study.stopped_s, pressed_s = None, time.monotonic()
        stop(looks[role])
        assert room.wait(lambda: study.stopped_s) - pressed_s < within_s
        operator.wait_phase("judging")
        if stop in BY_HAND:
            assert room.session.why_stop() == f"the {role} pressed stop"
            participant.wait_text("Stopped")
            operator.wait_text(f"stopped: the {role} pressed stop")
        assert "page" in room.session.why_stop() or stop in BY_HAND
        operator.press("r")
        room.wait(lambda count=count: len(study.ended) == count)
        assert isinstance(study.ended[-1], TrialDeclined)
        if stop in GONE[:2]:
            participant.open()


@pytest.mark.slow
def test_a_trial_from_its_proposal_to_its_result_and_trials_that_follow_by_themselves(still):
    room = still(countdown_s=2.5, trial_s=3.0, result_s=0.3, lost_after_s=10.0, needed=list(ROLES))
    participant, operator = map(room.look, ROLES)
    participant.wait_text("Please wait")
    operator.wait_text("preparing")
    operator.page.evaluate(NOTE_WRITTEN)
    study = room.start("tracked", "tracked", "tracked")
    participant.wait_text("The next movement begins soon")
    operator.wait_text("its predictions differ by 21 %")
    operator.wait_text("skipping it chooses movement")
    operator.wait_text("Utility of each movement of the bank (nat)")
    operator.wait("['time (s)', 'trial', 'movement'].every(each => written.has(each))")
    assert operator.page.locator("#choices button").all_inner_texts() == ["accept a", "skip s", "stop for today q"]
    operator.page.locator("button.accept").click()
    participant.wait_text("Get ready")
    for left in "21":
        participant.wait(f"document.getElementById('count').textContent === '{left}'")
    participant.press(" ")
    operator.wait_text("stopped before it began: the participant pressed stop")
    operator.wait_phase("proposed")
    assert operator.page.locator("button.accept").is_enabled()
    operator.page.locator("#note").fill("arm at rest")
    operator.page.get_by_role("heading").first.click()
    operator.press("a")
    participant.wait_text("Follow the red arm")
    first = participant.page.evaluate(PICTURE)
    room.pass_time(0.5)
    assert participant.page.evaluate("pamid.phase") == "running"
    assert participant.page.evaluate(PICTURE) != first
    assert operator.page.evaluate("pamid.frames") > 5
    room.pass_time(2.5)
    for look in room.looks:
        look.wait_phase("judging")
    participant.wait_text("Done")
    assert participant.page.locator("#errors dd").count() == 2
    assert participant.page.locator("#errors dd").first.inner_text().endswith("°")
    operator.wait_text("Tracking error")
    assert operator.page.locator("#note").input_value() == ""
    operator.page.locator("button.keep").click()
    room.wait(lambda: study.ended)
    assert room.session.see()["history"] == [{"trial": TITLE, "decision": "keep", "note": "arm at rest"}]
    operator.wait_text("arm at rest")
    toggle = operator.page.get_by_label("let trials follow by themselves")
    toggle.check()
    room.wait(lambda: len(study.ended) == 2)
    participant.wait_text("Follow the red arm")
    participant.press("Escape")
    operator.wait_phase("judging")
    assert not toggle.is_checked()
    own = (f"http://127.0.0.1:{room.server.port}/", "data:")
    for look in room.looks:
        assert look.complaints + look.errors + [each for each in look.asked if not each.startswith(own)] == []


@pytest.mark.slow
def test_what_is_written_is_shown_as_it_is_and_presses_no_keys(still):
    room = still(countdown_s=0.0)
    operator = room.look("operator")
    room.start("tracked", label=HOSTILE)
    operator.wait_phase("proposed")
    assert operator.page.locator("#logged").inner_text() == HOSTILE
    note = f"a skip d x q {HOSTILE}"
    operator.page.locator("#note").click()
    operator.page.keyboard.type(note)
    operator.page.get_by_role("heading").first.click()
    for key in ("Control+a", "Alt+s", "Meta+q", "z"):
        operator.press(key)
    room.pass_time(0.2)
    assert operator.page.locator("#choices button").first.is_enabled()
    assert room.session.see()["phase"] == "proposed"
    assert operator.page.locator("#note").input_value() == note
    operator.press("s")
    room.wait(lambda: room.session.see()["history"])
    assert room.session.see()["history"] == [{"trial": TITLE, "decision": "skip", "note": note}]
    room.wait(operator.page.locator("#history td").first.is_visible)
    assert operator.page.locator("#history td").all_inner_texts() == [TITLE, "skip", note]
    assert operator.page.title() == "Operator"
    assert operator.complaints + operator.errors == []


@pytest.mark.slow
def test_without_a_reference_only_the_own_arm_is_shown(still):
    room = still(countdown_s=0.0, trial_s=1.5)
    participant = room.look("participant")
    room.session.go_on(True)
    study = room.start("free", "passive")
    for told in ("Move freely", "Do not move"):
        participant.wait_text(told)
        assert not participant.page.get_by_text("target").is_visible()
    room.wait(lambda: len(study.ended) == 2)
    assert np.isnan([each.reference_shown_s for each in study.ended]).all()


@pytest.mark.slow
@pytest.mark.parametrize("joints", [1, 3])
def test_a_pointer_becomes_a_posture_within_the_limits(still, joints):
    room = still(joints=joints)
    room.session.describe(room.session.machine, pointed=True)
    participant = room.look("participant")
    found = [None]
    for share in (0.45, 0.6, 0.8):
        box = participant.page.locator("canvas").bounding_box()
        participant.page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        room.wait(lambda: room.session.ask_pointer() is not found[-1])
        room.pass_time(0.2)
        found.append(room.session.ask_pointer())
    limits = [(each.lower_rad, each.upper_rad) for each in room.session.machine.joints]
    for posture in found[1:]:
        assert len(posture) == joints
        assert all(low <= angle <= high for angle, (low, high) in zip(posture, limits, strict=True))
    assert not np.allclose(found[1], found[-1])


@pytest.mark.slow
def test_the_end_is_told_and_a_page_comes_back_with_the_next_study(still):
    room = still()
    participant, operator = map(room.look, ROLES)
    room.start("tracked")
    participant.wait_phase("proposed")
    room.server.close()
    participant.wait_text("The program has ended")
    operator.wait_text("ended: the terminal says how")
    room.pass_time(1.2)  # tries to connect again fail meanwhile
    assert participant.page.get_by_text("The program has ended").is_visible()
    room.server.open()
    for look in room.looks:
        look.wait_phase("proposed")


@pytest.mark.slow
@pytest.mark.parametrize(("theme", "paper", "other"), [("light", WHITE, BLACK), ("dark", BLACK, WHITE)])
def test_pages_fit_in_every_state(still, theme, paper, other):
    room = still(countdown_s=10.0, trial_s=4.0, joints=4)
    participant, operator = [room.look(role, theme=theme) for role in ROLES]
    room.start("tracked", label="trial of a person with-a-very-long-name-that-no-line-can-hold-and-no-hyphen-breaks")
    for phase, lasts_s in {"proposed": 0.0, "countdown": 9.0, "running": 4.0, "judging": 0.0}.items():
        for look in room.looks:
            look.wait_phase(phase)
        for across, down in SIZES.values():
            for look in room.looks:
                look.page.set_viewport_size({"width": across, "height": down})
            room.pass_time(POLLED_S)
            assert [participant.find_beyond(*each) for each in (("x", ACROSS), ("y", DOWN))] == [[], []]
            assert operator.find_beyond("x", ACROSS) == []
        assert participant.page.evaluate(BACKGROUND) == paper
        if phase == "proposed":
            operator.page.locator("button.accept").click()
        room.pass_time(lasts_s)
    participant.press("d")
    assert participant.page.evaluate(BACKGROUND) == other


@pytest.mark.slow
def test_pages_are_accessible_in_light_and_dark(room):
    room = room(countdown_s=5.0, trial_s=6.0)
    looks = [room.look(role, theme=theme) for role in ROLES for theme in ("light", "dark")]
    participant, operator = looks[0], looks[-1]

    def check(phase):
        for look in looks:
            look.wait_phase(phase)
            assert look.find_violations() == [], (phase, look.address)

    check("busy")
    room.start(*["tracked"] * 2)
    operator.wait_phase("proposed")
    operator.page.locator("#note").fill("a long note " * 150)
    operator.page.locator("button.skip").click()
    operator.wait_text("a long note")
    check("proposed")
    operator.page.get_by_role("heading").first.click()
    chosen = []
    for _ in range(6):
        operator.press("Tab")
        chosen.append(operator.page.evaluate(CHOSEN))
    assert chosen == ["note", "accept", "skip", "pause", "automatic", "address"]
    operator.page.locator("button.accept").click()
    check("countdown")
    assert participant.page.evaluate(SWEEPS)
    participant.page.emulate_media(reduced_motion="reduce")
    assert not participant.page.evaluate(SWEEPS)
    for phase in ("running", "judging"):
        check(phase)


@pytest.mark.slow
def test_pages_say_what_they_know_once_their_server_is_killed(browser, tmp_path):
    participant, operator = looks = [browsing.Look(browser, SIZES["wide"], color_scheme="light") for _ in ROLES]
    with serve(tmp_path / "outputs", anew=True) as (_, process, addresses):
        for role, look in zip(ROLES, looks, strict=True):
            look.page.goto(addresses[role])
        operator.page.wait_for_function("() => pamid.phase === 'proposed'")
        assert not operator.page.get_by_role("alert").first.is_visible()
        operator.page.keyboard.press("a")
        participant.page.wait_for_function("() => pamid.phase === 'running'")
        participant.page.wait_for_function(SHOWS_GREEN)
        process.kill()
        for look in looks:
            look.page.wait_for_function("() => pamid.phase === 'lost'")
            assert look.page.locator("#stop").is_disabled()
    told = operator.page.get_by_text("Connection lost: use the emergency stop")
    assert told.evaluate("each => parseFloat(getComputedStyle(each).fontSize)") >= 28
    assert operator.page.get_by_text("look at the rig, and at the terminal").is_visible()
    assert operator.page.locator("#label").evaluate("each => getComputedStyle(each, '::before').content") == '"stale: "'
    assert operator.page.get_by_label("let trials follow by themselves").is_disabled()
    assert participant.page.locator(".told").inner_text().split("\n\n") == [
        "Connection lost",
        "this page shows and stops nothing now: tell the operator",
    ]
    assert not participant.page.evaluate(SHOWS_GREEN)
    for look in looks:
        assert look.find_violations() == []
        look.page.emulate_media(color_scheme="dark")
        assert look.find_violations() == []


KEYS = {"accept": "a", "skip": "s", "keep": "k", "repeat": "r", "reject": "x"}
FIRST, FOURTH = (f"p1 experiment 1 integrated_variance trial {each}" for each in (1, 4))
ANSWERS = {
    FIRST: ["skip", "accept", "reject", "accept", "keep"],
    FOURTH: ["accept", "repeat", "accept", "keep"],
}


def answer(operator, waiting):
    """Answer what the operator's page asks, if it asks anything, by a key and with a note."""
    offered = operator.eval_on_selector_all(
        "#choices button:not([disabled])", "all => all.map(each => each.dataset.word)"
    )
    if not offered:
        time.sleep(0.02)
        return
    label = operator.text_content("#logged")
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
    assert decisions.loc[(1, 2), "note"] == f"accept {FIRST}; reject {FIRST}"
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
