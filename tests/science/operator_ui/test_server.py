"""What the server of pages lets through, what it refuses, and how fast a stop and the newest sample arrive."""

import asyncio
import builtins
import contextlib
import itertools
import json
import socket
import threading
import time

import numpy as np
import pytest

from stages.science.operator_ui.pages import server as pages
from stages.science.operator_ui.pages.server import PageServer, encode
from stages.science.rig.attendance import Moment
from stages.science.rig.contract import RigError
from tests.science.operator_ui.attended import begin as begin
from tests.science.operator_ui.attended import make_session, make_trial, wait_until

aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed")
LONGEST_S = 30.0
"""Real time for which a message is waited for."""


@contextlib.contextmanager
def shown(host="127.0.0.1", port=0, **settings):
    session = make_session(**settings)
    server = PageServer(session, host, port)
    server.open()
    try:
        yield session, server
    finally:
        server.close()


@pytest.fixture
def opened():
    with shown() as pair:
        yield pair


def address(server, role, socket=False):
    url = getattr(server, f"{role}_url")
    return url.replace(f"/{role}?", f"/ws/{role}?") if socket else url


def ask(server, path, method="GET", **headers):
    """Status, headers and text of an answer."""

    async def asked():
        async with (
            aiohttp.ClientSession() as client,
            client.request(method, f"http://127.0.0.1:{server.port}{path}", headers=headers) as answer,
        ):
            return answer.status, answer.headers, await answer.text()

    return asyncio.run(asked())


def path_of(url):
    return url[url.index("/", len("http://")) :]


async def connect(url, **headers):
    async with aiohttp.ClientSession() as client, client.ws_connect(url, headers=headers):
        pass


class Page:
    """A page without a browser."""

    def __init__(self, socket):
        self.socket = socket
        self.asked = itertools.count()

    async def send(self, kind, **values):
        await self.socket.send_str(json.dumps({"kind": kind, **values}))

    async def hear(self, kind, holds=lambda _: True):
        """The next message of a kind for which something holds."""
        while True:
            told = await self.socket.receive_json(timeout=LONGEST_S)
            if told["kind"] == "moment":
                await self.send("seen")
            if told["kind"] == kind and holds(told):
                return told

    async def hear_phase(self, phase):
        return await self.hear("scene", lambda each: each["phase"] == phase)

    async def hear_end(self):
        while True:
            message = await self.socket.receive(timeout=LONGEST_S)
            if message.type is not aiohttp.WSMsgType.TEXT:
                return message.data, message.extra

    async def settle(self):
        """Return once all that was sent was taken."""
        page_s = float(next(self.asked))
        await self.send("clock", page_s=page_s)
        return await self.hear("clock", lambda each: each["page_s"] == page_s)


def converse(server, talk, *roles):
    """Open pages, hand them to a coroutine, and return what it returns."""

    async def run():
        async with contextlib.AsyncExitStack() as stack:
            client = await stack.enter_async_context(aiohttp.ClientSession())
            addresses = [address(server, role, True) for role in roles]
            sockets = [await stack.enter_async_context(client.ws_connect(each)) for each in addresses]
            wait_until(lambda: sum(server.session.see()["pages"].values()) == len(roles))
            return await asyncio.wait_for(talk(*map(Page, sockets)), 2 * LONGEST_S)

    return asyncio.run(run())


@pytest.mark.parametrize("role", ["participant", "operator"])
def test_a_page_opens_with_its_token_only(opened, role):
    _, server = opened
    path = path_of(address(server, role))
    status, headers, text = ask(server, path)
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "<script type=" in text
    assert len(path.split("token=")[1]) >= 32
    other = {"participant": "operator", "operator": "participant"}[role]
    for wrong in (f"/{role}", f"/{role}?token=", path[:-1], path_of(address(server, other)).replace(other, role)):
        status, _, text = ask(server, wrong)
        assert (status, text.count("\n"), role in text) == (403, 1, True)
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            asyncio.run(connect(f"http://127.0.0.1:{server.port}{wrong.replace('/', '/ws/', 1)}"))


