"""An element on a test bench: an answer that is a sum of constants, each times a product of measured signals.

A spring under test is a constant times position and an offset; a McKibben muscle at a fixed length, constants times
pressure; a pneumatic cylinder, pressures and a friction that is an effect. Signals of records flow in, with constants
and effects; the answer flows out. The signals `path` and `rate` are displacement and its rate. What depends on the
history of displacement is never nominal: it has a name, or none.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from stages.science.plant.effect import Parameter, Signals, Values
from stages.science.plant.effect_config import NominalConstant
from stages.science.plant.element_plant import PATH, RATE, ElementPlant
from stages.science.signals.trajectories import Array

FURTHEST = 20.0
"""Bound of a constant that the configuration leaves open: how often its product may be the answer's scale."""


class MapConstant(NominalConstant):
    """A constant and the signals whose product it multiplies."""

    of: list[str] = Field(description="none for an offset, one twice for a square; a key such as along for its signal")


class ProductPlant(ElementPlant):
    """An element whose answer is such a sum; a subclass declares its kind, and keys that name signals."""

    constants: dict[str, MapConstant] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _name_signals(cls, section: Any) -> Any:
        """Put signals in place of the keys that name them, and leave out products of a signal that there is not."""
        if not isinstance(section, Mapping) or not isinstance(section.get("constants"), Mapping):
            return section
        keys = {key for key, each in cls.model_fields.items() if each.annotation in (str, str | None)}
        keys -= {"kind", "output", *(each for each in cls.model_fields if each not in section)}

        def name(told: Any) -> Any:
            return [section[each] if each in keys else each for each in told] if isinstance(told, list) else told

        constants = {}
        for key, each in section["constants"].items():
            multiplied = name(each["of"]) if isinstance(each, Mapping) and "of" in each else None
            if multiplied is None or None not in multiplied:
                constants[key] = each if multiplied is None else {**each, "of": multiplied}
        pressing = [each for each in name(section.get("pressing", [])) if each is not None]
        return {**section, "constants": constants, **({"pressing": pressing} if "pressing" in section else {})}

    @property
    def inputs(self) -> tuple[str, ...]:
        """Signals that the answer is told from, the one along which it is moved first."""
        multiplied = (name for each in self.constants.values() for name in each.of if name not in (PATH, RATE))
        return tuple(dict.fromkeys([*super().inputs, *multiplied]))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants as a fit takes them."""
        return tuple(
            each.as_parameter(name, f"times {' times '.join(each.of)}" if each.of else "offset")
            for name, each in self.constants.items()
        )

    def answer(self, signals: Signals, constants: Values) -> Array:
        """Return the sum of the constants' products."""
        shape = signals[self.along].shape
        answer = np.zeros(shape)
        for name, each in self.constants.items():
            product = np.full(shape, constants[name])
            for signal in each.of:
                product = product * signals[signal]
            answer += product
        return answer

    def guess(self, signals: Signals) -> dict[str, tuple[float, float, float, float]]:
        """Return zero for each, and bounds by the measured ranges."""
        largest = {name: max(float(np.abs(values).max()), 1e-12) for name, values in signals.items()}
        largest[PATH] = max(float(np.abs(self.displace(signals)).max()), 1e-12)
        largest[RATE] = self.know("along_scale") / self.know("time_scale_s")
        most = FURTHEST * max(self.know("output_scale"), largest[self.output])
        guessed = {}
        for name, each in self.constants.items():
            bound = most / float(np.prod([largest[signal] for signal in each.of]))
            guessed[name] = (0.0, -bound, bound, 0.5 * bound)
        return guessed
