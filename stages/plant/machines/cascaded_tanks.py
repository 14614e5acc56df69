"""Two water tanks, one above the other: a pump fills the upper, which runs into the lower, which runs out.

Flow out of a tank goes with the root of its level (Torricelli). A measured pump voltage flows in, with constants and
the terms that named effects add; the reading of the lower level flows out. Levels are told in the unit of the reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
from numba import njit
from pydantic import Field, model_validator

from stages.plant.declaration import Declared
from stages.plant.listed import ListedEffect, NominalConstant
from stages.plant.reading import read
from stages.plant.record_plant import Beginning, Placed, Positive, RecordPlant, Watched, collect
from stages.signals.trajectories import Array

SITE = "tank"


class TankValues(NamedTuple):
    """Constants of both tanks, levels in the unit of the reading, time in seconds."""

    upper_outflow: float
    lower_inflow: float
    lower_outflow: float
    pump_gain: float
    upper_start: float
    lower_start: float
    reading_offset: float


class TankTerms(NamedTuple):
    """What effects add; levels over the output's scale, without a value given, nothing."""

    scale_over_rim: float = 0.0
    share_down: float = 0.0
    leak: float = 0.0
    drive_cut: float = 0.0
    level_cut: float = 0.0
    unread: float = 0.0
    lowest: float = -math.inf
    highest: float = math.inf


@njit(cache=True, error_model="numpy")
def _change(
    upper: float, lower: float, pump: float, values: TankValues, terms: TankTerms, rim: float
) -> tuple[float, float]:
    filled = values.pump_gain * max(pump, 0.0)
    down = math.sqrt(max(upper, 0.0))
    over = 0.0
    gain = filled - values.upper_outflow * down - terms.leak * upper
    if terms.scale_over_rim > 0.0 and upper >= rim and gain > 0.0:
        over, gain = gain, 0.0
    into = values.lower_inflow * down + terms.share_down * over
    return gain, into - values.lower_outflow * math.sqrt(max(lower, 0.0))


@njit(cache=True, error_model="numpy", nogil=True)
def _fill(pump: Array, values: TankValues, terms: TankTerms, scale: float, step_s: float, substeps: int) -> Array:
    reading = np.empty(pump.shape[0])
    h = step_s / substeps
    rim = scale / terms.scale_over_rim if terms.scale_over_rim > 0.0 else 1e300
    upper, lower = min(max(values.upper_start, 0.0), rim), max(values.lower_start, 0.0)
    most = scale / terms.drive_cut if terms.drive_cut > 0.0 else 1e300
    full = scale / terms.level_cut - values.reading_offset if terms.level_cut > 0.0 else 1e300
    for k in range(pump.shape[0]):
        reading[k] = lower + values.reading_offset
        u = min(pump[k], most)
        for _ in range(substeps):
            a1, b1 = _change(upper, lower, u, values, terms, rim)
            middle_upper, middle_lower = upper + 0.5 * h * a1, lower + 0.5 * h * b1
            a2, b2 = _change(middle_upper, middle_lower, u, values, terms, rim)
            upper = min(max(upper + h * a2, 0.0), rim)
            lower = min(max(lower + h * b2, 0.0), full)
    return reading


class TankConstants(Declared):
    """Constants of the textbook tanks."""

    upper_outflow: NominalConstant = Field(description="flow out of the upper tank over the root of its level")
    lower_inflow: NominalConstant = Field(description="the same flow as it fills the lower tank")
    lower_outflow: NominalConstant = Field(description="flow out of the lower tank over the root of its level")
    pump_gain: NominalConstant = Field(description="rise of the upper level over the pump's voltage")
    upper_start: NominalConstant = Field(description="upper level as a record begins")
    lower_start: NominalConstant = Field(description="lower level as a record begins")
    reading_offset: NominalConstant = Field(description="what the sensor adds to the lower level")


class TankEffect(ListedEffect):
    """An effect that acts at the tanks."""

    SITE = SITE


class CascadedTanks(RecordPlant):
    """Everything that simulating two tanks takes."""

    SITE: ClassVar[str] = SITE

    kind: Literal["cascaded_tanks"]
    input: str
    substeps: int = Field(ge=1, le=1000, description="integration steps per sample")
    output_scale: Positive = Field(description="level in which effects tell theirs, unit of the reading")
    pace_s: Positive = Field(description="time in which a level follows, s")
    constants: TankConstants
    effects: list[TankEffect]

    @model_validator(mode="after")
    def _check_effects(self) -> Self:
        collect(TankTerms, SITE, self.place())
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """The pump's voltage."""
        return (self.input,)

    @property
    def finest_s(self) -> float:
        """Time between samples, s, below which more of them tell no more."""
        return 0.01 * self.movement_s

    @property
    def movement_s(self) -> float:
        """Time in which a level follows, s."""
        return self.pace_s

    @property
    def other_starts(self) -> list[dict[str, float]]:
        """Tanks that are slower and quicker throughout, and begin emptier and fuller."""
        rates = ("upper_outflow", "lower_inflow", "lower_outflow", "pump_gain")
        return [
            {**{name: pace * self.starts[name] for name in rates}, "upper_start": fill * self.starts["upper_start"]}
            for pace, fill in product((0.5, 1.0, 2.0), (0.5, 1.0, 1.6))
            if (pace, fill) != (1.0, 1.0)
        ]

    @property
    def memory_s(self) -> float:
        """Time in which levels forget what was pumped, s; assumed: five times that in which one follows."""
        return 5.0 * self.pace_s

    def simulate(
        self,
        signals: Mapping[str, Array],
        step_s: float,
        start_s: Array,
        constants: Mapping[str, float],
        effects: Sequence[Placed] = (),
        begun: Beginning | None = None,
    ) -> Array:
        """Return the reading, (T, R), each record from its own beginning; see `RecordPlant.simulate`."""
        terms = collect(TankTerms, SITE, self.place(effects))
        pump, values = signals[self.input], TankValues(**constants)
        readings = [
            _fill(np.ascontiguousarray(column), values, terms, self.output_scale, step_s, self.substeps)
            for column in pump.T
        ]
        ends = (self.output_scale * each for each in (terms.lowest, terms.highest))
        return read(np.stack(readings, axis=1), terms.unread, *ends)

    def watch(self, signals: Mapping[str, Array], step_s: float, constants: Mapping[str, float]) -> list[Watched]:
        """Return the input, and the level as the textbook's tanks would have it."""
        level = self.model_copy(update={"effects": []}).simulate(signals, step_s, np.zeros(1), constants)
        rate = np.gradient(level, step_s, axis=0) * self.pace_s
        return [
            Watched(self.input, signals[self.input], False),
            Watched("level", level, False),
            Watched("rate of level", rate, True),
        ]


PLANT = CascadedTanks
