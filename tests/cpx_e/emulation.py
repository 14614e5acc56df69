"""The emulated device with its machine, and what can be asked of it: nothing here waits or has a thread.

Whoever holds it lets its machine tick, tends its device and serves its sockets: a process of its own does so as time
passes, a test's own process whenever it turns the clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stages.science.rig import clock
from tests.cpx_e.device import Device
from tests.cpx_e.machine import Faults, Machine
from tests.cpx_e.modbus import ModbusServer
from tests.cpx_e.physics import Plant


class Emulation:
    """An emulated CPX-E with its machine, described by plain values."""

    def __init__(self, machine: Mapping[str, Any]):
        described, self.faults = Machine.model_validate(dict(machine)), Faults()
        self.plant = Plant(described, self.faults)
        self.device = Device(described, self.plant, self.faults)
        self.server = ModbusServer(self.device, self.faults)

    def do(self, asked: Mapping[str, Any], heard_s: float) -> dict[str, Any]:
        """Do what is asked and return the reply; raises ValueError, KeyError or TypeError."""
        match asked["do"]:
            case "state":
                state = self.device.state()
                last = asked.get("log", 100)
                log = state["log"][-last:] if last else []
                return state | {"now_s": clock.now_s(), "clients": len(self.server.clients), "log": log}
            case "fault":
                self.faults.add({key: value for key, value in asked.items() if key != "do"})
            case "mend":
                self.faults.mend()
            case "trial" | "end":
                self.plant.announce(dict(asked), heard_s)
            case other:
                raise ValueError(f"do: expected state, fault, mend, trial or end, got {other!r}")
        return {"started_s": heard_s}


class Asked:
    """What can be asked of an emulator, in this process or another."""

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """Send a control request and return its reply."""
        raise NotImplementedError

    def state(self, log: int = 100) -> dict[str, Any]:
        """Return what the device knows of itself, with the last `log` changes of outputs."""
        return self.ask("state", log=log)

    def trial(self, **told: Any) -> float:
        """Announce a trial, as a display would show it to a person; return when it began, by the rig's clock, s."""
        started: float = self.ask("trial", **told)["started_s"]
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
