"""The emulator from a test's side: a process that is started, asked, frozen and killed.

A machine's description flows in; ports, states and faults flow out.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

ROOT = Path(__file__).resolve().parents[2]
START_S = 60.0
REPLY_S = 5.0
END_S = 2.0


class Asked:
    """What can be asked of an emulator, in this process or another."""

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a control request and return its reply; raises RuntimeError where that finds fault with it."""
        raise NotImplementedError

    def state(self, log: int = 100) -> dict[str, Any]:
        """Return what the device knows of itself, with the last `log` changes of outputs."""
        return self.ask("state", log=log)

    def trial(
        self,
        kind: str,
        participant: str,
        samples: int,
        lead_samples: int = 0,
        reference_rad: Sequence[Sequence[float]] | None = None,
        seed: int = 0,
    ) -> float:
        """Announce a trial; returns when it began, by the monotonic clock, s."""
        started: float = self.ask(
            "trial",
            kind=kind,
            participant=participant,
            samples=samples,
            lead_samples=lead_samples,
            reference_rad=reference_rad,
            seed=seed,
        )["started_s"]
        return started

    def end(self) -> None:
        """End the trial."""
        self.ask("end")

    def fault(self, name: str, **values: Any) -> None:
        """Ask for a fault; `after_s` and `for_s` say when."""
        self.ask("fault", name=name, **values)

    def mend(self) -> None:
        """End all faults."""
        self.ask("mend")


class Emulator(Asked):
    """An emulated CPX-E with its machine, to be used in a ``with`` block.

    Parameters
    ----------
    machine : mapping
        What MACHINE.json holds, as plain values.
    """

    def __init__(self, machine: Mapping[str, Any]):
        self.machine = dict(machine)
        self.port = 0
        self.control_port = 0
        self._process: subprocess.Popen[str] | None = None
        self._control: socket.socket | None = None
        self._lines: Any = None
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "machine.json"
            path.write_text(json.dumps(self.machine))
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.cpx_e", str(path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                cwd=ROOT,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
                start_new_session=True,
            )
            try:
                ports = self._await_ports()
                self.port, self.control_port = ports["port"], ports["control"]
                self._control = socket.create_connection(("127.0.0.1", self.control_port), timeout=REPLY_S)
                self._lines = self._control.makefile("rw")
            except BaseException:
                self.kill()
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Of the server; also the number of the process group."""
        assert self._process is not None
        return self._process.pid

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a control request and return its reply.

        Raises
        ------
        RuntimeError
            When the emulator finds fault with it, or does not answer.
        """
        with self._lock:
            self._lines.write(json.dumps({"do": do, **values}) + "\n")
            self._lines.flush()
            line = self._lines.readline()
        if not line:
            raise RuntimeError("the emulator has gone")
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise RuntimeError(reply["error"])
        return reply

    def freeze(self) -> None:
        """Stop the whole process group."""
        os.killpg(self.pid, signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        os.killpg(self.pid, signal.SIGCONT)

    def close(self) -> None:
        """End it as it ends by itself, when nobody is there any more; kill what has not ended in a while."""
        if self._process is None:
            return
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(ProcessLookupError):
            self.thaw()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        self.kill()

    def kill(self) -> None:
        """Kill the whole process group, frozen or not, and wait for it."""
        if self._process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for each in (self._process.stdin, self._process.stdout, self._lines, self._control):
            if each is not None:
                with contextlib.suppress(OSError):
                    each.close()
        self._process = None

    def _await_ports(self) -> dict[str, int]:
        assert self._process is not None
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], START_S)
        line = self._process.stdout.readline() if ready else ""
        if not line:
            raise RuntimeError(f"the emulator did not start within {START_S} s; its message stands above")
        ports: dict[str, int] = json.loads(line)
        return ports
