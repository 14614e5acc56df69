"""The pages of a trial as a browser shows them: what moves, what stops it, and how soon."""

import contextlib
import os
import shutil
import time

import numpy as np
import pytest

from stages.rig.attendance import TrialDeclined
from stages.rig.pages.server import PageServer
from tests.rig.attended import Study, make_desk, make_trial, wait_until

pytest.importorskip("aiohttp", reason="aiohttp is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.realtime, pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")]
SIZES = {"wide": (1280, 800), "tall": (720, 1280), "small": (720, 450), "phone": (390, 844)}
OFFERED = """() => new Promise(resolve => {
    const before = pamid.frames, began = performance.now();
    let offered = 0;
    const count = now => {
        offered += 1;
        if (now - began < 1000) requestAnimationFrame(count);
        else resolve([offered, pamid.frames - before]);
    };
    requestAnimationFrame(count);
})"""
HOSTILE = "<img src=//elsewhere.invalid/x><script>document.title='taken'</script>"


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"] if os.getuid() == 0 else [])
        yield found
        found.close()


class Look:
    """A page of a trial, what it asked for and what it complained of."""

    def __init__(self, browser, address, size="wide", theme="light", more=""):
        across, down = SIZES[size]
        self.page = browser.new_page(viewport={"width": across, "height": down}, color_scheme=theme)
        self.page.set_default_timeout(5000)
        self.asked, self.complaints = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(address + more)
        self.wait("pamid.phase !== 'lost'")

    def wait(self, holds):
        """Wait until something holds; the page's own rules allow functions only, nothing that is evaluated."""
        return self.page.wait_for_function(f"() => {holds}")

    def wait_phase(self, phase):
        self.wait(f"pamid.phase === '{phase}'")

    def wait_text(self, text):
        self.page.get_by_text(text).first.wait_for()

    def picture(self):
        return self.page.evaluate("document.querySelector('canvas').toDataURL()")

    def find_overflow(self):
        """What lies beyond the page's sides."""
        return self.page.evaluate(
            """[document.documentElement.scrollWidth > innerWidth && "page is wider",
            ...[...document.querySelectorAll(
                "h1, h2, p, dd, dt, li, button, textarea, canvas, figcaption, .ring, kbd, footer, table"
            )].filter(each => {
                const box = each.getBoundingClientRect();
                return each.checkVisibility() && (box.left < -0.5 || box.right > innerWidth + 0.5);
            }).map(each => each.outerHTML.slice(0, 80))].filter(Boolean)"""
        )

    def find_scrolling(self):
        return self.page.evaluate(
            """[document.documentElement.scrollHeight > innerHeight && "page is higher",
            ...[...document.querySelectorAll("h1, p, dl, button, canvas, footer, .ring")].filter(each => {
                const box = each.getBoundingClientRect();
                return each.checkVisibility() && (box.top < -0.5 || box.bottom > innerHeight + 0.5);
            }).map(each => each.outerHTML.slice(0, 80))].filter(Boolean)"""
        )


class Room:
    """A desk with its server, and the pages that look at it."""

    def __init__(self, browser, **settings):
        self.browser = browser
        self.desk = make_desk(**settings)
        self.server = PageServer(self.desk, "127.0.0.1", 0)
        self.server.open()
        self.looks = []

    def look(self, role, **how):
        look = Look(self.browser, getattr(self.server, f"{role}_url"), **how)
        self.looks.append(look)
        wait_until(lambda: self.desk.see()["pages"][role])
        return look

    def start(self, *kinds, **how):
        trials = [make_trial(self.desk.machine, kind, position, **how) for position, kind in enumerate(kinds, 4)]
        study = Study(self.desk, *trials, fill_s=0.3)
        study.start()
        return study

    def close(self):
        for look in self.looks:
            look.page.close()
        self.server.close()


@pytest.fixture
def room(browser):
    with contextlib.ExitStack() as stack:

        def enter(**settings):
            made = Room(browser, **settings)
            stack.callback(made.close)
            return made

        yield enter


