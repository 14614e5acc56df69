"""What the server of pages lets through, what it refuses, and how fast a stop and the newest sample arrive."""

import asyncio
import contextlib
import itertools
import threading
import time
from socket import create_connection

import numpy as np
import pytest

from stages.science.operator_ui.pages import server as pages
from stages.science.operator_ui.pages.server import PageServer
from stages.science.rig.attendance import Moment
from stages.science.rig.contract import RigError
from tests.science.operator_ui.attended import Study, make_trial, open_pages, serve, wait_until

aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed")
LONGEST_S = 30.0
"""Real time for which a message is waited for."""


class Page:
    """A page without a browser, which goes on while it is asked to."""

    def __init__(self, run, socket):
        self.run, self.socket, self.asked = run, socket, itertools.count()

    def send(self, kind, **values):
        self.run(self.socket.send_json({"kind": kind, **values}))

    def hear(self, kind, holds=lambda _: True):
        """The next message of a kind for which something holds."""
        while True:
            told = self.run(self.socket.receive_json(timeout=LONGEST_S))
            if told["kind"] == "moment":
                self.send("seen")
            if told["kind"] == kind and holds(told):
                return told

    def hear_phase(self, phase):
        return self.hear("scene", lambda each: each["phase"] == phase)

    def settle(self):
        """Return once all that was sent was taken."""
        page_s = float(next(self.asked))
        self.send("clock", page_s=page_s)
        self.hear("clock", lambda each: each["page_s"] == page_s)


class Shown:
    """An operator session with its server, asked by a client without a browser."""

    def __init__(self, run, client, host="127.0.0.1", **settings):
        self.run, self.client, self.pages = run, client, []
        self.session, self.server = open_pages(host, **settings)
        self.url = f"http://127.0.0.1:{self.server.port}"

    def path(self, role, socket=False):
        """Where a page is, or its socket, with the token that opens it."""
        url = self.server.address(role)
        return "/ws" * socket + url[url.index("/", len("http://")) :]

    def ask(self, path, method="GET", **headers):
        """Status, headers and text of an answer."""
        answer = self.run(self.client.request(method, f"{self.url}{path}", headers=headers))
        return answer.status, answer.headers, self.run(answer.text())

    def connect(self, path, **headers):
        self.pages.append(Page(self.run, self.run(self.client.ws_connect(f"{self.url}{path}", headers=headers))))
        return self.pages[-1]

    def is_refused(self, status, path, **headers):
        with pytest.raises(aiohttp.WSServerHandshakeError, match=status):
            self.connect(path, **headers)
        return True

    def open(self, *roles):
        """Pages of these roles, once the session knows of them."""
        opened = [self.connect(self.path(role, socket=True)) for role in roles]
        wait_until(lambda: sum(self.session.see()["pages"].values()) == len(roles))
        return opened

    def close(self):
        for page in self.pages:
            self.run(page.socket.close())
        self.server.close()


@pytest.fixture
def client():
    """What asks a server, and what runs it."""
    with asyncio.Runner() as runner:
        loop = runner.get_loop()
        client = aiohttp.ClientSession(connector=aiohttp.TCPConnector(force_close=True, loop=loop), loop=loop)
        yield runner.run, client
        runner.run(client.close())


@pytest.fixture
def shown(client):
    """Show the pages of an operator session with these settings."""
    with contextlib.ExitStack() as stack:
        yield lambda **settings: stack.enter_context(contextlib.closing(Shown(*client, **settings)))


@pytest.fixture
def begin(turned):
    """Begin a study of one trial, by a clock that passes while this thread sleeps by it only."""
    turned.sleep(0.001)
    with contextlib.ExitStack() as stack:

        def begin(session):
            study = Study(session, make_trial(session.machine))
            stack.callback(study.leave)
            turned.start(study)
            return study

        yield begin


@pytest.mark.parametrize(("role", "other"), [("participant", "operator"), ("operator", "participant")])
def test_a_page_opens_with_its_token_only(shown, role, other):
    shown = shown()
    path = shown.path(role)
    status, headers, text = shown.ask(path)
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "<script type=" in text
    assert len(path.split("token=")[1]) >= 32
    for wrong in (f"/{role}", f"/{role}?token=", path[:-1], shown.path(other).replace(other, role)):
        status, _, text = shown.ask(wrong)
        assert (status, text.count("\n"), role in text) == (403, 1, True)
        assert shown.is_refused("403", f"/ws{wrong}")


