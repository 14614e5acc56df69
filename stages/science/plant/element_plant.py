"""An element on a test bench, of whatever law: it answers at once to what is measured while it is moved along a way.

Signals of records flow in; the answer flows out. A subclass says how constants make the answer; effects of the site
`element` change it, in the element's own scales.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from stages.science.plant.effect import Bench
from stages.science.plant.effect_config import EffectConfig
from stages.science.plant.record_plant import InitialState, Placed, Positive, RecordPlant, Watched
from stages.science.signals.trajectories import Array

SITE = "element"


class _ElementEffect(EffectConfig):
    SITE = SITE


class ElementPlant(RecordPlant):
    """Everything that simulating an element takes."""

    SITE: ClassVar[str] = SITE
    ELEMENT: ClassVar[str] = SITE

    along: str = Field(description="signal along which the element is moved")
    along_middle: float | None = Field(description="value of `along` from which effects count, its unit")
    along_scale: Positive | None = Field(description="way in which effects tell theirs, unit of `along`")
    output_scale: Positive | None = Field(description="answer in which effects tell their sizes, unit of the output")
    time_scale_s: Positive | None = Field(description="time of a usual movement through one scale, s")
    effects: list[_ElementEffect]

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        named = [entry.name for entry in self.effects]
        if len(set(named)) < len(named):
            raise ValueError("effects: expected each name once")
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which the element is moved first."""
        return (self.along,)

    @property
    def finest_s(self) -> float:
        """Time between samples, s, below which more of them tell no more."""
        return 0.01 * self.movement_s

    @property
    def movement_s(self) -> float:
        """Time of a movement through one scale, s."""
        return self.time_scale_s or 1.0

    @property
    def memory_s(self) -> float:
        """None: it answers at once."""
        return 0.0

    @abstractmethod
    def answer(self, signals: Mapping[str, Array], constants: Mapping[str, float]) -> Array:
        """Return what the element would answer without any effect, of the signals' shape."""

    @abstractmethod
    def guess(self, signals: Mapping[str, Array]) -> dict[str, tuple[float, float, float, float]]:
        """Return start, bounds and deviation of each constant, from all records one after another, (N,) by name."""

    def find_scales(self, records: Sequence[Mapping[str, Array]], step_s: float) -> dict[str, float]:
        """Return what scales are if they were left open, told by the signal along which the element is moved."""
        along, answer = (np.concatenate([each[name] for each in records]) for name in (self.along, self.output))
        way = max(0.5 * float(np.ptp(along)), 1e-12)
        speed = float(np.mean(np.concatenate([np.abs(np.diff(each[self.along])) for each in records]))) / step_s
        return {
            "along_middle": 0.5 * float(along.max() + along.min()),
            "along_scale": way,
            "output_scale": max(0.5 * float(np.ptp(answer)), 1e-12),
            "time_scale_s": way / speed if speed > 0.0 else 1.0,
        }

    def simulate(
        self,
        signals: Mapping[str, Array],
        step_s: float,
        start_s: Array,
        constants: Mapping[str, float],
        effects: Sequence[Placed] = (),
        begun: InitialState | None = None,
    ) -> Array:
        """Return the answer, (T, R); see `RecordPlant.simulate`."""
        answer = self.answer(signals, constants)
        placed = self.place(effects)
        if not placed:
            return answer
        scale, bench = self.know("output_scale"), self.set_up(signals[self.along], step_s, start_s)
        changed = answer / scale
        for effect, values in placed:
            changed = effect.apply(changed, bench, values)
        return changed * scale

    def set_up(self, along: Array, step_s: float, start_s: Array) -> Bench:
        """Return what effects look at, for a signal along which records are moved, (T, R)."""
        time_scale_s = self.know("time_scale_s")
        way = np.ascontiguousarray((along - self.know("along_middle")) / self.know("along_scale"))
        within = np.arange(len(along))[:, None] * step_s
        rate = np.gradient(way, step_s, axis=0) * time_scale_s
        return Bench(way, rate, step_s, time_scale_s, within + start_s)

    def watch(self, signals: Mapping[str, Array], step_s: float, constants: Mapping[str, float]) -> list[Watched]:
        """Return the inputs, and how the element is moved."""
        rate = self.set_up(signals[self.along], step_s, np.zeros(1)).rate
        along, *others = (Watched(name, signals[name], False) for name in self.inputs)
        return [along, Watched(f"rate of {self.along}", rate, True), *others]