def test_a_trial_from_its_proposal_to_its_result(room):
    room = room(countdown_s=1.5, trial_s=3.0, needed=["participant", "operator"])
    participant, operator = room.look("participant"), room.look("operator")
    participant.wait_text("Please wait")
    study = room.start("tracked")
    participant.wait_text("The next movement begins soon")
    operator.wait_text("its predictions differ by 21 %")
    operator.wait_text("skipping it chooses movement")
    assert operator.page.locator("#choices button").all_inner_texts() == ["accept a", "skip s", "stop for today q"]
    operator.page.locator("#note").fill("arm at rest")
    operator.page.get_by_role("heading").first.click()
    operator.page.keyboard.press("a")
    participant.wait_text("Get ready")
    participant.wait("document.getElementById('count').textContent === '2'")
    participant.wait("document.getElementById('count').textContent === '1'")
    participant.wait_text("Follow the red arm")
    first = participant.picture()
    offered, drawn = participant.page.evaluate(OFFERED)
    assert drawn >= 0.9 * offered  # of the frames that the browser had time for
    running = participant.page.evaluate("({...window.pamid})")
    assert running["phase"] == "running"
    assert running["fps"] > 30
    assert participant.picture() != first
    assert operator.page.evaluate("window.pamid.frames") > 5
    participant.wait_text("Done")
    assert participant.page.locator("#errors dd").count() == 2
    assert participant.page.locator("#errors dd").first.inner_text().endswith("°")
    operator.wait_text("Tracking error")
    assert operator.page.locator("#note").input_value() == ""
    operator.page.locator("button.keep").click()
    recording = wait_until(lambda: study.ended)[0]
    for name in ("reference_shown_s", "measured_shown_s"):
        delay_s = (getattr(recording, name) - recording.time_s)[:-20]
        assert np.isfinite(delay_s).all(), name
        assert -0.02 < np.median(delay_s) < 0.1, name
        assert np.quantile(delay_s, 0.95) < 0.1, name
    assert room.desk.see()["history"] == [{"trial": "trial 4", "decision": "keep", "note": "arm at rest"}]
    operator.wait_text("arm at rest")
    assert room.desk.why_stop() == ""
    for look in room.looks:
        assert look.complaints == []
        own = (f"http://127.0.0.1:{room.server.port}/", "data:")
        assert [each for each in look.asked if not each.startswith(own)] == []


