"""Which channel of the device is what, and what its counts mean.

Counts flow in, kPa, N and rad flow out; commands in kPa flow in, counts flow out. A value is the sign times the value
of one count times the counts beyond zero.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.limits import Guard, Limits, ordered
from stages.science.signals.trajectories import Array

WORD_LOW, WORD_HIGH = -32768, 32767
"""What a register holds, as a signed number."""

COUNTER_SPAN = 2**32
"""Counts after which a counter begins anew."""

Kind = Literal["EP", "4AO", "4AI", "1CI"]


class Place(Declared):
    """Where something is counted, and what its counts mean."""

    module: int = Field(ge=0, description="position of the module, 0 being the bus module")
    zero_count: float = Field(description="counts at zero")
    sign: Literal[-1, 1] = Field(description="-1 where counts fall as the value rises")

    @property
    def per_count(self) -> float:
        """Signed value of a count, kPa, N or rad."""
        (worth,) = (value for name, value in self if name.endswith("_per_count"))
        return self.sign * float(worth)


class AnaloguePlace(Place):
    """One channel of one module."""

    channel: int = Field(ge=0, le=3, description="channel of the module, from 0")


class PressurePlace(AnaloguePlace):
    """A channel of pressures."""

    kpa_per_count: PositiveFloat = Field(description="kPa of one count")


class ForcePlace(AnaloguePlace):
    """A channel of tensions."""

    n_per_count: PositiveFloat = Field(description="N of one count")


class EncoderPlace(Place):
    """A counter module with a joint's encoder."""

    channel: ClassVar[int] = 0
    rad_per_count: PositiveFloat = Field(description="rad of one count")


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

    _order = ordered("low", "high")

    def sort_out(self, counts: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which counts stand for no value, and which of the others are at an end."""
        none = np.isin(counts, self.none)
        return none, ~none & ((counts < self.low) | (counts >= self.high))


class ChannelMap:
    """All channels of a machine: ``places`` by name, as ``pam1.force``, ``names`` and ``inputs`` but for regulators.

    Channels of muscles and encoders of joints that the machine does not have are left alone. A `ValueError` names a
    muscle or joint without channels, a module of another kind, or a channel that serves twice.
    """

    def __init__(
        self,
        exoskeleton: Exoskeleton,
        modules: list[Kind],
        channels: Mapping[str, MuscleChannels],
        encoders: Mapping[str, EncoderPlace],
    ):
        muscles, joints = exoskeleton.muscle_names, exoskeleton.joint_names
        for path, wanted, given in (("channels", muscles, channels), ("encoders", joints, encoders)):
            for name in wanted:
                if name not in given:
                    only = ", ".join(given) or "nobody"
                    raise ValueError(f"{path}: none for {name}, only for {only}; add {path}.{name}")
        self.places: dict[str, Any] = {
            f"{name}.{kind}": getattr(channels[name], kind)
            for kind in ("command", "pressure", "force")
            for name in muscles
        }
        self.places |= {f"{name}.encoder": encoders[name] for name in joints}
        taken: dict[tuple[int, int], str] = {}
        for name, place in self.places.items():
            owner, _, kind = name.rpartition(".")
            path = f"encoders.{owner}" if kind == "encoder" else f"channels.{name}"
            wanted_kind = {"command": "4AO", "encoder": "1CI"}.get(kind, "4AI")
            found = modules[place.module] if place.module < len(modules) else "no module"
            if found != wanted_kind:
                raise ValueError(
                    f"{path}.module: expected the position of a {wanted_kind}, got {place.module}, which is {found}"
                )
            other = taken.setdefault((place.module, place.channel), path)
            if other != path:
                raise ValueError(f"{other} and {path}: expected a channel each, got module {place.module} twice")
        self.exoskeleton = exoskeleton
        self.commands: list[PressurePlace] = list(self.places.values())[: len(muscles)]
        self.inputs: list[AnaloguePlace | EncoderPlace] = list(self.places.values())[len(muscles) :]
        self.names = list(self.places)[len(muscles) :]
        self._zero = np.array([each.zero_count for each in self.inputs])
        self._per_count = np.array([each.per_count for each in self.inputs])

    def check_against(self, limits: Limits, guard: Guard, counts: CountRange) -> None:
        """Check that outputs can tell what may be commanded, and inputs of a range of counts what ends a trial.

        Outputs of 0, to which the device's watchdog sets them, have to command no pressure. A `ValueError` names the
        channel.
        """
        for m, muscle in enumerate(self.exoskeleton.muscles):
            path, command, ceiling = f"channels.{muscle.name}", self.commands[m], guard.ceilings[muscle.type]
            for value in (0.0, limits[muscle.type].high_kpa):
                count = command.zero_count + value / command.per_count
                if not WORD_LOW <= count <= WORD_HIGH:
                    raise ValueError(
                        f"{path}.command: expected counts from {WORD_LOW} to {WORD_HIGH} for all that may be "
                        f"commanded, got {count:.0f} for {value} kPa; correct kpa_per_count or zero_count"
                    )
            for k, (kind, value) in enumerate((("pressure", ceiling.pressure_kpa), ("force", ceiling.force_n))):
                place = self.inputs[m + k * len(self.commands)]
                count = place.zero_count + value / place.per_count
                if not counts.low <= count < counts.high:
                    raise ValueError(
                        f"{path}.{kind}: expected counts from {counts.low} to {counts.high} (device.counts) "
                        f"up to the ceiling of {value} (guard.ceilings), got {count:.0f}; it would not be noticed"
                    )
            vented_kpa = command.per_count * (0.0 - command.zero_count)
            if vented_kpa > guard.vented_kpa:
                raise ValueError(
                    f"{path}.command: expected at most {guard.vented_kpa} kPa (guard.vented_kpa) for an output of 0, "
                    f"to which the watchdog sets it, got {vented_kpa:.0f} kPa; correct zero_count "
                    f"({command.zero_count}) or sign, or turn the regulator's signal round"
                )

    def to_values(self, counts: Array) -> tuple[Array, Array, Array]:
        """Return pressures (M,), kPa, tensions (M,), N, and angles (J,), rad, of the counts of all inputs."""
        muscles, beyond = len(self.commands), counts - self._zero
        beyond[2 * muscles :] = (beyond[2 * muscles :] + COUNTER_SPAN / 2) % COUNTER_SPAN - COUNTER_SPAN / 2
        values = self._per_count * beyond
        return values[:muscles], values[muscles : 2 * muscles], values[2 * muscles :]

    def to_counts(self, command_kpa: Array) -> list[int]:
        """Return the counts of commands (M,), kPa gauge."""
        return [
            int(np.clip(round(place.zero_count + value / place.per_count), WORD_LOW, WORD_HIGH))
            for place, value in zip(self.commands, command_kpa, strict=True)
        ]
