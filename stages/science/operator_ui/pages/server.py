"""A server of two pages: one shows a participant what to follow, the other lets an operator decide.

Scenes and the newest sample flow from an `OperatorSession` to the pages; decisions, stops, what was drawn and where a
pointer is flow back to it. The server runs in a thread of its own, on this computer only unless configured otherwise.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import json
import math
import secrets
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from typing import Any
from urllib.parse import quote

import numpy as np

from stages.science.operator_ui.operator_session import ROLES, OperatorSession, Refused
from stages.science.rig import clock
from stages.science.rig.contract import RigError

try:
    from aiohttp import WSMsgType, web
except ImportError:  # told when pages are opened
    web = None  # type: ignore[assignment]

TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
SENT_HZ = 60.0
"""Rate at which pages are told the newest sample."""
BEAT_S = 0.2
"""Time after which a page is asked whether it is there, s."""
DEAD_AFTER_S = 6.0
"""Time after which a connection that answers nothing is closed, s."""
MOST_BYTES = 65_536
"""Of a message from a page."""
MOST_FRAMES = 1000
"""Frames in a message from a page."""
MOST_CHARACTERS = 2000
"""Of what somebody writes."""
MOST_SOCKETS = 16
"""Of a role, open at once."""
MOST_ON_THE_WAY = 4
"""Samples sent to a page before it says that it has them; beyond that it gets the newest one later."""
MOST_OFF_S = 5.0
"""How far a frame's time may be off this computer's clock, s."""
FORBIDDEN, ENDED, FAILED = 1008, 1001, 1011
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
RULES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self' ws://{host}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Malformed(Exception):
    """A page sent what no page of this server sends."""


@dataclass(eq=False)
class Socket:
    """A connection to a page."""

    role: str
    connection: web.WebSocketResponse
    answers: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=8))
    on_the_way: int = 0


class PageServer:
    """Shows the pages of an operator session at a host, ``127.0.0.1`` here alone, and a port, 0 for any."""

    def __init__(self, session: OperatorSession, host: str, port: int):
        self.session, self.host, self.port = session, host, port
        self._tokens = {role: secrets.token_urlsafe(24) for role in ROLES}
        self._files: dict[str, bytes] = {}
        self._sockets: set[Socket] = set()
        self._encoded: dict[str, tuple[Any, str]] = {}
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing: asyncio.Event | None = None

    def address(self, role: str) -> str:
        """Return the address of a role's page, with what opens it."""
        host = _find_own_address() if _is(self.host, "is_unspecified") else self.host
        return f"http://{_in_url(host)}:{self.port}/{role}?token={quote(self._tokens[role])}"

    def open(self) -> None:
        """Show the pages, or raise `RigError` where aiohttp is not installed, or the address cannot be taken."""
        if web is None:
            raise RigError('pages need aiohttp, which is not installed; pip install "pamid[pages]"')
        self._files = {each.name: each.read_bytes() for each in files(__package__).iterdir() if _type(each.name)}
        listening = _listen(self.host, self.port)
        self.port = listening.getsockname()[1]
        opened = threading.Event()
        serving = self._serve(listening, opened)
        self._thread = threading.Thread(target=asyncio.run, args=(serving,), name="pages", daemon=True)
        self._thread.start()
        if not opened.wait(10.0):
            raise RigError(f"operator_ui: expected pages at {self.host}:{self.port} within 10 s, got none")

    def close(self) -> None:
        """Show them no longer; harmless when not open."""
        thread, self._thread = self._thread, None
        if thread and self._loop and self._closing:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._closing.set)
            thread.join(5.0)

    # requests

    async def _serve(self, listening: socket.socket, opened: threading.Event) -> None:
        async def protect(request: web.Request, response: web.StreamResponse) -> None:
            response.headers.update(HEADERS)
            with contextlib.suppress(web.HTTPException):
                self._check(request)
                response.headers["Content-Security-Policy"] = RULES.format(host=request.headers["Host"])

        app = web.Application()
        app.on_response_prepare.append(protect)
        app.router.add_get("/ws/{role}", self._attend, allow_head=False)
        app.router.add_get("/{name}", self._send_file, allow_head=False)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        self._loop, self._closing = asyncio.get_running_loop(), asyncio.Event()
        await runner.setup()
        await web.SockSite(runner, listening).start()
        opened.set()
        await self._closing.wait()
        ends = [each.connection.close(code=ENDED, message=b"the program ended") for each in list(self._sockets)]
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.gather(*ends, return_exceptions=True), 0.5)
        await runner.cleanup()

    def _check(self, request: web.Request) -> None:
        """Refuse what another site asks for, under whatever name it reaches this computer."""
        here = request.transport.get_extra_info("sockname")[0] if request.transport else ""
        names = {here, *([] if _is(self.host, "is_unspecified") else [self.host])}
        if _is(here, "is_loopback"):
            names.add("localhost")
        hosts = {f"{_in_url(each)}:{self.port}".lower() for each in names}
        host = request.headers.get("Host", "").lower()
        if host not in hosts and not (self.port == 80 and f"{host}:80" in hosts):
            raise web.HTTPForbidden(text="expected the address that the program printed, got another host's name\n")
        if request.headers.get("Origin", f"http://{host}").lower() != f"http://{host}":
            raise web.HTTPForbidden(text="expected a request of these pages themselves, got one of another site\n")

    def _check_token(self, request: web.Request, role: str) -> None:
        if not secrets.compare_digest(request.query.get("token", "").encode(), self._tokens[role].encode()):
            told = f"the {role}'s page opens at the address that the program printed when it began\n"
            raise web.HTTPForbidden(text=told)

    async def _send_file(self, request: web.Request) -> web.Response:
        self._check(request)
        name = request.match_info["name"]
        if name in ROLES:
            self._check_token(request, name)
            name = f"{name}.html"
        elif name not in self._files or name.endswith(".html"):
            raise web.HTTPNotFound(text="nothing is here; open the address that the program printed\n")
        return web.Response(body=self._files[name], content_type=_type(name), charset="utf-8")

    # sockets

    async def _attend(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until it is closed."""
        self._check(request)
        role = request.match_info["role"]
        if role not in ROLES:
            raise web.HTTPNotFound(text="nothing is here; open the address that the program printed\n")
        self._check_token(request, role)
        if sum(each.role == role for each in self._sockets) >= MOST_SOCKETS:
            told = f"expected at most {MOST_SOCKETS} open pages of the {role}; close one\n"
            raise web.HTTPServiceUnavailable(text=told)
        connection = web.WebSocketResponse(max_msg_size=MOST_BYTES, heartbeat=DEAD_AFTER_S, compress=False, timeout=1.0)
        await connection.prepare(request)
        page = Socket(role, connection)
        self._sockets.add(page)
        self.session.join(id(page), role)
        telling = asyncio.create_task(self._tell(page))
        problem = ""
        try:
            async for message in connection:
                self.session.join(id(page), role)
                if message.type is not WSMsgType.TEXT:
                    raise Malformed("expected text")
                self._hear(page, message.data)
        except Malformed as error:
            problem = str(error)
        finally:
            self.session.leave(id(page))
            self._sockets.discard(page)
            telling.cancel()
        if problem:
            await connection.close(code=FORBIDDEN, message=problem.encode()[:120])
        return connection

    async def _tell(self, page: Socket) -> None:
        """Tell a page the newest of what is to be seen in each turn until it is closed, so that nothing is queued."""
        number, moment, asked_s, due_s = -1, None, -math.inf, time.monotonic()
        try:
            while not page.connection.closed:
                while page.answers:
                    answer = page.answers.popleft()
                    if answer["kind"] == "clock":
                        answer["sent_s"] = clock.now_s()
                    await page.connection.send_str(_encode(answer))
                if self.session.number != number:
                    number, scene = self._tell_scene(page.role)
                    await page.connection.send_str(scene)
                newest = self.session.moment
                if newest is not moment and page.on_the_way < MOST_ON_THE_WAY:
                    moment = newest
                    if newest is not None:
                        page.on_the_way += 1
                        told = {name: np.round(value, 5).tolist() for name, value in newest._asdict().items()}
                        await page.connection.send_str(_encode({"kind": "moment", **told}))
                if time.monotonic() - asked_s >= BEAT_S:
                    asked_s = time.monotonic()
                    await page.connection.send_str('{"kind":"beat"}')
                due_s = max(due_s + 1.0 / SENT_HZ, time.monotonic())
                await asyncio.sleep(due_s - time.monotonic())
        except ConnectionError:
            pass
        except Exception:
            await page.connection.close(code=FAILED, message=b"the program failed to tell what is to be seen")
            raise

    def _tell_scene(self, role: str) -> tuple[int, str]:
        """Return the scene's number and text; what is long in it is written once, as a rig waits for no page."""
        scene = {"kind": "scene", **self.session.see()}
        if role == "operator":
            scene["participant_url"] = self.address("participant")
        parts = []
        for name, value in scene.items():
            known, text = self._encoded.get(name, (None, ""))
            if not isinstance(value, dict) or known is not value:
                text = _encode(value)
                self._encoded[name] = value, text
            parts.append(f'"{name}":{text}')
        return scene["number"], "{" + ",".join(parts) + "}"

    def _hear(self, page: Socket, text: str) -> None:
        """Take a message of a page, or raise `Malformed` where no page sends such a one."""
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            raise Malformed("expected a JSON object")
        kind, why = message.get("kind"), message.get("why")
        if kind == "stop":
            told = why.strip()[:MOST_CHARACTERS] if isinstance(why, str) else ""
            self.session.stop(told or f"the {page.role} pressed stop")
        elif kind == "seen":
            page.on_the_way = max(page.on_the_way - 1, 0)
        elif kind == "clock":
            page.answers.append({"kind": "clock", "page_s": _number(message.get("page_s")), "heard_s": clock.now_s()})
        elif kind in ("decide", "automatic"):
            try:
                self._decide(page.role, message)
            except Refused as error:
                page.answers.append({"kind": "refused", "why": str(error)})
        elif kind == "drawn" and page.role == "participant":
            self._draw(message)
        elif kind == "pointer" and page.role == "participant":
            joints = self.session.see()["machine"].get("joints", [])
            angles = message.get("angle_rad")
            if not isinstance(angles, list) or len(angles) != len(joints):
                raise Malformed(f"pointer: expected {len(joints)} angles")
            low, high = ([each[end] for each in joints] for end in ("lower_rad", "upper_rad"))
            self.session.point(np.clip(np.array([*map(_number, angles)]), low, high))
        elif kind != "alive":
            raise Malformed("expected a kind of message that these pages send")

    def _decide(self, role: str, message: dict[str, Any]) -> None:
        if role != "operator":
            raise Refused("only the operator's page decides")
        if message["kind"] == "automatic":
            if not isinstance(message.get("on"), bool):
                raise Malformed("automatic: expected on as true or false")
            self.session.go_on(message["on"])
            return
        word, note, question = message.get("word"), message.get("note", ""), message.get("question")
        if not isinstance(word, str) or not isinstance(note, str) or type(question) is not int:
            raise Malformed("decide: expected word and note as text, question as a number")
        if len(note) > MOST_CHARACTERS:
            raise Refused(f"a note has at most {MOST_CHARACTERS} characters, got {len(note)}")
        self.session.decide(word[:MOST_CHARACTERS], note, question)

    def _draw(self, message: dict[str, Any]) -> None:
        drawn = message.get("frames")
        if not isinstance(drawn, list) or len(drawn) > MOST_FRAMES:
            raise Malformed(f"drawn: expected at most {MOST_FRAMES} frames")
        if any(not isinstance(each, list) or len(each) != 3 for each in drawn):
            raise Malformed("drawn: expected three times for each frame")
        frames = [
            (_number(shown_s), *(math.nan if each is None else _number(each) for each in times))
            for shown_s, *times in drawn
        ]
        near = [each for each in frames if abs(each[0] - clock.now_s()) < MOST_OFF_S]
        self.session.draw(near, _number(message.get("starts_at_s")))


def _encode(value: Any) -> str:
    """Return a value as JSON that browsers read, with null for what is not a finite number."""
    write = partial(json.dumps, separators=(",", ":"), default=lambda each: each.tolist())
    try:
        return write(value, allow_nan=False)
    except ValueError:
        return write(json.loads(write(value), parse_constant=lambda _: None))


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not -1e12 < value < 1e12:
        raise Malformed("expected a finite number")
    return float(value)


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        expected = f"host: expected an address of this computer, got {host}"
        remedy = "host=127.0.0.1"
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            which = "free port" if error.errno == errno.EADDRINUSE else "port that this user may take"
            expected, remedy = f"port: expected a {which}, got {port}", "port=0 for any free one"
        raise RigError(f"operator_ui.{expected} ({error.strerror or error}); type operator_ui.{remedy}") from error


def _find_own_address() -> str:
    """Return the address at which others reach this computer; asking for a way there sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(("10.255.255.255", 1))
            return str(asking.getsockname()[0])
        except OSError:
            return "127.0.0.1"


def _is(host: str, what: str) -> bool:
    try:
        return bool(getattr(ipaddress.ip_address(host), what))
    except ValueError:
        return False


def _type(name: str) -> str | None:
    return TYPES.get(name.rpartition(".")[2])


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
