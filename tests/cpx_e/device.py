"""The device: registers, its watchdog, and what it can tell of itself.

Words of Modbus requests and counts of sensors flow in; words and commanded pressures flow out. Outputs go to the counts
of 0 kPa when the watchdog fires, which it does when no request has come for as long as register 46100 says.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np

from stages.rig import clock
from tests.cpx_e.faults import Faults
from tests.cpx_e.machine import INPUTS_FROM, OUTPUTS_FROM, WIDTHS, Analog, Machine
from tests.cpx_e.shared import Shared

CONTROL, VALUE, MODULES, FAULTS, STATUS, ANSWER, ANSWERED, TIMEOUT = (
    40001,
    40002,
    45367,
    45383,
    45391,
    45392,
    45393,
    46100,
)
CONTROL_BIT, WRITE_BIT, NUMBER_BITS = 1 << 15, 1 << 13, 0x0FFF | 1 << 12
REMEMBERED = 2000
TEND_S = 0.005


class NoSuchRegister(Exception):
    """An address that is not there, or cannot be written."""


class Device:
    """Registers by address, with what stands behind them.

    Parameters
    ----------
    machine : Machine
        Modules and channels.
    shared : Shared
        What the plant's process reads and writes.
    faults : Faults
        What is wrong.
    """

    def __init__(self, machine: Machine, shared: Shared, faults: Faults):
        self.machine, self.shared, self.faults = machine, shared, faults
        self.lock = threading.RLock()
        modules = machine.device.modules
        outputs = sum(WIDTHS[name][0] for name in modules)
        inputs = sum(WIDTHS[name][1] for name in modules)
        fixed = (CONTROL, VALUE, TIMEOUT)
        self.written = dict.fromkeys((*fixed, *range(OUTPUTS_FROM, OUTPUTS_FROM + outputs)), 0)
        count = (1 << len(modules)) - 1
        self.fixed = {MODULES + place: count >> 16 * place & 0xFFFF for place in range(3)}
        self.fixed |= dict.fromkeys(range(FAULTS, FAULTS + 3), 0) | {STATUS: 0, ANSWERED + 1: 0}
        self.inputs = range(INPUTS_FROM, INPUTS_FROM + inputs)
        self.answer, self.answered = 0, 0
        self.parameters: dict[int, int] = {}
        self.commands, self.sensors = machine.commands(), machine.sensors()
        self.places = {register: list(self.sensors).index(name) for name, (register, _) in self.sensors.items()}
        self.held: dict[str, int] = {}
        now = clock.now_s()
        self.requested_s = now
        self.messages = 0
        self.fired_at_s: float | None = None
        self.fired = 0
        self.fired_for: float | None = None
        self.vented_at_s: float | None = None
        self.outputs_kpa: list[float] = []
        self.log: deque[tuple[float, list[float]]] = deque(maxlen=REMEMBERED)
        self._vent()
        self._apply_outputs(now)

    def note_request(self) -> None:
        """Count a request and wind the watchdog up, after it had its chance to fire."""
        with self.lock:
            now = clock.now_s()
            self._watch(now)
            self.requested_s = now
            self.fired_for = None
            self.messages += 1

    def read(self, address: int, count: int) -> list[int]:
        """Return words; raises NoSuchRegister."""
        with self.lock:
            words: dict[int, int] = {}
            if address + count > self.inputs.start and address < self.inputs.stop:
                words = self._read_inputs()
            return [self._read_one(each, words) for each in range(address, address + count)]

    def write(self, address: int, words: list[int]) -> None:
        """Set words; raises NoSuchRegister, then nothing was written."""
        places = range(address, address + len(words))
        with self.lock:
            if any(each not in self.written for each in places):
                raise NoSuchRegister(address)
            self.written.update(zip(places, words, strict=True))
            if CONTROL in places:
                self._exchange_parameter(self.written[CONTROL])
            if OUTPUTS_FROM < places.stop < MODULES:
                now = clock.now_s()
                self.shared.written_s[0] = now
                self._apply_outputs(now)

    def state(self) -> dict[str, Any]:
        """Return what the device knows of itself."""
        with self.lock:
            return {
                "messages": self.messages,
                "outputs_kpa": self.outputs_kpa,
                "watchdog_ms": self.written[TIMEOUT],
                "watchdog_fired_at_s": self.fired_at_s,
                "watchdog_count": self.fired,
                "last_request_at_s": self.requested_s,
                "vented_at_s": self.vented_at_s,
                "log": list(self.log),
            }

    def _read_one(self, address: int, words: dict[int, int]) -> int:
        if address in self.inputs:
            return words.get(address, 0)
        if address == ANSWER:
            return self.answer
        if address == ANSWERED:
            return self.answered
        for known in (self.fixed, self.written):
            if address in known:
                return known[address]
        raise NoSuchRegister(address)

    def _read_inputs(self) -> dict[int, int]:
        words: dict[int, int] = {}
        counts = self.shared.latest()
        bad = {each["channel"]: each for each in self.faults.now("sensor")}
        first = self.machine.first_registers
        for position, name in enumerate(self.machine.device.modules):
            out, into = first[position]
            if name == "4AO":
                words |= {into + channel: self.written[out + channel] for channel in range(4)}
        for name, (register, channel) in self.sensors.items():
            fault = bad.get(name, {"mode": None})
            count = counts[self.places[register]]
            count = self.held.get(name, count) if fault["mode"] == "frozen" else count
            if isinstance(channel, Analog):
                words[register] = (int(fault["counts"]) if fault["mode"] == "counts" else count) & 0xFFFF
            else:
                count = (int(fault["counts"]) if fault["mode"] == "counts" else count) & 0xFFFFFFFF
                words |= {register: count & 0xFFFF, register + 1: count >> 16}
        return words

    def _exchange_parameter(self, order: int) -> None:
        number = order & NUMBER_BITS
        if not order & CONTROL_BIT:
            self.answer = 0
            return
        if order & WRITE_BIT:
            self.parameters[number] = self.written[VALUE]
        self.answered = self.parameters.get(number, 0)
        self.answer = CONTROL_BIT | number

    def _apply_outputs(self, now: float) -> None:
        kpa = []
        for register, channel in self.commands:
            word = self.written[register]
            kpa.append(max(channel.to_value(word - 0x10000 if word & 0x8000 else word), 0.0) + 0.0)
        if kpa == self.outputs_kpa:
            return
        self.outputs_kpa = kpa
        self.shared.order(now, kpa)
        vented = not any(kpa)
        if not vented:
            self.vented_at_s = None
        elif self.vented_at_s is None:
            self.vented_at_s = now
        self.log.append((now, kpa))

    def _vent(self) -> None:
        for register, channel in self.commands:
            self.written[register] = channel.to_count(0.0) & 0xFFFF

    def _watch(self, now: float) -> None:
        limit_s = self.written[TIMEOUT] / 1000.0
        if limit_s <= 0.0 or now - self.requested_s <= limit_s or self.fired_for == self.requested_s:
            return
        self.fired_for, self.fired_at_s = self.requested_s, now
        self.fired += 1
        self._vent()
        self._apply_outputs(now)

    def tend(self) -> float:
        """Do what is due without a request; return after how many seconds to do so again."""
        with self.lock:
            now = clock.now_s()
            self._watch(now)
            self._tend_faults(now)
            if self.written[TIMEOUT] <= 0 or self.fired_for is not None:
                return TEND_S
            due = self.requested_s + self.written[TIMEOUT] / 1000.0 - now
            return min(max(due + 1e-4, 2e-4), TEND_S)

    def _tend_faults(self, now: float) -> None:
        names = self.machine.exoskeleton.muscle_names
        given = {each["muscle"]: each["kpa"] for each in self.faults.now("overpressure")}
        self.shared.valve_kpa[:] = [given.get(name, np.nan) for name in names]
        runs = {each["joint"]: each["rad_per_s"] for each in self.faults.now("overspeed")}
        self.shared.run_rad_per_s[:] = [runs.get(name, 0.0) for name in self.machine.exoskeleton.joint_names]
        frozen = [each["channel"] for each in self.faults.now("sensor") if each["mode"] == "frozen"]
        counts = self.shared.latest()
        order = list(self.sensors)
        self.held = {name: self.held.get(name, counts[order.index(name)]) for name in frozen}
