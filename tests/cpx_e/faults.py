"""Faults that tests ask for, and when they begin and end.

Requests flow in; what is wrong now flows out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stages.science.rig import clock

TAKES = {
    "cut": "",
    "garbage": "variant (random, length, transaction or function)",
    "silent": "",
    "refuse": "",
    "deaf": "",
    "slow": "delay_s",
    "sensor": "channel, mode (frozen or counts), counts",
    "overpressure": "muscle, kpa",
    "overspeed": "joint, rad_per_s",
}


class Faults:
    """The faults asked for; each begins `after_s` from when it was asked for, and lasts `for_s` or until mended."""

    def __init__(self) -> None:
        self._asked: list[dict[str, Any]] = []

    def add(self, fault: Mapping[str, Any]) -> None:
        """Take a fault; raises ValueError for one that is not known."""
        if fault["name"] not in TAKES:
            raise ValueError(f"no fault '{fault['name']}'; there are {', '.join(TAKES)}")
        begins = clock.now_s() + fault.get("after_s", 0.0)
        self._asked.append({**fault, "begins_s": begins, "ends_s": begins + fault.get("for_s", float("inf"))})

    def mend(self) -> None:
        """End all faults."""
        self._asked = []

    def now(self, name: str) -> list[dict[str, Any]]:
        """Return the faults of a name that are there now."""
        if not self._asked:
            return []
        now = clock.now_s()
        return [each for each in self._asked if each["name"] == name and each["begins_s"] <= now < each["ends_s"]]
