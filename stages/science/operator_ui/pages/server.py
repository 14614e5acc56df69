"""A server of two pages: one shows a participant what to follow, the other lets an operator decide.

Scenes and the newest sample flow from an `OperatorSession` to the pages; decisions, stops, what was drawn and where a
pointer is flow back to it. The server runs in a thread of its own, on this computer only unless configured otherwise.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import itertools
import json
import math
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from stages.science.operator_ui.operator_session import ROLES, Frame, OperatorSession, Refused
from stages.science.rig import clock
from stages.science.rig.attendance import Moment
from stages.science.rig.contract import RigError

if TYPE_CHECKING:
    from aiohttp import web

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
    """Shows the pages of an operator session.

    Parameters
    ----------
    session : OperatorSession
        Whose scenes are shown.
    host : str
        Address at which pages are shown; ``127.0.0.1`` keeps them to this computer.
    port : int
        Port; 0 takes any free one.
    """

    def __init__(self, session: OperatorSession, host: str, port: int):
        self.session, self.host, self.port = session, host, port
        self._tokens = {role: secrets.token_urlsafe(24) for role in ROLES}
        self._files: dict[str, bytes] = {}
        self._keys = itertools.count()
        self._sockets: set[Socket] = set()
        self._told: dict[str, tuple[int, str]] = {}
        self._encoded: dict[str, tuple[Any, str]] = {}
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing: asyncio.Event | None = None

    @property
    def participant_url(self) -> str:
        """Address of the participant's page, with what opens it."""
        return self._address("participant")

    @property
    def operator_url(self) -> str:
        """Address of the operator's page, with what opens it."""
        return self._address("operator")

    def open(self) -> None:
        """Show the pages.

        Raises
        ------
        RigError
            When aiohttp is not installed, or the address cannot be taken.
        """
        if self._thread is not None:
            return
        try:
            import aiohttp  # noqa: F401 (told here rather than by a thread)
        except ImportError as error:
            raise RigError('pages need aiohttp, which is not installed; pip install "pamid[pages]"') from error
        self._files = {
            each.name: each.read_bytes() for each in files(__package__).iterdir() if _end(each.name) in TYPES
        }
        listening = _listen(self.host, self.port)
        self.port = listening.getsockname()[1]
        opened = threading.Event()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(listening, opened)), name="pages", daemon=True
        )
        self._thread.start()
        if not opened.wait(10.0):
            raise RigError(f"operator_ui: expected pages at {self.host}:{self.port} within 10 s, got none")

    def close(self) -> None:
        """Show them no longer; harmless when not open."""
        thread, self._thread = self._thread, None
        if thread is None or self._loop is None or self._closing is None:
            return
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._closing.set)
        thread.join(5.0)

    def _address(self, role: str) -> str:
        host = self.host
        if _is(host, "is_unspecified"):
            host = _find_own_address()
        return f"http://{_in_url(host)}:{self.port}/{role}?token={quote(self._tokens[role])}"

    # requests

    async def _serve(self, listening: socket.socket, opened: threading.Event) -> None:
        from aiohttp import web

        @web.middleware
        async def guard(
            request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
        ) -> web.StreamResponse:
            self._check(request)
            return await handler(request)

        async def protect(request: web.Request, response: web.StreamResponse) -> None:
            response.headers.update(HEADERS)
            with contextlib.suppress(web.HTTPException):
                self._check(request)
                response.headers["Content-Security-Policy"] = RULES.format(host=request.headers["Host"])

        app = web.Application(middlewares=[guard])
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
        from aiohttp import web

        if request.method != "GET":
            raise web.HTTPMethodNotAllowed(request.method, ["GET"], text="expected GET\n")
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
        from aiohttp import web

        given = request.query.get("token", "")
        if not secrets.compare_digest(given.encode(), self._tokens[role].encode()):
            raise web.HTTPForbidden(
                text=f"the {role}'s page opens at the address that the program printed when it began\n"
            )

    async def _send_file(self, request: web.Request) -> web.Response:
        from aiohttp import web

        name = request.match_info["name"]
        if name in ROLES:
            self._check_token(request, name)
            name = f"{name}.html"
        elif name not in self._files or name.endswith(".html"):
            raise web.HTTPNotFound(text="nothing is here; open the address that the program printed\n")
        return web.Response(body=self._files[name], content_type=TYPES[_end(name)], charset="utf-8")

    # sockets

    async def _attend(self, request: web.Request) -> web.StreamResponse:
        """Serve one page until it is closed."""
        from aiohttp import WSMsgType, web

        role = request.match_info["role"]
        if role not in ROLES:
            raise web.HTTPNotFound(text="nothing is here; open the address that the program printed\n")
        self._check_token(request, role)
        if sum(each.role == role for each in self._sockets) >= MOST_SOCKETS:
            raise web.HTTPServiceUnavailable(
                text=f"expected at most {MOST_SOCKETS} open pages of the {role}; close one\n"
            )
        connection = web.WebSocketResponse(max_msg_size=MOST_BYTES, heartbeat=DEAD_AFTER_S, compress=False, timeout=1.0)
        await connection.prepare(request)
        key, page = next(self._keys), Socket(role, connection)
        self._sockets.add(page)
        self.session.join(key, role)
        telling = asyncio.create_task(self._tell(page))
        problem = ""
        try:
            async for message in connection:
                self.session.join(key, role)
                if message.type is not WSMsgType.TEXT:
                    raise Malformed("expected text")
                self._hear(page, message.data)
        except Malformed as error:
            problem = str(error)
        finally:
            self.session.leave(key)
            self._sockets.discard(page)
            telling.cancel()
        if problem:
            await connection.close(code=FORBIDDEN, message=problem.encode()[:120])
        return connection

    async def _tell(self, page: Socket) -> None:
        """Tell a page what is to be seen; each turn tells the newest, and none waits in a queue."""
        try:
            with contextlib.suppress(ConnectionError):
                await self._tell_newest(page)
        except Exception:
            await page.connection.close(code=FAILED, message=b"the program failed to tell what is to be seen")
            raise

    async def _tell_newest(self, page: Socket) -> None:
        number, moment, asked_s, due_s = -1, None, -math.inf, time.monotonic()
        while not page.connection.closed:
            while page.answers:
                answer = page.answers.popleft()
                if answer["kind"] == "clock":
                    answer["sent_s"] = clock.now_s()
                await page.connection.send_str(encode(answer))
            if self.session.number != number:
                number, scene = self._tell_scene(page.role)
                await page.connection.send_str(scene)
            newest = self.session.moment
            if newest is not moment and page.on_the_way < MOST_ON_THE_WAY:
                moment = newest
                if newest is not None:
                    page.on_the_way += 1
                    await page.connection.send_str(encode(describe_moment(newest)))
            if time.monotonic() - asked_s >= BEAT_S:
                asked_s = time.monotonic()
                await page.connection.send_str('{"kind":"beat"}')
            due_s = max(due_s + 1.0 / SENT_HZ, time.monotonic())
            await asyncio.sleep(due_s - time.monotonic())

    def _tell_scene(self, role: str) -> tuple[int, str]:
        """Return the scene's number and text; what is long in it is written once, as a rig waits for no page."""
        told = self._told.get(role)
        if told is not None and told[0] == self.session.number:
            return told
        scene = {"kind": "scene", **self.session.see()}
        if role == "operator":
            scene["participant_url"] = self.participant_url
        parts = []
        for name, value in scene.items():
            if not isinstance(value, dict):
                text = encode(value)
            elif (known := self._encoded.get(name)) is not None and known[0] is value:
                text = known[1]
            else:
                text = encode(value)
                self._encoded[name] = value, text
            parts.append(f'"{name}":{text}')
        self._told[role] = scene["number"], "{" + ",".join(parts) + "}"
        return self._told[role]

    def _hear(self, page: Socket, text: str) -> None:
        """Take a message of a page.

        Raises
        ------
        Malformed
            When no page sends such a message.
        """
        message = _read(text)
        kind = message.get("kind")
        if kind == "stop":
            why = message.get("why")
            told = why.strip()[:MOST_CHARACTERS] if isinstance(why, str) else ""
            self.session.stop(told or f"the {page.role} pressed stop")
        elif kind == "alive":
            pass
        elif kind == "seen":
            page.on_the_way = max(page.on_the_way - 1, 0)
        elif kind == "clock":
            page.answers.append({"kind": "clock", "page_s": _number(message.get("page_s")), "heard_s": clock.now_s()})
        elif kind in ("decide", "automatic"):
            self._decide(page, message)
        elif kind in ("drawn", "pointer"):
            if page.role != "participant":
                raise Malformed(f"{kind}: expected from the participant's page")
            if kind == "drawn":
                self._draw(message)
            else:
                self._point(message)
        else:
            raise Malformed("expected a kind of message that these pages send")

    def _decide(self, page: Socket, message: dict[str, Any]) -> None:
        if page.role != "operator":
            page.answers.append({"kind": "refused", "why": "only the operator's page decides"})
            return
        if message["kind"] == "automatic":
            if not isinstance(message.get("on"), bool):
                raise Malformed("automatic: expected on as true or false")
            self.session.go_on(message["on"])
            return
        word, note, question = message.get("word"), message.get("note", ""), message.get("question")
        if not isinstance(word, str) or not isinstance(note, str) or type(question) is not int:
            raise Malformed("decide: expected word and note as text, question as a number")
        if len(note) > MOST_CHARACTERS:
            why = f"a note has at most {MOST_CHARACTERS} characters, got {len(note)}"
            page.answers.append({"kind": "refused", "why": why})
            return
        try:
            self.session.decide(word[:MOST_CHARACTERS], note, question)
        except Refused as error:
            page.answers.append({"kind": "refused", "why": str(error)})

    def _draw(self, message: dict[str, Any]) -> None:
        drawn = message.get("frames")
        if not isinstance(drawn, list) or len(drawn) > MOST_FRAMES:
            raise Malformed(f"drawn: expected at most {MOST_FRAMES} frames")
        if any(not isinstance(each, list) or len(each) != 3 for each in drawn):
            raise Malformed("drawn: expected three times for each frame")
        now_s = clock.now_s()
        frames = [
            Frame(_number(shown_s), *(math.nan if each is None else _number(each) for each in times))
            for shown_s, *times in drawn
        ]
        near = [each for each in frames if abs(each.shown_s - now_s) < MOST_OFF_S]
        self.session.draw(near, _number(message.get("starts_at_s")))

    def _point(self, message: dict[str, Any]) -> None:
        joints = self.session.see()["machine"].get("joints", [])
        angles = message.get("angle_rad")
        if not isinstance(angles, list) or len(angles) != len(joints):
            raise Malformed(f"pointer: expected {len(joints)} angles")
        low, high = ([each[end] for each in joints] for end in ("lower_rad", "upper_rad"))
        self.session.point(np.clip(np.array([_number(each) for each in angles]), low, high))