def test_what_pages_ask_for_is_there_and_nothing_else(opened):
    _, server = opened
    for name, kind in (("shared.js", "text/javascript"), ("style.css", "text/css"), ("operator.js", "text/javascript")):
        status, headers, _ = ask(server, f"/{name}")
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
    for name in ("", "operator.html", "server.py", "..%2Fdesk.py", "%2e%2e/session.py", "ws/other", "favicon.ico"):
        assert ask(server, f"/{name}")[0] == 404
    for method in ("POST", "PUT", "DELETE", "HEAD", "OPTIONS"):
        assert ask(server, path_of(server.operator_url), method)[0] == 405


def test_answers_forbid_what_pages_do_not_need(opened):
    _, server = opened
    for path in (path_of(server.operator_url), "/shared.js", "/nothing"):
        headers = ask(server, path)[1]
        rules = headers["Content-Security-Policy"]
        assert rules.startswith("default-src 'none'")
        assert "frame-ancestors 'none'" in rules
        assert "unsafe" not in rules
        assert headers["Cache-Control"] == "no-store"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"


def test_only_this_computer_reaches_it_by_default(opened):
    _, server = opened
    assert server.operator_url.startswith(f"http://127.0.0.1:{server.port}/")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", server.port), timeout=1.0).close()


@pytest.mark.parametrize(
    ("header", "values"),
    [
        ("Host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil:{port}", ""]),
        ("Origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"]),
    ],
)
def test_another_name_of_this_computer_and_another_site_are_refused(opened, header, values):
    _, server = opened
    for value in values:
        headers = {header: value.format(port=server.port)}
        for path in (path_of(server.operator_url), "/shared.js", path_of(address(server, "operator", True))):
            status, _, text = ask(server, path, **headers)
            assert (status, text.count("\n")) == (403, 1)
        with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
            asyncio.run(connect(address(server, "operator", True), **headers))
    for name in ("127.0.0.1", "localhost"):
        own = f"{name}:{server.port}"
        assert ask(server, path_of(server.operator_url), Host=own, Origin=f"http://{own}")[0] == 200


def test_an_address_for_the_whole_network_is_one_that_others_reach():
    with shown(host="0.0.0.0") as (_, server):
        assert "//0.0.0.0" not in server.participant_url
        assert ask(server, path_of(server.operator_url))[0] == 200
        for name in ("0.0.0.0", "evil.example"):
            assert ask(server, path_of(server.operator_url), Host=f"{name}:{server.port}")[0] == 403


@pytest.mark.parametrize(
    ("host", "port", "told"),
    [
        ("127.0.0.1", None, r"expected a free port, got \d+.*operator_ui\.port=0"),
        ("192.0.2.1", 0, "operator_ui.host=127"),
        ("127.0.0.1", 70000, "65535"),
    ],
)
def test_an_address_that_cannot_be_taken_is_told_in_one_line(opened, host, port, told):
    session, server = opened
    with pytest.raises(RigError, match=told) as caught:
        PageServer(session, host, server.port if port is None else port).open()
    assert "\n" not in str(caught.value)


def test_what_to_install_is_told(monkeypatch):
    real = builtins.__import__

    def missing(name, *rest):
        if name == "aiohttp":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(RigError, match=r'pip install "pamid\[pages\]"'):
        PageServer(make_session(), "127.0.0.1", 0).open()


def test_closing_ends_it_and_frees_the_port(opened):
    session, server = opened
    server.close()
    server.close()
    again = PageServer(session, "127.0.0.1", server.port)
    again.open()
    again.close()


def test_scenes_come_whenever_something_changes(opened, begin, turned):
    session, server = opened
    trial = make_trial(session.machine)

    async def talk(participant, operator):
        first = await operator.hear("scene")
        assert (first["phase"], first["trial"]) == ("busy", None)
        begin(session, trial)
        proposed = await operator.hear_phase("proposed")
        await operator.send("decide", word="accept", note="calm", question=proposed["question"])
        for phase, lasts_s in (("countdown", 0.31), ("running", 1.11), ("judging", 0.0)):
            for page in (participant, operator):
                scene = await page.hear_phase(phase)
            turned.sleep(lasts_s)
        return proposed, scene

    proposed, judged = converse(server, talk, "participant", "operator")
    assert proposed["participant_url"] == server.participant_url
    assert proposed["choices"] == ["accept", "skip", "pause"]
    assert np.allclose(proposed["trial"]["reference_rad"], trial.reference_rad[::2], atol=1e-4)
    assert len(judged["outcome"]["tracking_error_rad"]) == 2


