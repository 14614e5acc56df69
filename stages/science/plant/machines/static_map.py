"""An element on a test bench: an answer that is a sum of constants, each times a product of measured signals.

A spring under test is a constant times position and an offset; a McKibben muscle at a fixed length, constants times
pressure; a pneumatic cylinder, pressures and a friction that is an effect. Signals of records flow in, with constants
and effects; the answer flows out. What depends on the way or the speed is never nominal: it has a name, or none.
"""

from collections.abc import Mapping
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from stages.science.plant.effect import Parameter
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.element_plant import ElementPlant
from stages.science.signals.trajectories import Array

FURTHEST = 20.0
"""Bound of a constant that the configuration leaves open: how often its product may be the answer's scale."""


class MapConstant(NominalConstant):
    """A constant and the signals whose product it multiplies."""

    of: list[str] = Field(description="none for an offset, one twice for a square; along stands for that of `along`")


class StaticMap(ElementPlant):
    """Everything that simulating such an element takes."""

    kind: Literal["static_map"]
    constants: dict[str, MapConstant] = Field(min_length=1)

    @model_validator(mode="after")
    def _name_way(self) -> Self:
        for each in self.constants.values():
            each.of[:] = [self.along if signal == "along" else signal for signal in each.of]
        return self

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which it is moved first."""
        return tuple(dict.fromkeys([self.along, *(name for each in self.constants.values() for name in each.of)]))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants as a fit takes them."""
        return tuple(
            each.as_parameter(name, f"times {' times '.join(each.of)}" if each.of else "offset")
            for name, each in self.constants.items()
        )

    def answer(self, signals: Mapping[str, Array], constants: Mapping[str, float]) -> Array:
        """Return the sum of the constants' products."""
        shape = signals[self.along].shape
        answer = np.zeros(shape)
        for name, each in self.constants.items():
            product = np.full(shape, constants[name])
            for signal in each.of:
                product = product * signals[signal]
            answer += product
        return answer

    def guess(self, signals: Mapping[str, Array]) -> dict[str, tuple[float, float, float, float]]:
        """Return zero for each, and bounds by the measured ranges."""
        largest = {name: max(float(np.abs(values).max()), 1e-12) for name, values in signals.items()}
        most = FURTHEST * max(self.know("output_scale"), largest[self.output])
        guessed = {}
        for name, each in self.constants.items():
            bound = most / float(np.prod([largest[signal] for signal in each.of]))
            guessed[name] = (0.0, -bound, bound, 0.5 * bound)
        return guessed


PLANT = StaticMap
