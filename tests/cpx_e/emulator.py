"""The emulated device with its machine, and what can be asked of it; in a process of its own, also frozen and killed.

A machine's description flows in; ports, states and faults flow out. An `Emulation` does not wait and has no thread:
whoever holds it lets its machine tick, tends its device and serves its sockets.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Mapping
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import Any, Self

from tests.cpx_e.device import Device
from tests.cpx_e.machine import Faults, Machine
from tests.cpx_e.modbus import ModbusServer
from tests.cpx_e.physics import Plant

ROOT = Path(__file__).resolve().parents[2]
START_S = 60.0
REPLY_S = 5.0


class Emulation:
    """An emulated CPX-E with its machine, described by plain values."""

    def __init__(self, machine: Mapping[str, Any]):
        described, self.faults = Machine.model_validate(dict(machine)), Faults()
        self.plant = Plant(described, self.faults)
        self.device = Device(described, self.plant, self.faults)
        self.server = ModbusServer(self.device, self.faults)

    def do(self, asked: Mapping[str, Any], heard_s: float) -> dict[str, Any]:
        """Do what is asked and return the reply."""
        match asked["do"]:
            case "state":
                return self.device.state(asked["log"])
            case "fault":
                self.faults.add({key: value for key, value in asked.items() if key != "do"})
            case "mend":
                self.faults.mend()
            case "trial" | "end":
                self.plant.announce(dict(asked), heard_s)
        return {}


class Asked:
    """What can be asked of an emulator, in this process or another."""

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a control request and return its reply."""
        raise NotImplementedError

    def state(self, log: int = 100) -> dict[str, Any]:
        """Return what the device knows of itself, with the last `log` changes of outputs."""
        return self.ask("state", log=log)

    def fault(self, name: str, **values: Any) -> None:
        """Ask for a fault; `after_s` and `for_s` say when."""
        self.ask("fault", name=name, **values)


def ask(control: Connection, do: str, **values: Any) -> dict[str, Any]:
    """Send a control request to another process and return its reply."""
    control.send({"do": do, **values})
    assert control.poll(REPLY_S), "the emulator does not answer"
    reply: dict[str, Any] = control.recv()
    return reply


class Emulator(Asked):
    """An emulated CPX-E in a process of its own, to be used in a ``with`` block."""

    def __init__(self, machine: Mapping[str, Any]):
        self.machine = dict(machine)

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.cpx_e", json.dumps(self.machine)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            start_new_session=True,
        )
        with contextlib.ExitStack() as stack:
            stack.callback(self.kill)
            assert self._process.stdout is not None
            ready, _, _ = select.select([self._process.stdout], [], [], START_S)
            line = self._process.stdout.readline() if ready else ""
            assert line, f"the emulator did not start within {START_S} s; its message stands above"
            self.port, self.control_port = json.loads(line).values()
            self._control = stack.enter_context(Client(("127.0.0.1", self.control_port)))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        return ask(self._control, do, **values)

    def freeze(self) -> None:
        self._process.send_signal(signal.SIGSTOP)

    def kill(self) -> None:
        """Kill it, frozen or not, and wait for it."""
        self._process.kill()
        with self._process:
            self._process.wait()