def test_the_participant_is_told_no_addresses(opened):
    _, server = opened

    async def talk(participant):
        return await participant.hear("scene")

    assert not any("token" in str(each) for each in converse(server, talk, "participant").values())


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
def test_a_decision_that_does_not_fit_is_refused(begin, role, message, why):
    with shown(needed=["participant"]) as (session, server):

        async def talk(page):
            begin(session)
            assert (await page.hear_phase("proposed"))["question"] == DECIDE["question"]
            await page.send(**message)
            return await page.hear("refused")

        assert why in converse(server, talk, role)["why"]
        assert session.see()["phase"] == "proposed"
        assert not session.see()["automatic"]


STOPS = {
    "participant": ({"kind": "stop", "why": "the strap hurts"}, "the strap hurts"),
    "operator": ({"kind": "stop", "why": "the operator pressed stop"}, "the operator pressed stop"),
    "nonsense": ({"kind": "stop", "why": [1]}, "the participant pressed stop"),
    "closed": (None, "the participant's page was closed"),
}


@pytest.mark.parametrize("way", STOPS)
def test_a_stop_or_a_page_that_is_closed_ends_the_trial_with_its_next_sample(begin, turned, way):
    message, told = STOPS[way]
    with shown(trial_s=5.0, countdown_s=0.0, needed=["participant"]) as (session, server):

        async def talk(participant, operator):
            session.go_on(True)
            study = begin(session)
            await operator.hear_phase("running")
            turned.sleep(0.2)
            await operator.hear("moment", lambda each: each["time_s"] > 0.05)
            pressed_s = turned.now_s()
            page = operator if way == "operator" else participant
            if message:
                await page.send(**message)
                await page.settle()
            else:
                await page.socket.close()
                wait_until(lambda: session.see()["pages"]["participant"] == 0)
            turned.sleep(0.1)
            return study.stopped_s - pressed_s, await operator.hear_phase("judging")

        took_s, scene = converse(server, talk, "participant", "operator")
        assert took_s < 0.011
        assert session.why_stop() == told
        assert scene["outcome"]["stopped"] == f"stopped: {told}"
        assert not scene["automatic"]


def moment_at(time_s):
    return Moment(time_s, np.zeros(2), np.zeros(4), np.zeros(4), np.array([np.nan, 1.0, 2.0, 3.0]))


def test_a_slow_reader_gets_the_newest_sample_and_no_queue(opened):
    session, server = opened
    last = 5 * pages.MOST_ON_THE_WAY

    async def talk(slow, quick):
        for index in range(last + 1):
            session.show(moment_at(float(index)))
            told = await quick.hear("moment")
            assert told["time_s"] == index
        for _ in range(pages.MOST_ON_THE_WAY):
            late = await slow.hear("moment")
        return told, late, await slow.hear("moment")

    told, late, newest = converse(server, talk, "participant", "operator")
    assert told["force_n"] == [None, 1.0, 2.0, 3.0]
    assert newest["time_s"] == last
    assert late["time_s"] < 3 * pages.MOST_ON_THE_WAY


def test_samples_come_no_faster_than_shown(opened):
    session, server = opened
    heard, over = 15, threading.Event()

    def show():
        for index in itertools.takewhile(lambda _: not over.wait(0.001), itertools.count()):
            session.show(moment_at(float(index)))

    async def talk(page):
        begun_s = time.monotonic()
        threading.Thread(target=show).start()
        for _ in range(heard):
            await page.hear("moment")
        over.set()
        return time.monotonic() - begun_s

    assert converse(server, talk, "participant") > (heard - 2) / pages.SENT_HZ


def test_the_clock_is_that_of_the_rig(opened, turned):
    _, server = opened
    turned.sleep(12.5)

    async def talk(page):
        await page.send("clock", page_s=12.5)
        return await page.hear("clock")

    now_s = turned.now_s()
    assert converse(server, talk, "participant") == {"kind": "clock", "page_s": 12.5, "heard_s": now_s, "sent_s": now_s}


