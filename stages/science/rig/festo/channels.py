"""Which channel of the device is what, and what its counts mean.

Counts flow in, kPa, N and rad flow out; commands in kPa flow in, counts flow out. A value is the sign times the value
of one count times the counts beyond zero.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.signals.trajectories import Array

WORD_LOW, WORD_HIGH = -32768, 32767
"""What a register holds, as a signed number."""

COUNTER_SPAN = 2**32
"""Counts after which a counter begins anew."""

Kind = Literal["EP", "4AO", "4AI", "1CI"]

Sign = Literal[-1, 1]


class Place(Declared):
    """One channel of one module."""

    module: int = Field(ge=0, description="position of the module, 0 being the bus module")
    channel: int = Field(ge=0, le=3, description="channel of the module, from 0")
    zero_count: float = Field(description="counts at zero")
    sign: Sign = Field(description="-1 where counts fall as the value rises")


class PressurePlace(Place):
    """A channel of pressures."""

    kpa_per_count: PositiveFloat = Field(description="kPa of one count")

    @property
    def per_count(self) -> float:
        """Signed value of a count, kPa."""
        return self.sign * self.kpa_per_count


class ForcePlace(Place):
    """A channel of tensions."""

    n_per_count: PositiveFloat = Field(description="N of one count")

    @property
    def per_count(self) -> float:
        """Signed value of a count, N."""
        return self.sign * self.n_per_count


class EncoderPlace(Declared):
    """A counter module with a joint's encoder."""

    module: int = Field(ge=0, description="position of the module, 0 being the bus module")
    rad_per_count: PositiveFloat = Field(description="rad of one count")
    zero_count: float = Field(description="counts at angle 0")
    sign: Sign = Field(description="-1 where counts fall as the angle rises")

    @property
    def per_count(self) -> float:
        """Signed value of a count, rad."""
        return self.sign * self.rad_per_count


class MuscleChannels(Declared):
    """Channels of one muscle."""

    command: PressurePlace
    pressure: PressurePlace
    force: ForcePlace


class CountRange(Declared):
    """Which counts of an analogue input are values."""

    low: int = Field(ge=WORD_LOW, le=WORD_HIGH, description="lowest count; below it the wire is taken for broken")
    high: int = Field(ge=WORD_LOW, le=WORD_HIGH, description="highest count; from it on the input is at its end")
    none: list[int] = Field(description="counts that stand for no value")

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"expected low < high, got {self.low} and {self.high}")
        return self


