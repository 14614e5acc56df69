"""A store that fills through a resistance: T y' = gain input + offset - y; a valve and a chamber, a motor and its mass.

A measured input flows in, with constants and the terms that named effects add; the output flows out. Lengths are told
in a scale of the output and times in a pace, so that one effect has the same bounds on every machine of the kind.
"""

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.effect import Effect, Signals, Values
from stages.science.plant.effect_config import EffectConfig, NominalConstant
from stages.science.plant.filters import read
from stages.science.plant.linear_guess import filter_derivatives, find_pace, regress
from stages.science.plant.record_plant import HEAD, InitialState, Placed, Positive, RecordPlant, Tries, begin, collect
from stages.science.signals.trajectories import Array

SITE = "lag"
FINEST = 0.05
"""Longest integration step, paces."""
FILTER = 0.3
"""Time constant of the filters by which the linear model is guessed, paces."""


class LagTerms(NamedTuple):
    """What effects add; outputs over their scale, times in paces; without a value given, nothing."""

    delay: float = 0.0
    drive_cut: float = 0.0
    asymmetry: float = 0.0
    rate_cut: float = 0.0
    play: float = 0.0
    second_lag: float = 0.0
    coulomb: float = 0.0
    drag: float = 0.0
    unread: float = 0.0
    lowest: float = -math.inf
    highest: float = math.inf


@njit(cache=True, error_model="numpy", nogil=True)
def _fill(aim: Array, start: float, per_pace: float, terms: LagTerms, pace: float, substeps: int) -> Array:
    """Return the output in scales for an aim, (N,): the level at which the store would rest."""
    reading = np.empty(aim.shape[0])
    late = terms.delay / pace
    level, held, passed = start, aim[0], start
    h = pace / substeps
    slow = terms.second_lag
    uneven = 1.0 + terms.asymmetry
    rising, falling = 1.0 - math.exp(-h * per_pace * uneven), 1.0 - math.exp(-h * per_pace / uneven)
    for k in range(aim.shape[0]):
        reading[k] = level
        for i in range(substeps):
            at = min(max(k + (i + 0.5) / substeps - late, 0.0), aim.shape[0] - 1.0)
            left = int(at)
            right = min(left + 1, aim.shape[0] - 1)
            wanted = aim[left] + (at - left) * (aim[right] - aim[left]) if right > left else aim[left]
            if terms.drive_cut > 0.0:
                wanted = min(max(wanted, -1.0 / terms.drive_cut), 1.0 / terms.drive_cut)
            if terms.play > 0.0:
                held = min(max(held, wanted - terms.play), wanted + terms.play)
                wanted = held
            if slow > 0.0:
                short, caught = wanted - passed, 1.0 - math.exp(-h / slow)
                passed += short * caught
                wanted -= short * caught * slow / h
            wanted -= terms.drag * level * abs(level)
            if terms.coulomb > 0.0:
                against = (
                    min(max(wanted, -terms.coulomb), terms.coulomb)
                    if level == 0.0
                    else math.copysign(terms.coulomb, level)
                )
                wanted -= against
            short = wanted - level
            change = short * (rising if short > 0.0 else falling)
            if terms.rate_cut > 0.0:
                change = min(max(change, -h / terms.rate_cut), h / terms.rate_cut)
            stops = terms.coulomb > 0.0 and level * (level + change) < 0.0
            level = 0.0 if stops else level + change
    return reading


class LagConstants(Declared):
    """Constants of T y' = gain input + offset - y."""

    gain: NominalConstant = Field(description="output at rest over input")
    offset: NominalConstant = Field(description="output at rest without input")
    time_constant_s: NominalConstant = Field(description="time in which the output goes 63 % of its way")
    input_delay_s: NominalConstant = Field(description="by which the input acts later than recorded, within a sample")


class _LagEffect(EffectConfig):
    SITE = SITE


