"""An element on a test bench: an answer that is a sum of constants, each times a product of measured signals.

A spring under test is a constant times position and an offset; a McKibben muscle at a fixed length, constants times
pressure; a pneumatic cylinder, pressures and a friction that is an effect. Signals of records flow in, with constants
and effects; the answer flows out. What depends on the way or the speed is never nominal: it has a name, or none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self, cast

import numpy as np
from pydantic import Field, model_validator

from stages.plant.declaration import Declared
from stages.plant.effect import Bench, ElementEffect, Parameter
from stages.plant.listed import ListedEffect, find_effect_at
from stages.signals.trajectories import Array

SITE = "element"
Positive = Annotated[float, Field(gt=0.0)]
Placed = tuple[ElementEffect, Mapping[str, float]]


FURTHEST = 20.0
"""Bound of a constant that the configuration leaves open: how often its product may be the answer's scale."""


class MapConstant(Declared):
    """A constant and the signals whose product it multiplies; where it begins and may go is null for the data's own."""

    unit: str
    of: list[str] = Field(description="none for an offset, one twice for a square")
    start: float | None
    low: float | None
    high: float | None
    sd: float | None

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        known = [each for each in (self.start, self.low, self.high, self.sd) if each is not None]
        if not known:
            return self
        if len(known) < 4:
            raise ValueError("expected start, low, high and sd, or null for all of them")
        start, low, high, sd = known
        if not low <= start <= high or low == high or sd <= 0.0:
            raise ValueError(f"expected low <= start <= high, low < high and sd > 0, got {low}, {start}, {high}, {sd}")
        return self

    def settle(self, bound: float) -> MapConstant:
        """Return the constant with bounds, where it has none: zero, plus or minus a bound."""
        if self.start is not None:
            return self
        return self.model_copy(update={"start": 0.0, "low": -bound, "high": bound, "sd": 0.5 * bound})

    def as_parameter(self, name: str) -> Parameter:
        """Return what a fit takes.

        Raises
        ------
        ValueError
            While its bounds are open.
        """
        if self.start is None or self.low is None or self.high is None or self.sd is None:
            raise ValueError(f"constant {name}: its bounds are the data's own, and there are no data yet")
        description = f"times {' times '.join(self.of)}" if self.of else "offset"
        return Parameter(name, self.unit, self.low, self.high, self.start, self.sd, description, (self.start,))


class MapEffect(ListedEffect):
    """An effect that acts at an element."""

    SITE = SITE

    @property
    def effect(self) -> ElementEffect:
        """The effect itself."""
        return find_element_effect(self.name, self.form)


def find_element_effect(name: str, form: str | None) -> ElementEffect:
    """Return an effect that acts at an element, in the form given or its first; see `find_effect_at`."""
    return cast(ElementEffect, find_effect_at(SITE, name, form))


class StaticMap(Declared):
    """Everything that simulating an element takes."""

    SITE: ClassVar[str] = SITE

    kind: Literal["static_map"]
    along: str = Field(description="signal along which the element is moved")
    output: str = Field(description="signal that answers")
    along_middle: float | None = Field(description="value of `along` from which effects count, its unit")
    along_scale: Positive | None = Field(description="way in which effects tell theirs, unit of `along`")
    output_scale: Positive | None = Field(description="answer in which effects tell their sizes, unit of the output")
    pace_s: Positive | None = Field(description="time of a usual movement through one scale, s")
    constants: dict[str, MapConstant] = Field(min_length=1)
    effects: list[MapEffect]

    @model_validator(mode="after")
    def _check_signals(self) -> Self:
        if self.output in self.inputs:
            raise ValueError(f"output: expected another signal than those it is told from, got {self.output}")
        named = [entry.name for entry in self.effects]
        if len(set(named)) < len(named):
            raise ValueError("effects: expected each name once")
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which it is moved first."""
        return tuple(dict.fromkeys([self.along, *(name for each in self.constants.values() for name in each.of)]))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants as a fit takes them."""
        return tuple(each.as_parameter(name) for name, each in self.constants.items())

    def settle(self, signals: Mapping[str, Array], step_s: float) -> StaticMap:
        """Return the plant with scales and bounds, where they were left open, from recorded signals.

        Parameters
        ----------
        signals : mapping of str to (N,) ndarray
            Inputs and output by name, without gaps; records one after the other.
        step_s : float
            Time between samples, s.
        """
        along, answer = signals[self.along], signals[self.output]
        way, size = max(0.5 * float(np.ptp(along)), 1e-12), max(0.5 * float(np.ptp(answer)), 1e-12)
        speed = float(np.abs(np.diff(along)).mean()) / step_s
        own = {
            "along_middle": 0.5 * float(along.max() + along.min()),
            "along_scale": way,
            "output_scale": size,
            "pace_s": way / speed if speed > 0.0 else 1.0,
        }
        scales = {name: value if getattr(self, name) is None else getattr(self, name) for name, value in own.items()}
        largest = {name: max(float(np.abs(values).max()), 1e-12) for name, values in signals.items()}
        most = FURTHEST * max(scales["output_scale"], largest[self.output])
        constants = {
            name: each.settle(most / float(np.prod([largest[signal] for signal in each.of])))
            for name, each in self.constants.items()
        }
        return self.model_copy(update={**scales, "constants": constants})

    def simulate(
        self,
        signals: Mapping[str, Array],
        step_s: float,
        start_s: Array,
        constants: Mapping[str, float],
        effects: Sequence[Placed] = (),
    ) -> Array:
        """Return the answer, (T, R), in the output's unit.

        Parameters
        ----------
        signals : mapping of str to (T, R) ndarray
            By name, without gaps; R records.
        step_s : float
            Time between samples, s.
        start_s : (R,) ndarray
            Start of each record in the session, s.
        constants : mapping of str to float
            By name.
        effects : sequence of (ElementEffect, mapping)
            Beside those listed, which act first.
        """
        shape = signals[self.along].shape
        answer = np.zeros(shape)
        for name, each in self.constants.items():
            product = np.full(shape, constants[name])
            for signal in each.of:
                product = product * signals[signal]
            answer += product
        placed = [*((entry.effect, entry.parameters) for entry in self.effects), *effects]
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

    def watch(self, signals: Mapping[str, Array], step_s: float) -> list[tuple[str, Array, bool]]:
        """Return what may explain a residual, by name, and whether it is a rate: the inputs, and how it is moved."""
        rate = self.set_up(signals[self.along], step_s, np.zeros(1)).rate
        others = [(name, signals[name], False) for name in self.inputs[1:]]
        return [(self.along, signals[self.along], False), (f"rate of {self.along}", rate, True), *others]

    def amend(self, constants: Mapping[str, float], effects: Sequence[Placed]) -> StaticMap:
        """Return the plant with fitted constants and with effects added to its list."""
        fitted = {name: self.constants[name].model_copy(update={"start": value}) for name, value in constants.items()}
        added = [MapEffect(name=e.name, form=e.form, parameters=dict(values)) for e, values in effects]
        return self.model_copy(update={"constants": fitted, "effects": [*self.effects, *added]})