def describe_moment(moment: Moment) -> dict[str, Any]:
    """Return what a page is told of a sample."""
    return {
        "kind": "moment",
        "time_s": round(float(moment.time_s), 5),
        **{name: np.round(getattr(moment, name), 5).tolist() for name in Moment._fields[1:]},
    }


def encode(value: Any) -> str:
    """Return a value as JSON that browsers read, with null for what is not a finite number."""
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"), default=_plain)
    except ValueError:
        return json.dumps(_without_gaps(value), allow_nan=False, separators=(",", ":"), default=_plain)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _without_gaps(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_gaps(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_gaps(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _without_gaps(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _read(text: str) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise Malformed("expected a JSON object")
    return message


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not -1e12 < value < 1e12:
        raise Malformed("expected a finite number")
    return float(value)


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens."""
    if not 0 <= port <= 65535:
        raise RigError(f"operator_ui.port: expected 0 to 65535, got {port}; type operator_ui.port=0 for any free one")
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        told = error.strerror or error
        if error.errno == errno.EADDRINUSE:
            raise RigError(
                f"operator_ui.port: expected a free port, got {port}, which another program uses; "
                "type operator_ui.port=0 for any free one"
            ) from error
        if error.errno == errno.EACCES:
            raise RigError(
                f"operator_ui.port: expected a port that this user may take, got {port} ({told}); "
                "type operator_ui.port=0 for any free one"
            ) from error
        raise RigError(
            f"operator_ui.host: expected an address of this computer, got {host} ({told}); "
            "type operator_ui.host=127.0.0.1"
        ) from error


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


def _end(name: str) -> str:
    return name.rpartition(".")[2]


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