def test_what_pages_ask_for_is_there_and_nothing_else_and_answers_forbid_what_pages_do_not_need(shown):
    shown = shown()
    for name, kind in (("shared.js", "text/javascript"), ("style.css", "text/css"), ("operator.js", "text/javascript")):
        status, headers, _ = shown.ask(f"/{name}")
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
    for name in ("", "operator.html", "server.py", "..%2Fdesk.py", "%2e%2e/session.py", "ws/other", "favicon.ico"):
        assert shown.ask(f"/{name}")[0] == 404
    for method in ("POST", "PUT", "DELETE", "HEAD", "OPTIONS"):
        assert shown.ask(shown.path("operator"), method)[0] == 405
    asked = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
    for path in (shown.path("operator"), "/shared.js", "/nothing"):
        headers = shown.ask(path)[1]
        rules = headers["Content-Security-Policy"]
        assert (rules.startswith("default-src 'none'"), "unsafe" in rules) == (True, False)
        assert "frame-ancestors 'none'" in rules
        assert asked.items() <= headers.items()


@pytest.mark.parametrize(
    ("header", "values"),
    [
        ("Host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil:{port}", ""]),
        ("Origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"]),
    ],
)
def test_another_name_of_this_computer_and_another_site_are_refused(shown, header, values):
    shown = shown()
    port, own, socket = shown.server.port, shown.path("operator"), shown.path("operator", socket=True)
    for value in values:
        headers = {header: value.format(port=port)}
        for path in (own, "/shared.js", socket):
            status, _, text = shown.ask(path, **headers)
            assert (status, text.count("\n")) == (403, 1)
        assert shown.is_refused("403", socket, **headers)
    for name in (f"127.0.0.1:{port}", f"localhost:{port}"):
        assert shown.ask(own, Host=name, Origin=f"http://{name}")[0] == 200
    assert shown.server.address("operator").startswith(f"http://127.0.0.1:{port}/")
    with pytest.raises(ConnectionRefusedError):  # another address of this computer
        create_connection(("127.0.0.2", port), timeout=1.0).close()


def test_an_address_for_the_whole_network_is_one_that_others_reach_and_is_free_again(shown):
    shown = shown(host="0.0.0.0")
    own = shown.path("operator")
    assert "//0.0.0.0" not in shown.server.address("participant")
    assert shown.ask(own)[0] == 200
    for name in ("0.0.0.0", "evil.example"):
        assert shown.ask(own, Host=f"{name}:{shown.server.port}")[0] == 403
    for do in (shown.server.close, shown.server.close, shown.server.open):
        do()


@pytest.mark.parametrize(
    ("host", "port", "told"),
    [
        ("127.0.0.1", None, r"expected a free port, got \d+.*operator_ui\.port=0"),
        ("192.0.2.1", 0, "operator_ui.host=127"),
    ],
)
def test_an_address_that_cannot_be_taken_is_told_in_one_line(shown, host, port, told):
    shown = shown()
    with pytest.raises(RigError, match=told) as caught:
        PageServer(shown.session, host, shown.server.port if port is None else port).open()
    assert "\n" not in str(caught.value)


def test_what_to_install_is_told(monkeypatch):
    monkeypatch.setattr(pages, "web", None)
    with pytest.raises(RigError, match=r'pip install "pamid\[pages\]"'):
        open_pages()


def test_scenes_come_whenever_something_changes(shown, begin, turned):
    shown = shown()
    participant, operator = shown.open("participant", "operator")
    first = operator.hear("scene")
    assert (first["phase"], first["trial"]) == ("busy", None)
    assert not any("token" in str(each) for each in participant.hear("scene").values())
    (trial,) = begin(shown.session).trials
    proposed = operator.hear_phase("proposed")
    assert proposed["participant_url"] == shown.server.address("participant")
    assert (proposed["choices"], proposed["trial"]["trajectory"]) == (["accept", "skip", "pause"], 17)
    assert np.allclose(proposed["trial"]["reference_rad"], trial.reference_rad[::2], atol=1e-4)
    operator.send("decide", word="accept", note="calm", question=proposed["question"])
    for phase, lasts_s in (("countdown", 0.31), ("running", 1.11), ("judging", 0.0)):
        for page in (participant, operator):
            scene = page.hear_phase(phase)
        turned.sleep(lasts_s)
    assert len(scene["outcome"]["tracking_error_rad"]) == 2


