"""The device: registers, its watchdog, and what it can tell of itself.

Words of Modbus requests and counts of sensors flow in; words and commanded pressures flow out. Outputs go to the counts
of 0 kPa when the watchdog fires, which it does when no request has come for as long as register 46100 says.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from stages.science.rig import clock
from tests.cpx_e.machine import INPUTS_FROM, OUTPUTS_FROM, WIDTHS, Faults, Machine
from tests.cpx_e.physics import Plant

CONTROL, VALUE, MODULES, ANSWER, ANSWERED, TIMEOUT = 40001, 40002, 45367, 45392, 45393, 46100
CONTROL_BIT, WRITE_BIT, NUMBER_BITS = 1 << 15, 1 << 13, 0x0FFF | 1 << 12
NO_REGISTER = 2
REMEMBERED = 2000
TEND_S = 0.005


class Refused(Exception):
    """A request that is answered with an exception code."""


class Device:
    """Registers by address, with the plant that takes commands and has the sensors."""

    def __init__(self, machine: Machine, plant: Plant, faults: Faults):
        self.machine, self.plant, self.faults = machine, plant, faults
        modules = machine.device["modules"]
        outputs, inputs = (sum(each) for each in zip(*(WIDTHS[name] for name in modules), strict=True))
        self.written = dict.fromkeys((CONTROL, VALUE, TIMEOUT, *range(OUTPUTS_FROM, OUTPUTS_FROM + outputs)), 0)
        count = (1 << len(modules)) - 1
        self.fixed = {MODULES + place: count >> 16 * place & 0xFFFF for place in range(3)}
        self.fixed[ANSWERED + 1] = 0
        self.inputs = range(INPUTS_FROM, INPUTS_FROM + inputs)
        self.answer, self.answered = 0, 0
        self.parameters: dict[int, int] = {}
        self.commands, self.sensors = machine.commands(), machine.sensors()
        self.outputs = [at for at, name in zip(machine.first_registers, modules, strict=True) if name == "4AO"]
        self.held: dict[str, int] = {}
        self.requested_s = clock.now_s()
        self.fired, self.silent = 0, False
        self.fired_at_s: float | None = None
        self.vented_at_s: float | None = None
        self.outputs_kpa: list[float] = []
        self.log: deque[tuple[float, list[float]]] = deque(maxlen=REMEMBERED)
        self._vent(self.requested_s)

    def note_request(self) -> None:
        """Wind the watchdog up, after it had its chance to fire."""
        now = clock.now_s()
        self._watch(now)
        self.requested_s, self.silent = now, False

    def read(self, address: int, count: int) -> list[int]:
        """Return words; raises Refused."""
        known = self.written | self.fixed | {ANSWER: self.answer, ANSWERED: self.answered}
        if address + count > self.inputs.start and address < self.inputs.stop:
            known |= dict.fromkeys(self.inputs, 0) | self._read_inputs()
        places = range(address, address + count)
        if any(each not in known for each in places):
            raise Refused(NO_REGISTER)
        return [known[each] for each in places]

    def write(self, address: int, words: list[int]) -> None:
        """Set words; raises Refused, then nothing was written."""
        places = range(address, address + len(words))
        if any(each not in self.written for each in places):
            raise Refused(NO_REGISTER)
        self.written.update(zip(places, words, strict=True))
        if CONTROL in places:
            self._exchange_parameter(self.written[CONTROL])
        if OUTPUTS_FROM < places.stop < MODULES:
            self.plant.written_s = clock.now_s()
            self._apply_outputs(self.plant.written_s)

    def state(self, log: int) -> dict[str, Any]:
        """Return what the device knows of itself, with its last changes of outputs."""
        return {
            "now_s": clock.now_s(),
            "outputs_kpa": self.outputs_kpa,
            "watchdog_ms": self.written[TIMEOUT],
            "watchdog_fired_at_s": self.fired_at_s,
            "watchdog_count": self.fired,
            "last_request_at_s": self.requested_s,
            "vented_at_s": self.vented_at_s,
            "log": list(self.log)[-log:] if log else [],
        }

    def tend(self) -> float:
        """Do what is due without a request; return after how many seconds to do so again."""
        now = clock.now_s()
        self._watch(now)
        if self.written[TIMEOUT] <= 0 or self.silent:
            return TEND_S
        due = self.requested_s + self.written[TIMEOUT] / 1000.0 - now
        return min(max(due + 1e-4, 2e-4), TEND_S)

    def _read_inputs(self) -> dict[int, int]:
        words = {into + channel: self.written[out + channel] for out, into in self.outputs for channel in range(4)}
        counts = dict(zip(self.sensors, self.plant.counts, strict=True))
        bad = self.faults.now("sensor")
        frozen = [each["channel"] for each in bad if each["mode"] == "frozen"]
        self.held = {name: self.held.get(name, counts[name]) for name in frozen}
        counts |= self.held | {each["channel"]: each["counts"] for each in bad if each["mode"] == "counts"}
        for name, (register, channel) in self.sensors.items():
            words[register] = counts[name] & 0xFFFF
            if channel.rad_per_count:
                words[register + 1] = counts[name] >> 16 & 0xFFFF
        return words

    def _exchange_parameter(self, order: int) -> None:
        number, self.answer = order & NUMBER_BITS, 0
        if order & CONTROL_BIT:
            if order & WRITE_BIT:
                self.parameters[number] = self.written[VALUE]
            self.answered, self.answer = self.parameters.get(number, 0), CONTROL_BIT | number

    def _apply_outputs(self, now: float) -> None:
        kpa = []
        for register, channel in self.commands:
            word = self.written[register]
            kpa.append(max(channel.to_value(word - 0x10000 if word & 0x8000 else word), 0.0) + 0.0)
        if kpa == self.outputs_kpa:
            return
        self.outputs_kpa = kpa
        self.plant.commands.append((now, kpa))
        self.vented_at_s = None if any(kpa) else now if self.vented_at_s is None else self.vented_at_s
        self.log.append((now, kpa))

    def _vent(self, now: float) -> None:
        for register, channel in self.commands:
            self.written[register] = channel.to_count(0.0) & 0xFFFF
        self._apply_outputs(now)

    def _watch(self, now: float) -> None:
        limit_s = self.written[TIMEOUT] / 1000.0
        if limit_s <= 0.0 or now - self.requested_s <= limit_s or self.silent:
            return
        self.silent, self.fired_at_s = True, now
        self.fired += 1
        self._vent(now)