WAYS = {
    "participant's space": ("participant", " "),
    "participant's escape": ("participant", "Escape"),
    "participant's button": ("participant", None),
    "operator's space": ("operator", " "),
    "operator's escape": ("operator", "Escape"),
    "operator's button": ("operator", None),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_stop_is_heard_within_a_fifth_of_a_second(room, way):
    role, key = WAYS[way]
    room = room(countdown_s=0.0, trial_s=5.0)
    participant, operator = room.look("participant"), room.look("operator")
    pressed = {"participant": participant, "operator": operator}[role]
    room.desk.go_on(True)
    study = room.start("tracked")
    participant.wait_text("Follow the red arm")
    pressed.wait("!document.getElementById('stop').disabled")
    pressed_s = time.monotonic()
    if key is None:
        pressed.page.evaluate("document.getElementById('stop').click()")
    else:
        pressed.page.keyboard.press(key)
    assert wait_until(lambda: study.stopped_s) - pressed_s < 0.2
    assert room.desk.why_stop() == f"the {role} pressed stop"
    participant.wait_text("Stopped")
    operator.wait_text(f"stopped: the {role} pressed stop")
    operator.page.keyboard.press("r")
    assert isinstance(wait_until(lambda: study.ended)[0], TrialDeclined)


def test_a_stop_during_the_countdown_proposes_the_trial_again(room):
    room = room(countdown_s=5.0)
    participant, operator = room.look("participant"), room.look("operator")
    room.start("tracked")
    operator.wait_phase("proposed")
    operator.page.locator("button.accept").click()
    participant.wait_phase("countdown")
    participant.page.keyboard.press(" ")
    operator.wait_text("stopped before it began: the participant pressed stop")
    operator.wait_phase("proposed")
    assert operator.page.locator("button.accept").is_enabled()


@pytest.mark.parametrize("way", ["closed", "elsewhere", "hidden"])
def test_a_participants_page_that_is_gone_stops_the_trial(room, way):
    room = room(countdown_s=0.0, trial_s=5.0, needed=["participant"])
    participant = room.look("participant")
    room.desk.go_on(True)
    study = room.start("tracked")
    participant.wait_text("Follow the red arm")
    gone_s = time.monotonic()
    if way == "closed":
        participant.page.close()
    elif way == "elsewhere":
        participant.page.goto("about:blank")
    else:
        participant.page.evaluate(
            """Object.defineProperty(document, "hidden", {value: true});
            document.dispatchEvent(new Event("visibilitychange", {bubbles: true}))"""
        )
    assert wait_until(lambda: study.stopped_s) - gone_s < 1.0
    assert "page" in room.desk.why_stop()


def test_keys_do_nothing_while_a_note_is_written(room):
    room = room()
    operator = room.look("operator")
    room.start("tracked")
    operator.wait_phase("proposed")
    operator.page.locator("#note").click()
    operator.page.keyboard.type("a skip d x q")
    operator.page.get_by_role("heading").first.click()
    for key in ("Control+a", "Alt+s", "Meta+q", "z"):
        operator.page.keyboard.press(key)
    time.sleep(0.2)
    assert room.desk.see()["phase"] == "proposed"
    assert operator.page.locator("#note").input_value() == "a skip d x q"
    operator.page.keyboard.press("s")
    wait_until(lambda: room.desk.see()["history"])
    assert room.desk.see()["history"][0] == {"trial": "trial 4", "decision": "skip", "note": "a skip d x q"}


def test_trials_follow_by_themselves_until_somebody_stops(room):
    room = room(countdown_s=0.2, result_s=0.3)
    participant, operator = room.look("participant"), room.look("operator")
    study = room.start("tracked", "tracked", "tracked")
    operator.wait_phase("proposed")
    operator.page.get_by_label("let trials follow by themselves").check()
    wait_until(lambda: study.ended, 6.0)
    participant.wait_text("Follow the red arm")
    participant.page.keyboard.press("Escape")
    operator.wait_phase("judging")
    assert not operator.page.get_by_label("let trials follow by themselves").is_checked()


@pytest.mark.parametrize(("kind", "told"), [("free", "Move freely"), ("passive", "Do not move")])
def test_without_a_reference_only_the_own_arm_is_shown(room, kind, told):
    room = room(countdown_s=0.0, trial_s=1.5)
    participant = room.look("participant")
    room.desk.go_on(True)
    study = room.start(kind)
    participant.wait_text(told)
    assert not participant.page.get_by_text("target").is_visible()
    recording = wait_until(lambda: study.ended, 6.0)[0]
    assert np.isnan(recording.reference_shown_s).all()
    assert np.isfinite(recording.measured_shown_s[:-20]).all()


@pytest.mark.parametrize("joints", [1, 3])
def test_a_pointer_becomes_a_posture_within_the_limits(room, joints):
    room = room(joints=joints)
    participant = room.look("participant", more="&pointer=1")
    found = []
    for share in (0.45, 0.6, 0.8):
        box = participant.page.locator("canvas").bounding_box()
        participant.page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        time.sleep(0.2)
        wait_until(lambda: room.desk.ask_pointer() is not None)
        found.append(room.desk.ask_pointer())
    limits = [(each.lower_rad, each.upper_rad) for each in room.desk.machine.joints]
    for posture in found:
        assert len(posture) == joints
        assert all(low <= angle <= high for angle, (low, high) in zip(posture, limits, strict=True))
    assert not np.allclose(found[0], found[-1])


def test_what_others_wrote_is_shown_as_it_is(room):
    room = room(countdown_s=0.0)
    operator = room.look("operator")
    study = room.start("tracked", label=HOSTILE)
    operator.wait_phase("proposed")
    assert operator.page.locator("#label").inner_text() == HOSTILE
    operator.page.locator("#note").fill(HOSTILE)
    operator.page.locator("button.skip").click()
    wait_until(lambda: study.ended)
    operator.page.locator("#history td").first.wait_for()
    assert operator.page.locator("#history td").all_inner_texts() == [HOSTILE, "skip", HOSTILE]
    assert operator.page.title() == "Operator"
    assert operator.complaints == []


def test_the_end_is_told_and_a_page_comes_back_with_the_next_study(room):
    room = room()
    participant, operator = room.look("participant"), room.look("operator")
    room.start("tracked")
    participant.wait_phase("proposed")
    room.server.close()
    participant.wait_text("The study has ended")
    operator.wait_text("ended: the terminal says how")
    time.sleep(1.2)  # tries to connect again fail meanwhile
    assert participant.page.get_by_text("The study has ended").is_visible()
    room.server.open()
    participant.wait_phase("proposed")
    operator.wait_phase("proposed")


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_pages_fit_in_every_state(room, size, theme):
    room = room(countdown_s=0.6, trial_s=1.0, joints=4)
    looks = [room.look(role, size=size, theme=theme) for role in ("participant", "operator")]
    participant, operator = looks
    paper = {"light": "rgb(255, 255, 255)", "dark": "rgb(18, 22, 28)"}
    room.start(
        "tracked", label="trial of a participant with-a-very-long-name-that-no-line-can-hold-and-no-hyphen-breaks"
    )
    for phase in ("proposed", "countdown", "running", "judging"):
        for look in looks:
            look.wait_phase(phase)
            assert look.find_overflow() == []
        assert participant.find_scrolling() == []
        assert participant.page.evaluate("getComputedStyle(document.body).backgroundColor") == paper[theme]
        if phase == "proposed":
            operator.page.locator("button.accept").click()
    participant.page.keyboard.press("d")
    other = paper[{"light": "dark", "dark": "light"}[theme]]
    assert participant.page.evaluate("getComputedStyle(document.body).backgroundColor") == other
