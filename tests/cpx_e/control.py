"""The control connection: JSON lines in, one reply each.

Trials are announced here as a display would show them to a person; tests ask for the state and for faults.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from stages.rig import clock
from tests.cpx_e.device import Device
from tests.cpx_e.faults import Faults
from tests.cpx_e.modbus import ModbusServer
from tests.cpx_e.shared import Shared

Announce = Callable[[dict[str, Any]], None]


class Control:
    """Answers control requests.

    Parameters
    ----------
    device, server, faults, shared
        What can be asked for and changed.
    announce : callable
        Takes a trial to the plant, and returns once it has begun.
    """

    def __init__(self, device: Device, server: ModbusServer, faults: Faults, shared: Shared, announce: Announce):
        self.device, self.server, self.faults, self.shared = device, server, faults, shared
        self.announce = announce
        self.lock = threading.Lock()
        self.trial = False
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            client, _ = self.listener.accept()
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client, client.makefile("rw") as lines:
            for line in lines:
                heard_s = clock.now_s()
                try:
                    reply = self.do(json.loads(line), heard_s)
                except (ValueError, KeyError, TypeError) as error:
                    reply = {"error": f"{type(error).__name__}: {error}"}
                try:
                    lines.write(json.dumps(reply) + "\n")
                    lines.flush()
                except OSError:
                    return

    def do(self, asked: dict[str, Any], heard_s: float) -> dict[str, Any]:
        """Do what is asked and return the reply; raises ValueError, KeyError or TypeError."""
        match asked.get("do"):
            case "state":
                return self._tell(asked.get("log", 100))
            case "fault":
                self.faults.add(asked)
                return {"ok": True}
            case "mend":
                self.faults.mend()
                return {"ok": True}
            case "trial" | "end":
                self._check_trial(asked)
                with self.lock:
                    self.announce(asked | {"heard_s": heard_s})
                self.trial = asked["do"] == "trial"
                return {"ok": True, "started_s": heard_s}
        raise ValueError(f"do: expected state, fault, mend, trial or end, got {asked.get('do')!r}")

    def _check_trial(self, asked: dict[str, Any]) -> None:
        if asked["do"] == "end":
            return
        machine = self.device.machine
        if asked["kind"] not in ("tracked", "free", "passive"):
            raise ValueError(f"kind: expected tracked, free or passive, got {asked['kind']!r}")
        samples, lead = int(asked["samples"]), int(asked["lead_samples"])
        if samples < 2 or lead < 0:
            raise ValueError(f"expected samples > 1 and lead_samples >= 0, got {samples} and {lead}")
        if asked["kind"] != "passive" and asked["participant"] not in (*machine.participants, "experimenter"):
            raise ValueError(f"no participant {asked['participant']!r}")
        shown = asked.get("reference_rad")
        if (shown is None) == (asked["kind"] == "tracked"):
            raise ValueError(f"a {asked['kind']} trial with{'out' if shown is None else ''} reference_rad")
        shape = (samples, len(machine.exoskeleton.joints))
        if shown is not None and np.shape(shown) != shape:
            raise ValueError(f"reference_rad: expected shape {shape}, got {np.shape(shown)}")

    def _tell(self, last: int) -> dict[str, Any]:
        state = self.device.state()
        ticks = int(self.shared.ticks[0])
        cost = dict(zip(("last", "largest", "sum"), self.shared.costs_s.tolist(), strict=True))
        return {
            "now_s": clock.now_s(),
            "clients": len(self.server.clients),
            "trial": self.trial,
            "muscles": self.device.machine.exoskeleton.muscle_names,
            **state,
            "log": state["log"][-last:] if last else [],
            "ticks": ticks,
            "tick_cost_s": cost,
        }