MALFORMED = [
    *(
        ("participant", text)
        for text in (
            "",
            "{",
            "[]",
            "[" * 20000,
            '{"kind": "other"}',
            '{"kind": "clock"}',
            '{"kind": "clock", "page_s": NaN}',
            '{"kind": "clock", "page_s": 1' + "0" * 400 + "}",
            '{"kind": "drawn", "frames": 3, "starts_at_s": 0}',
            '{"kind": "drawn", "frames": [[1, 2]], "starts_at_s": 0}',
            '{"kind": "drawn", "frames": [["a", 2, 3]], "starts_at_s": 0}',
            '{"kind": "pointer", "angle_rad": [1]}',
            '{"kind": "pointer", "angle_rad": [1, null]}',
        )
    ),
    ("operator", '{"kind": "decide"}'),
    ("operator", '{"kind": "automatic", "on": 1}'),
    ("operator", '{"kind": "drawn"}'),
    ("operator", '{"kind": "pointer"}'),
    ("operator", b"{}"),
    ("operator", " " * (pages.MOST_BYTES + 1)),
]


@pytest.mark.parametrize(("role", "text"), MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_message_closes_its_page_alone(opened, role, text):
    session, server = opened

    async def talk(bad, good):
        await (bad.socket.send_bytes if isinstance(text, bytes) else bad.socket.send_str)(text)
        code, why = await bad.hear_end()
        wait_until(lambda: session.see()["pages"] == {"participant": 1, "operator": 0})
        await good.settle()
        return code, why

    code, why = converse(server, talk, role, "participant")
    if len(text) > pages.MOST_BYTES:
        assert code == 1009
    else:
        assert code == pages.FORBIDDEN
        assert "expected" in why


def test_the_number_of_open_pages_is_bounded(opened, monkeypatch):
    _, server = opened
    monkeypatch.setattr(pages, "MOST_SOCKETS", 2)

    async def talk(*_):
        with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
            await connect(address(server, "operator", True))

    converse(server, talk, "operator", "operator")


def test_a_page_that_is_silent_stops_the_trial(begin, turned):
    with shown(trial_s=5.0, needed=["participant"], lost_after_s=0.3) as (session, server):

        async def talk(participant):
            session.go_on(True)
            study = begin(session)
            for _ in range(4):
                await participant.send("alive")
                await participant.settle()
                turned.sleep(0.29)
                assert session.why_stop() == ""
            turned.sleep(0.1)
            return study.stopped_s - turned.now_s() + 0.39

        assert 0.3 < converse(server, talk, "participant") < 0.32
        assert "was not heard for 0.3 s" in session.why_stop()


def test_what_was_drawn_becomes_part_of_the_recording(begin, turned):
    with shown(trial_s=0.4) as (session, server):

        async def talk(participant):
            session.go_on(True)
            study = begin(session)
            turned.sleep(0.35)
            starts_at_s = (await participant.hear_phase("running"))["starts_at_s"]
            while (shown_s := turned.now_s()) < starts_at_s + 0.4:
                frames = [[shown_s, shown_s - starts_at_s, None], [shown_s - 60.0, 0.3, 0.3]]
                await participant.send("drawn", starts_at_s=starts_at_s, frames=frames)
                await participant.send("drawn", starts_at_s=starts_at_s - 1.0, frames=[[shown_s, 0.3, 0.3]])
                await participant.settle()
                turned.sleep(0.02)
            turned.join(study)
            return study.ended[0]

        recording = converse(server, talk, "participant")
    late_s = (recording.reference_shown_s - recording.time_s)[:-5]
    assert np.all((late_s >= -0.001) & (late_s < 0.021))
    assert np.isnan(recording.measured_shown_s).all()


def test_a_pointer_is_kept_within_the_joints_limits(opened):
    session, server = opened

    async def talk(participant):
        await participant.send("pointer", angle_rad=[0.3, 99.0])
        await participant.settle()

    converse(server, talk, "participant")
    np.testing.assert_allclose(session.ask_pointer(), [0.3, session.machine.joints[1].upper_rad])


def test_what_is_no_finite_number_becomes_null():
    told = {"a": [1.0, float("nan")], "b": np.float64("inf"), "c": np.array([np.nan, 2.0]), "d": np.int64(3)}
    assert json.loads(encode(told)) == {"a": [1.0, None], "b": None, "c": [None, 2.0], "d": 3}
