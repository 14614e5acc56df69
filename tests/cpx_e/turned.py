"""The emulator in this process, on the clock that tests turn: still Modbus in bytes on sockets, but nothing waits.

Nothing runs beside the test. The device answers while its client waits for an answer; its watchdog, its faults and the
machine behind it are what is done at their times by whoever turns the clock.
"""

from __future__ import annotations

import json
import select
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import SimpleNamespace, TracebackType
from typing import Any, ClassVar, Self
from unittest.mock import patch

from stages.rig import clock
from tests.cpx_e.control import Control
from tests.cpx_e.device import Device
from tests.cpx_e.emulator import Asked
from tests.cpx_e.faults import Faults
from tests.cpx_e.machine import Machine
from tests.cpx_e.modbus import ModbusServer
from tests.cpx_e.physics import Plant
from tests.cpx_e.shared import Shared
from tests.turned import TurnedClock, turn_clock

PATIENCE_S = 0.05
"""Real time for which a request may be on its way."""
LOOK_S = 0.005
"""Time of the clock after which a client without an answer looks again."""
FROZEN_S = 0.001
"""Time after which a frozen device finds out whether it still is."""


class TurnedEmulator(Asked):
    """An emulated CPX-E with its machine, as `Emulator`, in this process and on a turned clock.

    Parameters
    ----------
    machine : mapping
        What MACHINE.json holds, as plain values.
    turned : TurnedClock
        The current clock.
    """

    serving: ClassVar[list[TurnedEmulator]] = []

    def __init__(self, machine: Mapping[str, Any], turned: TurnedClock):
        self.machine, self.clock = dict(machine), turned
        described = Machine.model_validate(json.loads(json.dumps(self.machine)))
        self.shared = Shared(len(described.exoskeleton.muscles), len(described.exoskeleton.joints))
        self.plant = Plant(described, self.shared)
        self.shared.publish(self.plant.physics.show(self.shared.run_rad_per_s))
        self.faults = Faults(described)
        self.device = Device(described, self.shared, self.faults)
        self.server = ModbusServer(self.device, self.faults, 0)
        self.control = Control(self.device, self.server, self.faults, self.shared, self.plant.announce)
        self.port, self.control_port = self.server.port, self.control.port
        self._frozen = self._gone = False
        self.begun_s = clock.now_s()
        for act in (self.plant.tick, self.device.tend):
            turned.at(clock.now_s(), self._keep_doing(act))

    def __enter__(self) -> Self:
        self.serving.append(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()
        self.serving.remove(self)

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Do what a control request asks for and return its reply; raises RuntimeError where it finds fault with it."""
        self.server.serve_waiting(0.0)
        asked = json.loads(json.dumps({"do": do, **values}))
        try:
            reply: dict[str, Any] = json.loads(json.dumps(self.control.do(asked, clock.now_s())))
        except (ValueError, KeyError, TypeError) as error:
            raise RuntimeError(f"{type(error).__name__}: {error}") from None
        return reply

    def serve(self, patience_s: float = PATIENCE_S) -> bool:
        """Answer a client that asks; return whether one did."""
        return not self._frozen and not self._gone and self.server.serve_waiting(patience_s)

    def freeze(self) -> None:
        """Have it do nothing, though the clock goes on."""
        self._frozen = True

    def thaw(self) -> None:
        """Let it go on."""
        self._frozen = False

    def kill(self) -> None:
        """End it."""
        self._gone = True
        self.server.close()
        self.control.listener.close()

    def _keep_doing(self, act: Callable[[], float]) -> Callable[[], float | None]:
        def keep_doing() -> float | None:
            if self._gone:
                return None
            return FROZEN_S if self._frozen else act()

        return keep_doing


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
