"""Points of a calibration: a known value on a channel, which a person sets and the device counts.

The settings flow in; out flow the turns of the loop in the order of asking, what a person is asked at each, and what
the person read off the reference gauge.
"""

import csv
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from stages.science.plant.declaration import Declared, nearest

UNITS: dict[str, str] = {"pressure": "kPa", "command": "kPa", "force": "N", "encoder": "rad"}
"""What a channel of each kind measures."""


class ByQuantity(Declared):
    """A tolerance for each quantity."""

    pressure_kpa: PositiveFloat
    force_n: PositiveFloat
    angle_rad: PositiveFloat

    def of(self, kind: str) -> float:
        """Return the tolerance of a kind of channel."""
        return {"force": self.force_n, "encoder": self.angle_rad}.get(kind, self.pressure_kpa)


class CalibrationSettings(Declared):
    """Which values are set on which channels, how they are recorded, and what makes a line."""

    points: dict[str, Annotated[list[float], Field(min_length=1)]] = Field(description="known values, by channel")
    only: list[str] | None = Field(description="channels whose points are asked for, in this order; None for all")
    record_s: Annotated[float, Field(gt=0.0, le=600.0)] = Field(description="length of the record of a point, s")
    settle_s: Annotated[float, Field(ge=0.0, le=60.0)] = Field(description="time at a command before the record, s")
    ramp_s: Annotated[float, Field(gt=0.0, le=60.0)] = Field(description="time to fill or to let down a muscle, s")
    attempts: PositiveInt = Field(description="how often a point is asked for that was of no use")
    still: ByQuantity = Field(description="largest change during a record")
    residual: ByQuantity = Field(description="largest distance of a point from the line")
    plausible_ratio: Annotated[float, Field(gt=1.0)] = Field(description="of a count's value to the configured one")
    spacing: NonNegativeFloat = Field(description="least counts between lowest and highest point, over the noise")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in self.only or []:
            if name not in self.points:
                raise ValueError(f"only: no points of '{name}'; {nearest(name, self.points)}")
        if self.only == []:
            raise ValueError("only: expected channels, or null for all, got []")
        for name, values in self.points.items():
            if split_name(name)[1] == "command" and min(values) <= 0.0:
                raise ValueError(
                    f"points.{name}: expected pressures above 0, as a vented regulator is at its end, got {min(values)}"
                )
            if split_name(name)[1] in ("pressure", "force") and min(values) < 0.0:
                raise ValueError(f"points.{name}: expected no negative values, got {min(values)}")
        return self

    @property
    def chosen(self) -> dict[str, list[float]]:
        """The points that are asked for, channel after channel."""
        return {name: self.points[name] for name in (self.points if self.only is None else self.only)}

    def check_channels(self, muscles: Iterable[str], joints: Iterable[str]) -> None:
        """Check that every channel is one of the machine; a `ValueError` names one that is not, and the nearest."""
        kinds = ("pressure", "command", "force")
        known = [f"{each}.{kind}" for each in muscles for kind in kinds] + [f"{each}.encoder" for each in joints]
        for name in self.points:
            if name not in known:
                raise ValueError(f"points: no channel '{name}'; {nearest(name, known)}")


@dataclass(frozen=True)
class Turn:
    """One stop of the loop, numbered from 1."""

    point: int
    channels: tuple[str, ...]
    """Whose counts it tells: one, or a muscle's pressure sensor and regulator, which one gauge tells of."""
    value: float
    """What the person sets, or the run commands, in the unit of the channels."""
    held: str = ""
    """The muscle that is under pressure meanwhile; empty where nothing is."""

    @property
    def unit(self) -> str:
        """Unit of the channels."""
        return UNITS[split_name(self.channels[0])[1]]

    @property
    def title(self) -> str:
        """Channels and value, for a person."""
        return f"{' and '.join(self.channels)} at {self.value:g} {self.unit}"


def split_name(channel: str) -> tuple[str, str]:
    """Return whose channel it is, and its kind."""
    owner, _, kind = channel.rpartition(".")
    return owner, kind


def list_turns(points: Mapping[str, list[float]]) -> list[Turn]:
    """Return the turns in the order of asking: as listed, but that one gauge serves sensor and regulator."""
    asked: dict[tuple[str, float, int, str], list[str]] = {}
    for name, values in points.items():
        owner, kind = split_name(name)
        for k, value in enumerate(values):
            held = owner if kind in ("pressure", "command") and value > 0.0 else ""
            asked.setdefault((held, value, values[:k].count(value), "" if held else name), []).append(name)
    keys = enumerate(asked.items(), start=1)
    return [Turn(number, tuple(names), value, held) for number, ((held, value, *_), names) in keys]


def describe_task(turn: Turn, settings: CalibrationSettings) -> str:
    """Return what a person does before a point is recorded."""
    owner, kind = split_name(turn.channels[0])
    if turn.held:
        lasts_s = 2.0 * settings.ramp_s + settings.settle_s + settings.record_s
        return (
            f"see that nobody is in the machine and connect the reference gauge to {owner}, which is put under "
            f"{turn.value:g} kPa for {lasts_s:.3g} s as soon as the command is typed; read the gauge meanwhile"
        )
    if kind == "pressure":
        return f"take the hose off {owner}, so that its sensor is at the air's pressure"
    if kind == "force":
        load = f"hang {turn.value:g} N on" if turn.value else "take every load off"
        return f"{load} the load cell of {owner} and let it come to rest"
    return f"bring joint {owner} to {turn.value:g} rad and hold it there"


def label(point: int, attempt: int) -> str:
    """Return by what a gauge's reading is found: the point's number, with the attempt's if it is not the first."""
    return f"{point}" if attempt == 1 else f"{point}.{attempt}"


def find_reading(text: str, wanted: str) -> float | None:
    """Return what a gauge showed, kPa, by the last line of label and kPa that tells it; None where none does.

    A `ValueError` tells that this line tells no pressure.
    """
    rows = [row for row in csv.reader(text.splitlines()) if row and row[0].strip() == wanted]
    if not rows:
        return None
    line = ",".join(rows[-1])
    try:
        value = float(rows[-1][1]) if len(rows[-1]) == 2 else math.nan
    except ValueError:
        value = math.nan
    if not -100.0 <= value <= 2000.0:
        raise ValueError(f"expected {wanted},KPA with a pressure as the gauge shows it, got {line!r}")
    return value


class PointRequested(Exception):
    """A point waits for a person, who is asked what ``asks`` says, as documents/asks.json keeps it."""

    def __init__(self, turn: Turn | None, attempt: int, text: str):
        super().__init__(text)
        self.asks: dict[str, Any] = {"point": None, "attempt": None, "do": text}
        if turn is not None:
            told = {"channels": list(turn.channels), "value": turn.value, "unit": turn.unit}
            self.asks = {"point": turn.point, "attempt": attempt, **told, "do": text}
