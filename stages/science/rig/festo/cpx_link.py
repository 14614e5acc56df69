"""The link to a Festo CPX-E: counts of outputs flow in, counts of inputs flow out, through the vendor's library.

Whatever goes wrong on the way is told as one `LinkLost`. While it is armed, the device's own watchdog sets every output
to zero when no request reaches it for a stated time, so that a dead computer or cable lets the muscles down.
"""

import logging
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared
from stages.science.rig import clock
from stages.science.rig.contract import RigError
from stages.science.rig.festo.channels import ChannelMap, CountRange, Kind
from stages.science.signals.trajectories import Array

Range = Literal["U_10V", "B_10V", "B_5V", "U_1_5V", "U_20MA", "U_4_20MA", "B_20MA"]

EXTRA = 'pip install "pamid[rig]"'
SHORTEST_WATCHDOG_S = 0.1
"""Below which the device excludes its master; from the vendor's library."""

VENTED = 0.9
"""Share of the watchdog's time after which the device is taken to have vented, as it may count from earlier on."""

TRIED_S = 0.15
"""Time beyond the ramp for which a device is tried to be reached, s: each try keeps its watchdog from acting."""

Look = Callable[[Array, Array], None]
"""Is handed the counts of all inputs and the command, kPa gauge, at each step on the way down."""


class LinkLost(Exception):
    """The device did not answer, or not as it should."""


class Device(Declared):
    """A CPX-E with an EtherNet/IP and Modbus bus module."""

    host: str = Field(min_length=1, description="address")
    port: int = Field(ge=1, le=65535, description="TCP port of Modbus")
    modules: list[Kind] = Field(min_length=1, description="as they stand, left to right, the bus module EP first")
    watchdog_s: float = Field(ge=SHORTEST_WATCHDOG_S, le=10.0, description="silence after which it vents, s")
    reply_s: PositiveFloat = Field(description="longest wait for a reply, s")
    counts: CountRange
    signal_range: Range | None = Field(description="of all analogue channels, as U_10V; null = as the device is set")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.modules[0] != "EP" or "EP" in self.modules[1:]:
            raise ValueError(f"modules: expected EP first and only there, got {', '.join(self.modules)}")
        if self.reply_s >= self.watchdog_s:
            raise ValueError(
                f"reply_s: expected less than watchdog_s ({self.watchdog_s} s), so that a silence is noticed "
                f"before the device vents, got {self.reply_s}"
            )
        return self