DECIDE = {"kind": "decide", "word": "accept", "note": "", "question": 1}
REFUSED = [
    ("participant", DECIDE, "only the operator"),
    ("participant", {"kind": "automatic", "on": True}, "only the operator"),
    ("operator", DECIDE | {"question": 0}, "decided already"),
    ("operator", DECIDE | {"word": "keep"}, "expected one of accept, skip, pause, got 'keep'"),
    ("operator", DECIDE | {"note": "x" * 2001}, "2000 characters"),
    ("operator", DECIDE, "participant page is not open"),
]


@pytest.mark.parametrize(("role", "message", "why"), REFUSED, ids=range(len(REFUSED)))
def test_a_decision_that_does_not_fit_is_refused(shown, begin, role, message, why):
    shown = shown(needed=["participant"])
    (page,) = shown.open(role)
    begin(shown.session)
    assert page.hear_phase("proposed")["question"] == DECIDE["question"]
    page.send(**message)
    assert why in page.hear("refused")["why"]
    scene = shown.session.see()
    assert (scene["phase"], scene["automatic"]) == ("proposed", False)


STOPS = {
    "participant": ({"kind": "stop", "why": "the strap hurts"}, "the strap hurts"),
    "operator": ({"kind": "stop", "why": "the operator pressed stop"}, "the operator pressed stop"),
    "nonsense": ({"kind": "stop", "why": [1]}, "the participant pressed stop"),
    "closed": (None, "the participant's page was closed"),
}


@pytest.mark.parametrize("way", STOPS)
def test_a_stop_or_a_page_that_is_closed_ends_the_trial_with_its_next_sample(shown, begin, turned, way):
    message, told = STOPS[way]
    shown = shown(trial_s=5.0, countdown_s=0.0, needed=["participant"])
    session = shown.session
    participant, operator = shown.open("participant", "operator")
    session.go_on(True)
    study = begin(session)
    operator.hear_phase("running")
    turned.sleep(0.2)
    operator.hear("moment", lambda each: each["time_s"] > 0.05)
    pressed_s = turned.now_s()
    if message:
        page = operator if way == "operator" else participant
        page.send(**message)
        page.settle()
    else:
        shown.run(participant.socket.close())
        wait_until(lambda: session.see()["pages"]["participant"] == 0)
    turned.sleep(0.1)
    assert study.stopped_s - pressed_s < 0.011
    scene = operator.hear_phase("judging")
    assert session.why_stop() == told
    assert scene["outcome"]["stopped"] == f"stopped: {told}"
    assert not scene["automatic"]


NOW = Moment(0.0, np.zeros(2), np.zeros(4), np.zeros(4), np.array([np.nan, np.inf, -np.inf, 3.0]))


def test_a_slow_reader_gets_the_newest_sample_and_no_queue(shown):
    shown = shown()
    slow, quick = shown.open("participant", "operator")
    last = 5 * pages.MOST_ON_THE_WAY
    for index in range(last + 1):
        shown.session.show(NOW._replace(time_s=float(index)))
        told = quick.hear("moment")
        assert told["time_s"] == index
    assert told["force_n"] == [None, None, None, 3.0]
    for _ in range(pages.MOST_ON_THE_WAY):
        late = slow.hear("moment")
    assert late["time_s"] < 3 * pages.MOST_ON_THE_WAY
    assert slow.hear("moment")["time_s"] == last


def test_samples_come_no_faster_than_shown(shown):
    shown = shown()
    heard, over = 15, threading.Event()

    def show():
        for index in itertools.takewhile(lambda _: not over.wait(0.001), itertools.count()):
            shown.session.show(NOW._replace(time_s=float(index)))

    (page,) = shown.open("participant")
    begun_s = time.monotonic()
    threading.Thread(target=show).start()
    for _ in range(heard):
        page.hear("moment")
    over.set()
    assert time.monotonic() - begun_s > (heard - 2) / pages.SENT_HZ


def test_the_clock_is_that_of_the_rig(shown, turned):
    (page,) = shown().open("participant")
    turned.sleep(12.5)
    page.send("clock", page_s=12.5)
    now_s = turned.now_s()
    assert page.hear("clock") == {"kind": "clock", "page_s": 12.5, "heard_s": now_s, "sent_s": now_s}


