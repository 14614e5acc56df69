"""Two water tanks, one above the other: a pump fills the upper, which runs into the lower, which runs out.

Flow out of a tank goes with the root of its level (Torricelli). A measured pump voltage flows in, with constants and
the terms that named effects add; the reading of the lower level flows out. Levels are told in the unit of the reading.
"""

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field

from stages.science.plant.declaration import Declared
from stages.science.plant.effect import Signals, Values
from stages.science.plant.effect_config import EffectConfig, NominalConstant
from stages.science.plant.filters import read
from stages.science.plant.record_plant import HEAD, InitialState, Placed, Positive, RecordPlant, Watched, begin, collect
from stages.science.signals.trajectories import Array

SITE = "tank"


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
    upper: float, lower: float, pump: float, values: tuple[float, ...], terms: TankTerms, rim: float
) -> tuple[float, float]:
    upper_outflow, lower_inflow, lower_outflow, pump_gain, _, _ = values
    filled = pump_gain * max(pump, 0.0)
    down = math.sqrt(max(upper, 0.0))
    over = 0.0
    gain = filled - upper_outflow * down - terms.leak * upper
    if terms.scale_over_rim > 0.0 and upper >= rim and gain > 0.0:
        over, gain = gain, 0.0
    into = lower_inflow * down + terms.share_down * over
    return gain, into - lower_outflow * math.sqrt(max(lower, 0.0))


@njit(cache=True, error_model="numpy", nogil=True)
def _fill(
    pump: Array,
    upper: float,
    lower: float,
    values: tuple[float, ...],
    terms: TankTerms,
    scale: float,
    step_s: float,
    substeps: int,
) -> Array:
    """Return the reading for a pump's voltage, (N,), on straight lines between samples, from levels to begin at.

    Values are those of `TankConstants`, in order; levels are in the unit of the reading.
    """
    reading_offset, input_delay_s = values[4:]
    reading = np.empty(pump.shape[0])
    h, late = step_s / substeps, input_delay_s / step_s
    rim = scale / terms.scale_over_rim if terms.scale_over_rim > 0.0 else 1e300
    upper, lower = min(max(upper, 0.0), rim), max(lower, 0.0)
    most = scale / terms.drive_cut if terms.drive_cut > 0.0 else 1e300
    full = scale / terms.level_cut - reading_offset if terms.level_cut > 0.0 else 1e300
    for k in range(pump.shape[0]):
        reading[k] = lower + reading_offset
        for i in range(substeps):
            at = min(max(k + (i + 0.5) / substeps - late, 0.0), pump.shape[0] - 1.0)
            left = int(at)
            right = min(left + 1, pump.shape[0] - 1)
            u = min(pump[left] + (at - left) * (pump[right] - pump[left]), most)
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
    reading_offset: NominalConstant = Field(description="what the sensor adds to the lower level")
    input_delay_s: NominalConstant = Field(description="by which the input acts later than recorded, within a sample")


class _TankEffect(EffectConfig):
    SITE = SITE


class CascadedTanks(RecordPlant):
    """Everything that simulating two tanks takes."""

    SITE: ClassVar[str] = SITE
    TERMS: ClassVar = TankTerms
    WATCHED: ClassVar[tuple[str, str]] = ("level", "rate of level")

    kind: Literal["cascaded_tanks"]
    input: str
    substeps: int = Field(ge=1, le=1000, description="integration steps per sample")
    output_scale: Positive = Field(description="level in which effects tell theirs, unit of the reading")
    time_scale_s: Positive = Field(description="time in which a level follows, s")
    constants: TankConstants
    effects: list[_TankEffect]

    @property
    def finest_s(self) -> float:
        """Time between samples, s, below which more of them tell no more."""
        return 0.01 * self.movement_s

    @property
    def movement_s(self) -> float:
        """Time in which a level follows, s."""
        return self.time_scale_s

    @property
    def other_starts(self) -> list[dict[str, float]]:
        """Tanks that are slower and quicker throughout."""
        rates = ("upper_outflow", "lower_inflow", "lower_outflow", "pump_gain")
        return [{name: pace * self.starts[name] for name in rates} for pace in (0.5, 2.0)]

    @property
    def memory_s(self) -> float:
        """Time in which levels forget what was pumped, s; assumed: five times that in which one follows."""
        return 5.0 * self.time_scale_s

    def resolve_from_data(self, records: Sequence[Signals], step_s: float) -> Self:
        """Return the plant with bounds of its timing, where they were left open; a fit begins at an input held."""
        return self.fill_in({"input_delay_s": (0.5 * step_s, -step_s, step_s, 0.5 * step_s)})

    def simulate(
        self,
        signals: Signals,
        step_s: float,
        start_s: Array,
        constants: Values,
        effects: Sequence[Placed] = (),
        begun: InitialState | None = None,
    ) -> Array:
        """Return the reading, (T, R), each record from its own beginning; see `RecordPlant.simulate`."""
        terms = collect(TankTerms, SITE, self.place(effects))
        values = tuple(constants[name] for name in TankConstants.model_fields)
        upper_outflow, lower_inflow, lower_outflow, pump_gain, reading_offset, _ = values
        columns = np.ascontiguousarray(signals[self.input].T)
        ends = [self.output_scale * each for each in (terms.lowest, terms.highest)]

        def run(state: Array, chosen: NDArray[np.int_], samples: int) -> Array:
            upper, lower = (np.maximum(state[0], 0.0) / lower_inflow) ** 2, state[1]
            filled = (
                _fill(columns[k, :samples], high, low, values, terms, self.output_scale, step_s, self.substeps)
                for k, high, low in zip(chosen, upper, lower, strict=True)
            )
            return read(np.stack(list(filled), axis=1), terms.unread, *ends)

        if begun is None:  # they rest under the first voltage
            down = lower_inflow * pump_gain * np.maximum(columns[:, 0], 0.0) / upper_outflow
            state = np.stack([down, (down / lower_outflow) ** 2])
        else:  # what the lower tank gains and loses ran into it
            lower = np.maximum(begun.value - reading_offset, 0.0)
            state = np.stack([np.maximum(begun.rate + lower_outflow * np.sqrt(lower), 0.0), lower])
        if begun is not None and self.output in signals:
            wide = np.full(state.shape, self.output_scale) / np.array([[self.time_scale_s], [1.0]])
            state = begin(run, state, wide, signals[self.output][:HEAD], begun.noise)
        return run(state, np.arange(len(columns)), columns.shape[1])

    def watch(self, signals: Signals, step_s: float, constants: Values) -> list[Watched]:
        """Return the input, and the level as the textbook's tanks would have it; see `RecordPlant.watch`."""
        level, rate, pump = super().watch(signals, step_s, constants)
        return [pump, level, rate]


PLANT = CascadedTanks
