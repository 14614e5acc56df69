"""The emulator from a test's side: a process that is started, asked, frozen and killed.

A machine's description flows in; ports, states and faults flow out.
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

from tests.cpx_e.emulation import Asked

ROOT = Path(__file__).resolve().parents[2]
START_S = 60.0
REPLY_S = 5.0


def ask(control: Connection, do: str, **values: Any) -> dict[str, Any]:
    """Send a control request to another process and return its reply; raises RuntimeError where it tells none."""
    control.send({"do": do, **values})
    if not control.poll(REPLY_S):
        raise RuntimeError("the emulator does not answer")
    reply: dict[str, Any] = control.recv()
    if "error" in reply:
        raise RuntimeError(reply["error"])
    return reply


class Emulator(Asked):
    """An emulated CPX-E with its machine, described by plain values, to be used in a ``with`` block."""

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
            if not line:
                raise RuntimeError(f"the emulator did not start within {START_S} s; its message stands above")
            self.port, self.control_port = json.loads(line).values()
            self._control = stack.enter_context(Client(("127.0.0.1", self.control_port)))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    @property
    def pid(self) -> int:
        """Of the process; also the number of its group."""
        return self._process.pid

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a control request and return its reply; raises RuntimeError where that finds fault with it."""
        return ask(self._control, do, **values)

    def freeze(self) -> None:
        """Stop the process."""
        os.kill(self.pid, signal.SIGSTOP)

    def kill(self) -> None:
        """Kill it, frozen or not, and wait for it."""
        self._process.kill()
        with self._process:
            self._process.wait()
