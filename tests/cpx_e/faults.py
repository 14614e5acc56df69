"""Faults that tests ask for, and when they begin and end.

Requests of the control connection flow in; what is wrong now flows out.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from stages.rig import clock
from tests.cpx_e.machine import Machine

FIELDS = {
    "cut": set(),
    "garbage": {"variant"},
    "silent": set(),
    "refuse": set(),
    "deaf": set(),
    "slow": {"delay_s"},
    "sensor": {"channel", "mode", "counts"},
    "overpressure": {"muscle", "kpa"},
    "overspeed": {"joint", "rad_per_s"},
}
VARIANTS = ("random", "length", "transaction", "function")


class Faults:
    """The faults asked for; each begins `after_s` from when it was asked for, and lasts `for_s` or until mended.

    Parameters
    ----------
    machine : Machine
        Whose channels, muscles and joints can be named.
    """

    def __init__(self, machine: Machine):
        self._known = {
            "channel": list(machine.sensors()),
            "muscle": machine.exoskeleton.muscle_names,
            "joint": machine.exoskeleton.joint_names,
            "mode": ["frozen", "counts"],
            "variant": VARIANTS,
        }
        self._lock = threading.Lock()
        self._asked: list[dict[str, Any]] = []

    def add(self, asked: Mapping[str, Any]) -> None:
        """Take a fault.

        Raises
        ------
        ValueError
            For one that is not known, lacks something or has too much.
        """
        fault = {key: value for key, value in asked.items() if key != "do"}
        name = fault.get("name")
        if name not in FIELDS:
            raise ValueError(f"no fault '{name}'; there are {', '.join(FIELDS)}")
        if name == "garbage":
            fault.setdefault("variant", "random")
        if fault.get("mode") == "frozen":
            fault.setdefault("counts", None)
        given = set(fault) - {"name", "after_s", "for_s"}
        if given != FIELDS[name]:
            raise ValueError(f"fault {name} takes {sorted(FIELDS[name])}, not {sorted(given)}")
        for key, known in self._known.items():
            if key in fault and fault[key] not in known:
                raise ValueError(f"{key}: expected one of {', '.join(known)}, got '{fault[key]}'")
        begins = clock.now_s() + (fault.get("after_s") or 0.0)
        lasts = fault.get("for_s")
        fault |= {"begins_s": begins, "ends_s": float("inf") if lasts is None else begins + lasts}
        with self._lock:
            self._asked.append(fault)

    def mend(self) -> None:
        """End all faults."""
        with self._lock:
            self._asked = []

    def now(self, name: str) -> list[dict[str, Any]]:
        """Return the faults of a name that are there now."""
        if not self._asked:
            return []
        now = clock.now_s()
        with self._lock:
            return [each for each in self._asked if each["name"] == name and each["begins_s"] <= now < each["ends_s"]]