class CpxLink:
    """A connection to one device, of whose channels some serve; any request may raise `LinkLost`."""

    def __init__(self, device: Device, channels: ChannelMap):
        self.device, self.channels = device, channels
        self._cpx: Any = None
        self._outputs = {position: [0] * 4 for position, kind in enumerate(device.modules) if kind == "4AO"}
        self._answered_at_s = clock.now_s()
        self._longest_silence_s = 0.0
        self._armed = False

    @property
    def place(self) -> str:
        """Address and port."""
        return f"{self.device.host}:{self.device.port}"

    @property
    def longest_silence_s(self) -> float:
        """Longest time without an answer since the watchdog was armed, s."""
        return max(self._longest_silence_s, clock.now_s() - self._answered_at_s)

    def open(self) -> None:
        """Connect, check the modules and set all outputs to zero pressure.

        A `RigError` tells that the library is not there, nobody answers, or other modules stand there.
        """
        kinds = _import_modules()
        self._cpx = kinds["CpxE"](modules=[kinds[kind]() for kind in self.device.modules])
        try:
            self.reopen()
            with _told():
                found = self._cpx.module_count()
            if found != len(self.device.modules):
                raise RigError(
                    f"rig.device.modules: expected the {found} modules that {self.place} tells of, "
                    f"got {len(self.device.modules)} ({', '.join(self.device.modules)})"
                )
            if self.device.signal_range is not None:
                chosen = kinds["ChannelRange"][self.device.signal_range]
                with self._unbroken():
                    for module, kind in zip(self._cpx.modules, self.device.modules, strict=True):
                        for channel in range(4 if kind in ("4AO", "4AI") else 0):
                            module.configure_channel_range(channel, chosen)
            self.vent()
        except LinkLost as error:
            raise RigError(
                f"{self.place}: expected a CPX-E that answers Modbus ({error}); check its power, its cable and "
                "rig.device.host and rig.device.port"
            ) from None

    def reopen(self) -> None:
        """Connect anew, whatever became of the connection before."""
        from pymodbus.client import ModbusTcpClient

        if hasattr(self._cpx, "client"):
            self._cpx.client.close()
        # The library's own constructor would take port 502 and wait three seconds, three times, for an answer.
        self._cpx.client = ModbusTcpClient(
            self.device.host, port=self.device.port, timeout=self.device.reply_s, retries=0
        )
        with _told():
            if not self._cpx.client.connect():
                raise LinkLost("no connection")

    def close(self) -> None:
        """Let the connection go; harmless when there is none."""
        if self._cpx is not None and hasattr(self._cpx, "client"):
            self._cpx.client.close()
        self._cpx = None

    def let_go(self) -> None:
        """Vent, let the watchdog rest once that is confirmed, and disconnect; `RigError` where it could not be told."""
        if self._cpx is None:
            return  # given up already, so that the watchdog acts
        try:
            self.vent()
            self.disarm()
        except LinkLost as error:
            raise RigError(
                f"{self.place} could not be told to vent ({error}); see that its muscles are without air"
            ) from None
        finally:
            self.close()

    def read(self) -> Array:
        """Return the counts of all inputs, in the order of the channel map.

        `LinkLost` tells that an answer is late, cut short or none, or that all of them take half the watchdog's time.
        """
        found: dict[int, list[int]] = {}
        counts = []
        begun = clock.now_s()
        with self._unbroken():
            for place in self.channels.inputs:
                if place.module not in found:
                    found[place.module] = self._read_module(place.module)
                    taken_s = clock.now_s() - begun
                    if taken_s > 0.5 * self.device.watchdog_s:
                        raise LinkLost(f"it answers slowly: {len(found)} modules in {1e3 * taken_s:.0f} ms")
                counts.append(found[place.module][place.channel])
        return np.array(counts, dtype=float)

    def write(self, command_kpa: Array) -> None:
        """Command pressures (M,), kPa gauge; a module that refuses its outputs keeps no other from having theirs.

        `LinkLost` tells that the device does not confirm, or has vented meanwhile: then nothing but zero is commanded,
        as any other command would fill empty muscles at once.
        """
        if self._armed and np.any(command_kpa > 0.0) and self.longest_silence_s > VENTED * self.device.watchdog_s:
            raise LinkLost(f"it heard nothing for {1e3 * self.longest_silence_s:.0f} ms, so that its watchdog vented")
        for place, count in zip(self.channels.commands, self.channels.to_counts(command_kpa), strict=True):
            self._outputs[place.module][place.channel] = count
        refused = []
        with self._unbroken():
            for position, counts in self._outputs.items():
                register = self._cpx.modules[position].system_entry_registers.outputs
                words = list(struct.unpack("<HHHH", struct.pack("<hhhh", *counts)))
                if self._cpx.client.write_registers(register, words).isError():
                    refused.append(str(position))
            if refused:
                raise LinkLost(f"module {' and '.join(refused)} refused its outputs")

    def vent(self) -> None:
        """Command zero pressure on every muscle."""
        self.write(np.zeros(len(self.channels.commands)))

    def depressurise(self, last_kpa: Array, ramp_s: float, period_s: float, look: Look, problem: str = "") -> str:
        """Let all muscles down from their last commands (M,), kPa gauge, step by step, with the watchdog armed.

        What is read on the way is looked at. Where there is a problem already, zero is commanded at once, on a
        connection of its own, and so it is where the device has vented meanwhile. Returned is why it could not be told,
        the link being closed then, so that its watchdog acts; empty where it confirmed commands of zero.
        """
        begun, steps = clock.now_s(), max(round(ramp_s / period_s), 1)
        if problem:
            with suppress(LinkLost):
                self.reopen()
        while True:
            passed_s = clock.now_s() - begun
            vented = self.longest_silence_s > self.device.watchdog_s  # by the watchdog, which a ramp would undo
            share = 1.0 if vented or problem else min((np.floor(passed_s / period_s) + 1) / steps, 1.0)
            try:
                self.write((1.0 - share) * last_kpa)
                if share == 1.0:
                    return ""
                look(self.read(), (1.0 - share) * last_kpa)
            except LinkLost as error:
                if problem and clock.now_s() - begun > ramp_s + TRIED_S:
                    self.close()
                    return str(error)
                problem = str(error)
                with suppress(LinkLost):
                    self.reopen()
            clock.sleep(begun + (np.floor(passed_s / period_s) + 1) * period_s - clock.now_s())

    def arm(self) -> None:
        """Have the device vent when no request reaches it for its time."""
        self._set_watchdog(round(self.device.watchdog_s * 1000))
        self._longest_silence_s, self._armed = 0.0, True

    def disarm(self) -> None:
        """Let the device bear silence."""
        self._set_watchdog(0)
        self._armed = False

    def find_other_master(self) -> str:
        """Return how it shows that somebody else drives the device too; empty where nothing does."""
        told, set_ms = self._read_watchdog(), round(self.device.watchdog_s * 1000)
        if told == set_ms:
            return ""
        return f"somebody else drives the device too: its watchdog was set to {set_ms} ms and tells {told} ms"

    def _set_watchdog(self, time_ms: int) -> None:
        with self._unbroken():
            self._cpx.set_timeout(time_ms)
        told = self._read_watchdog()
        if told != time_ms:
            raise LinkLost(f"the watchdog was set to {time_ms} ms and tells {told} ms")

    def _read_watchdog(self) -> int:
        from cpx_io.cpx_system.cpx_e.cpx_e_modbus_registers import TIMEOUT

        with self._unbroken():
            return int.from_bytes(self._cpx.read_reg_data(*TIMEOUT), "little")

    def _read_module(self, position: int) -> list[int]:
        module, counter = self._cpx.modules[position], self.device.modules[position] == "1CI"
        values = [module.read_value()] if counter else module.read_channels()
        if len(values) != (1 if counter else 4):
            raise LinkLost(f"module {position} answered with {len(values)} values")
        return [int(each) for each in values]

    @contextmanager
    def _unbroken(self) -> Iterator[None]:
        """Bear no connection that is made anew on the way: the muscles were out of hand meanwhile."""
        if self._cpx is None:
            raise LinkLost("not connected")
        before = self._cpx.client.socket
        if before is None:
            raise LinkLost("the connection was closed")
        self._longest_silence_s = self.longest_silence_s
        with _told():
            yield
        if self._cpx.client.socket is not before:
            raise LinkLost("the connection was closed and made anew")
        self._longest_silence_s = self.longest_silence_s  # this process may have slept while it waited
        self._answered_at_s = clock.now_s()