class ChannelMap:
    """All channels of a machine.

    Parameters
    ----------
    exoskeleton : Exoskeleton
        The machine.
    modules : sequence of str
        Kinds, as they stand.
    channels : mapping of str to MuscleChannels
        By muscle; those of muscles that the machine does not have are left alone.
    encoders : mapping of str to EncoderPlace
        By joint; likewise.

    Raises
    ------
    ValueError
        Naming a muscle or joint without channels, a module of another kind, or a channel that serves twice.
    """

    def __init__(
        self,
        exoskeleton: Exoskeleton,
        modules: list[Kind],
        channels: Mapping[str, MuscleChannels],
        encoders: Mapping[str, EncoderPlace],
    ):
        _check_names("channels", exoskeleton.muscle_names, channels)
        _check_names("encoders", exoskeleton.joint_names, encoders)
        self.modules = modules
        self.commands = [channels[name].command for name in exoskeleton.muscle_names]
        self.pressures = [channels[name].pressure for name in exoskeleton.muscle_names]
        self.forces = [channels[name].force for name in exoskeleton.muscle_names]
        self.encoders = [encoders[name] for name in exoskeleton.joint_names]
        self.names = [
            *(f"{name}.pressure" for name in exoskeleton.muscle_names),
            *(f"{name}.force" for name in exoskeleton.muscle_names),
            *(f"{name}.encoder" for name in exoskeleton.joint_names),
        ]
        self._check_modules(exoskeleton)

    def _check_modules(self, exoskeleton: Exoskeleton) -> None:
        wanted: list[tuple[str, Kind, int, int]] = []
        for name, command, pressure, force in zip(
            exoskeleton.muscle_names, self.commands, self.pressures, self.forces, strict=True
        ):
            wanted.append((f"channels.{name}.command", "4AO", command.module, command.channel))
            wanted.append((f"channels.{name}.pressure", "4AI", pressure.module, pressure.channel))
            wanted.append((f"channels.{name}.force", "4AI", force.module, force.channel))
        for name, encoder in zip(exoskeleton.joint_names, self.encoders, strict=True):
            wanted.append((f"encoders.{name}", "1CI", encoder.module, 0))
        for path, kind, module, _ in wanted:
            found = self.modules[module] if module < len(self.modules) else "no module"
            if found != kind:
                raise ValueError(f"{path}.module: expected the position of a {kind}, got {module}, which is {found}")
        for place, count in Counter((module, channel) for _, _, module, channel in wanted).items():
            if count > 1:
                paths = [path for path, _, *its in wanted if tuple(its) == place]
                raise ValueError(f"{' and '.join(paths)}: expected a channel each, got module {place[0]} twice")

    def list_inputs(self) -> Iterator[tuple[int, int]]:
        """Yield module and channel of every input, in the order of `names`."""
        for place in (*self.pressures, *self.forces):
            yield place.module, place.channel
        for encoder in self.encoders:
            yield encoder.module, 0

    def check_reach(self, highest_kpa: list[float], ceilings: list[tuple[float, float]], counts: CountRange) -> None:
        """Check that outputs can tell what may be commanded, and inputs what ends a trial.

        Parameters
        ----------
        highest_kpa : list of float
            Highest command of each muscle, kPa gauge.
        ceilings : list of tuple of float
            Largest measured pressure, kPa gauge, and tension, N, of each muscle.
        counts : CountRange
            Of inputs.

        Raises
        ------
        ValueError
            Naming the channel.
        """
        muscles = [each.removesuffix(".pressure") for each in self.names[: len(self.commands)]]
        for m, name in enumerate(muscles):
            for value in (0.0, highest_kpa[m]):
                count = self.commands[m].zero_count + value / self.commands[m].per_count
                if not WORD_LOW <= count <= WORD_HIGH:
                    raise ValueError(
                        f"channels.{name}.command: expected counts from {WORD_LOW} to {WORD_HIGH} for all that may be "
                        f"commanded, got {count:.0f} for {value} kPa; correct kpa_per_count or zero_count"
                    )
            for kind, place, value in (
                ("pressure", self.pressures[m], ceilings[m][0]),
                ("force", self.forces[m], ceilings[m][1]),
            ):
                count = place.zero_count + value / place.per_count
                if not counts.low <= count < counts.high:
                    raise ValueError(
                        f"channels.{name}.{kind}: expected counts from {counts.low} to {counts.high} (device.counts) "
                        f"up to the ceiling of {value} (guard.ceilings), got {count:.0f}; it would not be noticed"
                    )

    def check_vents(self, vented_kpa: float) -> None:
        """Check that outputs of 0, to which the device's watchdog sets them, command no pressure.

        Parameters
        ----------
        vented_kpa : float
            Pressure up to which a muscle counts as vented, kPa gauge.

        Raises
        ------
        ValueError
            Naming the channel.
        """
        for name, place, told in zip(
            self.names, self.commands, self.to_commands([0] * len(self.commands)), strict=False
        ):
            if told > vented_kpa:
                raise ValueError(
                    f"channels.{name.removesuffix('.pressure')}.command: expected at most {vented_kpa} kPa "
                    f"(guard.vented_kpa) for an output of 0, to which the watchdog sets it, got {told:.0f} kPa; "
                    f"correct zero_count ({place.zero_count}) or sign, or turn the regulator's signal round"
                )

    def to_values(self, counts: Array) -> tuple[Array, Array, Array]:
        """Return pressures (M,), kPa, tensions (M,), N, and angles (J,), rad, of the counts of all inputs."""
        muscles = len(self.pressures)
        pressure = _scale(self.pressures, counts[:muscles])
        force = _scale(self.forces, counts[muscles : 2 * muscles])
        zero = np.array([each.zero_count for each in self.encoders])
        turned = (counts[2 * muscles :] - zero + COUNTER_SPAN / 2) % COUNTER_SPAN - COUNTER_SPAN / 2
        return pressure, force, turned * np.array([each.per_count for each in self.encoders])

    def to_counts(self, command_kpa: Array) -> list[int]:
        """Return the counts of commands (M,), kPa gauge."""
        return [
            int(np.clip(round(place.zero_count + value / place.per_count), WORD_LOW, WORD_HIGH))
            for place, value in zip(self.commands, command_kpa, strict=True)
        ]

    def to_commands(self, counts: list[int]) -> Array:
        """Return what counts of all outputs command (M,), kPa gauge."""
        return _scale(self.commands, np.array(counts, dtype=float))


def _scale(places: list[PressurePlace] | list[ForcePlace], counts: Array) -> Array:
    values: Array = np.array([each.per_count for each in places]) * (
        counts - np.array([each.zero_count for each in places])
    )
    return values


def _check_names(path: str, wanted: list[str], given: Mapping[str, object]) -> None:
    for name in wanted:
        if name not in given:
            raise ValueError(f"{path}: none for {name}, only for {', '.join(given) or 'nobody'}; add {path}.{name}")
