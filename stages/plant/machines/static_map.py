"""An element on a test bench: an answer that is a sum of constants, each times a product of measured signals.

A spring under test is a constant times position and an offset; a McKibben muscle at a fixed length, constants times
pressure; a pneumatic cylinder, pressures and a friction that is an effect. Signals of records flow in, with constants
and effects; the answer flows out. What depends on the way or the speed is never nominal: it has a name, or none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from stages.plant.effect import Bench, Parameter
from stages.plant.listed import ListedEffect, NominalConstant
from stages.plant.record_plant import Beginning, Placed, Positive, RecordPlant, Watched
from stages.signals.trajectories import Array

SITE = "element"
FURTHEST = 20.0
"""Bound of a constant that the configuration leaves open: how often its product may be the answer's scale."""


class MapConstant(NominalConstant):
    """A constant and the signals whose product it multiplies."""

    of: list[str] = Field(description="none for an offset, one twice for a square")


class MapEffect(ListedEffect):
    """An effect that acts at an element."""

    SITE = SITE


class StaticMap(RecordPlant):
    """Everything that simulating an element takes."""

    SITE: ClassVar[str] = SITE

    kind: Literal["static_map"]
    along: str = Field(description="signal along which the element is moved")
    along_middle: float | None = Field(description="value of `along` from which effects count, its unit")
    along_scale: Positive | None = Field(description="way in which effects tell theirs, unit of `along`")
    output_scale: Positive | None = Field(description="answer in which effects tell their sizes, unit of the output")
    pace_s: Positive | None = Field(description="time of a usual movement through one scale, s")
    constants: dict[str, MapConstant] = Field(min_length=1)
    effects: list[MapEffect]

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        named = [entry.name for entry in self.effects]
        if len(set(named)) < len(named):
            raise ValueError("effects: expected each name once")
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which it is moved first."""
        return tuple(dict.fromkeys([self.along, *(name for each in self.constants.values() for name in each.of)]))

    @property
    def element(self) -> str:
        """What the machine is called in tables."""
        return SITE

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants as a fit takes them."""
        return tuple(
            each.as_parameter(name, f"times {' times '.join(each.of)}" if each.of else "offset")
            for name, each in self.constants.items()
        )

    @property
    def finest_s(self) -> float:
        """Time between samples, s, below which more of them tell no more."""
        return 0.01 * self.movement_s

    @property
    def movement_s(self) -> float:
        """Time of a movement through one scale, s."""
        return self.pace_s or 1.0

    def settle(self, records: Sequence[Mapping[str, Array]], step_s: float) -> Self:
        """Return the plant with scales and bounds, where they were left open; see `RecordPlant.settle`."""
        signals = {name: np.concatenate([each[name] for each in records]) for name in (*self.inputs, self.output)}
        along, answer = signals[self.along], signals[self.output]
        way, size = max(0.5 * float(np.ptp(along)), 1e-12), max(0.5 * float(np.ptp(answer)), 1e-12)
        speed = float(np.mean(np.concatenate([np.abs(np.diff(each[self.along])) for each in records]))) / step_s
        own = {
            "along_middle": 0.5 * float(along.max() + along.min()),
            "along_scale": way,
            "output_scale": size,
            "pace_s": way / speed if speed > 0.0 else 1.0,
        }
        scales = {name: value if getattr(self, name) is None else getattr(self, name) for name, value in own.items()}
        largest = {name: max(float(np.abs(values).max()), 1e-12) for name, values in signals.items()}
        most = FURTHEST * max(scales["output_scale"], largest[self.output])
        constants = {}
        for name, each in self.constants.items():
            bound = most / float(np.prod([largest[signal] for signal in each.of]))
            constants[name] = each.settle(0.0, -bound, bound, 0.5 * bound)
        return self.model_copy(update={**scales, "constants": constants})

    def simulate(
        self,
        signals: Mapping[str, Array],
        step_s: float,
        start_s: Array,
        constants: Mapping[str, float],
        effects: Sequence[Placed] = (),
        begun: Beginning | None = None,
    ) -> Array:
        """Return the answer, (T, R); see `RecordPlant.simulate`."""
        shape = signals[self.along].shape
        answer = np.zeros(shape)
        for name, each in self.constants.items():
            product = np.full(shape, constants[name])
            for signal in each.of:
                product = product * signals[signal]
            answer += product
        placed = self.place(effects)
        if not placed:
            return answer
        if self.output_scale is None:
            raise ValueError("output_scale: it is the data's own, and there are no data yet")
        bench = self.set_up(signals[self.along], step_s, start_s)
        changed = answer / self.output_scale
        for effect, values in placed:
            changed = effect.apply(changed, bench, values)
        scaled: Array = changed * self.output_scale
        return scaled

    def set_up(self, along: Array, step_s: float, start_s: Array) -> Bench:
        """Return what effects look at, for a signal along which records are moved, (T, R)."""
        if self.along_middle is None or self.along_scale is None or self.pace_s is None:
            raise ValueError("along_scale: it is the data's own, and there are no data yet")
        way = np.ascontiguousarray((along - self.along_middle) / self.along_scale)
        within = np.arange(len(along))[:, None] * step_s
        rate = np.gradient(way, step_s, axis=0) * self.pace_s
        return Bench(way, rate, step_s, self.pace_s, within + start_s)

    def watch(self, signals: Mapping[str, Array], step_s: float, constants: Mapping[str, float]) -> list[Watched]:
        """Return the inputs, and how the element is moved."""
        rate = self.set_up(signals[self.along], step_s, np.zeros(1)).rate
        others = [Watched(name, signals[name], False) for name in self.inputs[1:]]
        return [
            Watched(self.along, signals[self.along], False),
            Watched(f"rate of {self.along}", rate, True),
            *others,
        ]


PLANT = StaticMap