@contextmanager
def _told() -> Iterator[None]:
    """Tell what the libraries raise as `LinkLost`."""
    from pymodbus.exceptions import ModbusException

    try:
        yield
    except LinkLost:
        raise
    except (ModbusException, OSError, AttributeError, IndexError, ValueError, TypeError, struct.error) as error:
        told = str(error).splitlines()[0] if str(error) else type(error).__name__
        if "ExceptionResponse" in told:
            told = "it refused a request"
        raise LinkLost(told.removeprefix("Modbus Error: ").removesuffix(", continue with next request")) from error


def _import_modules() -> dict[str, Any]:
    """Return the library's classes by what they are called here."""
    try:
        from cpx_io.cpx_system.cpx_e.cpx_e import CpxE
        from cpx_io.cpx_system.cpx_e.cpx_e_enums import ChannelRange
        from cpx_io.cpx_system.cpx_e.e1ci import CpxE1Ci
        from cpx_io.cpx_system.cpx_e.e4aiui import CpxE4AiUI
        from cpx_io.cpx_system.cpx_e.e4aoui import CpxE4AoUI
        from cpx_io.cpx_system.cpx_e.eep import CpxEEp
    except ImportError as error:
        raise RigError(
            f"rig=festo_cpx: expected festo-cpx-io with the pymodbus that it needs ({error}); type: {EXTRA}"
        ) from None
    for name in ("cpx-io", "pymodbus.logging"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # every request is told there; faults are told here
    modules = {"EP": CpxEEp, "4AO": CpxE4AoUI, "4AI": CpxE4AiUI, "1CI": CpxE1Ci}
    return {"CpxE": CpxE, "ChannelRange": ChannelRange, **modules}