MALFORMED = [
    ("participant", ""),
    ("participant", "{"),
    ("participant", "[]"),
    ("participant", "[" * 20000),
    ("participant", '{"kind": "other"}'),
    ("participant", '{"kind": "clock"}'),
    ("participant", '{"kind": "clock", "page_s": NaN}'),
    ("participant", '{"kind": "clock", "page_s": 1.5e12}'),
    ("participant", '{"kind": "clock", "page_s": 1' + "0" * 400 + "}"),
    ("participant", '{"kind": "drawn", "frames": 3, "starts_at_s": 0}'),
    ("participant", '{"kind": "drawn", "frames": [[1, 2]], "starts_at_s": 0}'),
    ("participant", '{"kind": "drawn", "frames": [["a", 2, 3]], "starts_at_s": 0}'),
    ("participant", '{"kind": "pointer", "angle_rad": [1]}'),
    ("participant", '{"kind": "pointer", "angle_rad": [1, null]}'),
    ("operator", '{"kind": "decide"}'),
    ("operator", '{"kind": "automatic", "on": 1}'),
    ("operator", '{"kind": "drawn"}'),
    ("operator", '{"kind": "pointer"}'),
    ("operator", b"{}"),
    ("operator", " " * (pages.MOST_BYTES + 1)),
]


@pytest.mark.parametrize(("role", "text"), MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_message_closes_its_page_alone(shown, role, text):
    shown = shown()
    bad, good = shown.open(role, "participant")
    shown.run(bad.socket.send_bytes(text) if isinstance(text, bytes) else bad.socket.send_str(text))
    until_s = time.monotonic() + LONGEST_S
    while (end := shown.run(bad.socket.receive(timeout=LONGEST_S))).type is aiohttp.WSMsgType.TEXT:
        assert time.monotonic() < until_s
    wait_until(lambda: shown.session.see()["pages"] == {"participant": 1, "operator": 0})
    good.settle()
    is_long = len(text) > pages.MOST_BYTES
    assert end.data == (1009 if is_long else pages.FORBIDDEN)
    assert is_long or "expected" in end.extra


def test_the_number_of_open_pages_is_bounded(shown, monkeypatch):
    shown = shown()
    monkeypatch.setattr(pages, "MOST_SOCKETS", 2)
    opened = shown.open("operator", "operator")
    assert shown.session.see()["pages"]["operator"] == len(opened)
    assert shown.is_refused("503", shown.path("operator", socket=True))


def test_a_page_that_is_silent_stops_the_trial(shown, begin, turned):
    shown = shown(trial_s=5.0, needed=["participant"], lost_after_s=0.3)
    (participant,) = shown.open("participant")
    shown.session.go_on(True)
    study = begin(shown.session)
    for _ in range(4):
        participant.send("alive")
        participant.settle()
        turned.sleep(0.29)
        assert shown.session.why_stop() == ""
    turned.sleep(0.1)
    assert 0.3 < study.stopped_s - turned.now_s() + 0.39 < 0.32
    assert "was not heard for 0.3 s" in shown.session.why_stop()


def test_what_was_drawn_becomes_part_of_the_recording(shown, begin, turned):
    shown = shown(trial_s=0.4)
    (participant,) = shown.open("participant")
    shown.session.go_on(True)
    study = begin(shown.session)
    turned.sleep(0.35)
    starts_at_s = participant.hear_phase("running")["starts_at_s"]
    while (shown_s := turned.now_s()) < starts_at_s + 0.4:
        frames = [[shown_s, shown_s - starts_at_s, None], [shown_s - 60.0, 0.3, 0.3]]
        participant.send("drawn", starts_at_s=starts_at_s, frames=frames)
        participant.send("drawn", starts_at_s=starts_at_s - 1.0, frames=[[shown_s, 0.3, 0.3]])
        participant.settle()
        turned.sleep(0.02)
    turned.join(study)
    (recording,) = study.ended
    late_s = (recording.reference_shown_s - recording.time_s)[:-5]
    assert np.all((late_s >= -0.001) & (late_s < 0.021))
    assert np.isnan(recording.measured_shown_s).all()


def test_a_pointer_is_kept_within_the_joints_limits(shown):
    shown = shown()
    (participant,) = shown.open("participant")
    participant.send("pointer", angle_rad=[0.3, 99.0])
    participant.settle()
    np.testing.assert_allclose(shown.session.ask_pointer(), [0.3, shown.session.machine.joints[1].upper_rad])


def test_what_an_operator_never_saw_is_not_begun_and_a_signal_closes_the_study(client, tmp_path):
    run, session = client
    with serve(tmp_path / "outputs") as (command, process, addresses):
        address = addresses["participant"].replace("/participant?", "/ws/participant?")
        page = Page(run, run(session.ws_connect(address)))
        page.hear_phase("proposed")
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            assert run(page.socket.receive_json(timeout=LONGEST_S)).get("phase", "proposed") == "proposed"
        assert process.poll() is None
        assert not list((command.runs[0] / "parts").glob("*/0"))
        process.terminate()
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 143
    assert "to continue, type: " in errors
