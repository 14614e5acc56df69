"""What the emulator emulates: the machine's description, where its channels lie in registers, and its faults.

Plain values flow in; a checked machine with its register map flows out, and what is wrong with it now.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.participant import Participant
from stages.science.plant.plant import Plant
from stages.science.rig import clock
from stages.science.rig.excitation import Movement

OUTPUTS_FROM, INPUTS_FROM = 40003, 45395
WIDTHS = {"EP": (0, 0), "4AO": (4, 5), "4AI": (0, 5), "1CI": (1, 8)}
"""Registers of each module: out and in; those of the EP stand before the others'."""
FAULTS = ("cut", "garbage", "silent", "refuse", "deaf", "slow", "sensor", "overpressure", "overspeed")
"""Garbage takes a variant (random, length, transaction or function), slow a delay_s, a sensor channel, mode (frozen or
counts) and counts, overpressure muscle and kpa, overspeed joint and rad_per_s."""


class Channel(BaseModel, extra="forbid"):
    """One channel of a module: value = sign * per_count * (count - zero_count); a counter has 32 bits."""

    module: int
    channel: int = 0
    kpa_per_count: float = 0.0
    n_per_count: float = 0.0
    rad_per_count: float = 0.0
    zero_count: float
    sign: int

    @property
    def per_count(self) -> float:
        return self.sign * (self.kpa_per_count or self.n_per_count or self.rad_per_count)

    def to_value(self, count: int) -> float:
        return self.per_count * (count - self.zero_count)

    def to_count(self, value: float) -> int:
        count = round(value / self.per_count + self.zero_count)
        return count & 0xFFFFFFFF if self.rad_per_count else min(max(count, -32768), 32767)


class Machine(BaseModel):
    """The machine, its people and its device; sections and keys beside these are those of other parts."""

    exoskeleton: Exoskeleton
    plant: Plant
    participants: dict[str, Participant]
    experimenter: Participant
    movement: Movement
    device: dict[str, Any]
    channels: dict[str, dict[str, Channel]]
    encoders: dict[str, Channel]
    seed: int = 0

    @property
    def first_registers(self) -> list[tuple[int, int]]:
        """First out and in register of each module, by position."""
        out, into, found = OUTPUTS_FROM, INPUTS_FROM, []
        for name in self.device["modules"]:
            found.append((out, into))
            out, into = out + WIDTHS[name][0], into + WIDTHS[name][1]
        return found

    def commands(self) -> list[tuple[int, Channel]]:
        """Register and channel of each muscle's command, in the exoskeleton's order."""
        first, its = self.first_registers, (self.channels[name]["command"] for name in self.exoskeleton.muscle_names)
        return [(first[each.module][0] + each.channel, each) for each in its]

    def sensors(self) -> dict[str, tuple[int, Channel]]:
        """Register and channel of every sensor by name: pressures, then forces, then encoders."""
        first = self.first_registers
        found: dict[str, tuple[int, Channel]] = {}
        for kind in ("pressure", "force"):
            for name in self.exoskeleton.muscle_names:
                each = self.channels[name][kind]
                found[f"{name}.{kind}"] = (first[each.module][1] + each.channel, each)
        for joint in self.exoskeleton.joint_names:
            found[f"{joint}.encoder"] = (first[self.encoders[joint].module][1], self.encoders[joint])
        return found


class Faults:
    """The faults asked for; each begins `after_s` from when it was asked for, and lasts `for_s` or until mended."""

    def __init__(self) -> None:
        self._asked: list[dict[str, Any]] = []

    def add(self, fault: Mapping[str, Any]) -> None:
        assert fault["name"] in FAULTS, fault
        begins = clock.now_s() + fault.get("after_s", 0.0)
        self._asked.append({**fault, "begins_s": begins, "ends_s": begins + fault.get("for_s", float("inf"))})

    def mend(self) -> None:
        self._asked = []

    def now(self, name: str) -> list[dict[str, Any]]:
        """Return the faults of a name that are there now."""
        now = clock.now_s()
        return [each for each in self._asked if each["name"] == name and each["begins_s"] <= now < each["ends_s"]]
