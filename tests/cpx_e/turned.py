"""The emulator in this process, on the clock that tests turn: still Modbus in bytes on sockets, but nothing waits.

Nothing runs beside the test. The device answers while its client waits for an answer; its watchdog, its faults and the
machine behind it are what is done at their times by whoever turns the clock.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar, Self
from unittest.mock import patch

from stages.science.rig import clock
from tests.cpx_e.emulator import Asked, Emulation
from tests.turned import TurnedClock, turn_clock

PATIENCE_S = 0.05
"""Real time for which a request may be on its way."""
LOOK_S = 0.005
"""Time of the clock after which a client without an answer looks again."""
FROZEN_S = 0.001
"""Time after which a frozen device finds out whether it still is."""


class TurnedEmulator(Asked):
    """An emulated CPX-E with its machine, as `Emulator`, in this process and on the current clock, a turned one."""

    serving: ClassVar[list[TurnedEmulator]] = []

    def __init__(self, machine: Mapping[str, Any], turned: TurnedClock):
        self.machine, self.clock = dict(machine), turned
        self.emulation = Emulation(self.machine)
        self.port = self.control_port = self.emulation.server.port
        self._frozen = self._gone = False
        self.begun_s = clock.now_s()
        for act in (self.emulation.plant.tick, self.emulation.device.tend):
            turned.at(self.begun_s, partial(self._keep_doing, act))

    def __enter__(self) -> Self:
        self.serving.append(self)
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        self.serving.remove(self)

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        self.serve(0.0)
        return self.emulation.do({"do": do, **values}, clock.now_s())

    def serve(self, patience_s: float) -> bool:
        """Answer a client that asks; return whether one did."""
        sockets = [] if self._frozen or self._gone else self.emulation.server.list_sockets()
        ready = select.select(sockets, [], [], patience_s)[0] if sockets else []
        self.emulation.server.serve(ready)
        return bool(ready)

    def freeze(self, frozen: bool = True) -> None:
        """Have it do nothing, though the clock goes on, or let it go on."""
        self._frozen = frozen

    def kill(self) -> None:
        self._gone = True
        self.emulation.server.close()

    def _keep_doing(self, act: Callable[[], float]) -> float | None:
        if self._gone:
            return None
        return FROZEN_S if self._frozen else act()


def _select(read: Sequence[socket.socket], write: Any, error: Any, timeout_s: float) -> Any:
    """Wait for an answer on the clock that is turned."""
    end_s, patience_s = clock.now_s() + timeout_s, PATIENCE_S
    while True:
        asked = any(each.serve(patience_s) for each in TurnedEmulator.serving)
        ready = select.select(read, write, error, 0.0)
        if ready[0] or clock.now_s() >= end_s:
            return ready
        if not asked:
            patience_s = 0.0
            clock.sleep(min(LOOK_S, end_s - clock.now_s()))


def _connect(*place: Any, **more: Any) -> socket.socket:
    for each in TurnedEmulator.serving:
        each.serve(0.0)
    return socket.create_connection(*place, **more)


@contextmanager
def emulate(machine: Mapping[str, Any]) -> Iterator[TurnedEmulator]:
    """Go by a clock that is turned, with an emulated device on it for whose answers clients of Modbus wait by it."""
    waiting = patch.multiple(
        "pymodbus.client.tcp",
        select=SimpleNamespace(select=_select),
        time=SimpleNamespace(time=clock.now_s),
        socket=SimpleNamespace(create_connection=_connect),
    )
    with turn_clock() as turned, waiting, TurnedEmulator(machine, turned) as emulator:
        yield emulator