class FirstOrder(RecordPlant):
    """Everything that simulating a lag takes."""

    SITE: ClassVar[str] = SITE
    TERMS: ClassVar = LagTerms
    FREE: ClassVar[bool] = True
    QUANTITIES: ClassVar = {
        "input": ("voltage", "current", "torque"),
        "output": ("length", "temperature", "pressure", "angular velocity", "velocity", "flow"),
    }
    WATCHED: ClassVar[tuple[str, str]] = ("output", "rate of output")

    kind: Literal["first_order"]
    input: str
    output_scale: Positive | None = Field(description="change in which effects tell theirs, unit of the output")
    time_scale_s: Positive | None = Field(description="time of a radian of the usual motion, s")
    constants: LagConstants
    effects: list[_LagEffect]

    @model_validator(mode="after")
    def _check_time_constant(self) -> Self:
        low = self.constants.time_constant_s.low
        if low is not None and low <= 0.0:
            raise ValueError(f"time_constant_s: expected low above 0 s, got {low}")
        return self

    def list_starts(self, effect: Any, records: Sequence[Signals], step_s: float, constants: Values) -> Tries:
        """Return limits of the input; see `RecordPlant.list_limits`."""
        aims = (constants["gain"] * each[self.input] for each in records)
        return self.list_limits(effect, "lag_drive", aims, self.know("output_scale"))

    def find_lacking(self, effect: Effect) -> str:
        """Return what lacks for an effect: friction acts in what turns or slides, and not in what fills or warms."""
        moves = self.output.endswith(("_m_per_s", "_rad_per_s"))
        rubs = effect.name in ("coulomb_friction", "viscous_friction")
        return "an output in m/s or rad/s" if rubs and not moves else ""

    @property
    def memory_s(self) -> float:
        """Time in which a step comes to a thousandth of where it ends, s."""
        return float(np.log(1e3)) * self.starts["time_constant_s"]

    def resolve_from_data(self, records: Sequence[Signals], step_s: float) -> Self:
        """Return the plant with the scales and constants that were left open; see `RecordPlant.resolve_from_data`."""
        outputs = [each[self.output] for each in records]
        scale = self.output_scale or max(0.5 * max(float(np.ptp(each)) for each in outputs), 1e-12)
        pace = self.time_scale_s or max(find_pace(outputs, step_s), step_s)
        tau_s = FILTER * pace
        filtered = [
            tuple(filter_derivatives(each, 1, tau_s, step_s) for each in (record[self.input], record[self.output]))
            for record in records
        ]
        rows = [np.stack([u[:, 0], np.ones(len(u)), -y[:, 1]], axis=1) for u, y in filtered]
        skipped = int(np.ceil(8.0 * tau_s / step_s))
        gain, offset, lag = map(float, regress(rows, [y[:, 0] for _, y in filtered], skipped))
        lag = lag if lag > 0.0 else pace
        largest = max(float(np.abs(each[self.input]).max()) for each in records) or 1.0
        wide = max(abs(gain), scale / max(largest, 1e-12))
        far = max(float(np.abs(np.concatenate(outputs)).max()), scale)
        guessed = {
            "gain": (gain, -20.0 * wide, 20.0 * wide, wide),
            "offset": (offset, -20.0 * far, 20.0 * far, far),
            "time_constant_s": (lag, 0.01 * lag, 100.0 * lag, lag),
            "input_delay_s": (0.0, -step_s, step_s, 0.5 * step_s),
        }
        return self.fill_in(guessed, output_scale=scale, time_scale_s=pace)

    def simulate(
        self,
        signals: Signals,
        step_s: float,
        start_s: Array,
        constants: Values,
        effects: Sequence[Placed] = (),
        begun: InitialState | None = None,
    ) -> Array:
        """Return the output, (T, R); see `RecordPlant.simulate`."""
        scale, time_scale_s = self.know("output_scale"), self.know("time_scale_s")
        pace = step_s / time_scale_s
        terms = collect(LagTerms, SITE, self.place(effects))
        terms = terms._replace(delay=terms.delay + constants["input_delay_s"] / time_scale_s)
        per_pace = time_scale_s / constants["time_constant_s"]
        quickest = max(pace / FINEST, pace * per_pace * (1.0 + abs(terms.asymmetry)))
        substeps = min(max(int(np.ceil(quickest)), 2), 100)
        aim = constants["gain"] * signals[self.input] / scale
        columns = np.ascontiguousarray(aim.T)
        ends = [each - constants["offset"] / scale for each in (terms.lowest, terms.highest)]

        def run(state: Array, chosen: NDArray[np.int_], samples: int) -> Array:
            filled = (
                _fill(columns[k, :samples], float(start), per_pace, terms, pace, substeps)
                for k, start in zip(chosen, state[0], strict=True)
            )
            return read(np.stack(list(filled), axis=1), terms.unread, *ends)

        start = columns[None, :, 0]
        if begun is not None:
            start = (begun.value[None] - constants["offset"]) / scale
            if self.output in signals:
                heads = (signals[self.output][:HEAD] - constants["offset"]) / scale
                error, noise = np.maximum(begun.value_error[None] / scale, 1e-6), begun.noise / scale
                start = begin(run, start, error, heads, noise)
        return constants["offset"] + scale * run(start, np.arange(len(columns)), columns.shape[1])

    def respond(self, features: Array, step_s: float) -> Array:
        """Return features both as they are and as the lag answers to them, (T, K, 2 F)."""
        from scipy.signal import lfilter

        decay = np.exp(-step_s / self.starts["time_constant_s"])
        answer = lfilter([1.0 - decay], [1.0, -decay], features, axis=0)
        return np.concatenate([features, answer], axis=2)


PLANT = FirstOrder
