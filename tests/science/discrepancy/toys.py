"""An output whose simulation is known in closed form: a line, and effects with known shapes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stages.science.output_channels.output_channel import DetectionSettings, Driver, OutputChannel
from stages.science.plant.effect import NamedEffect, Parameter
from tests.science.discrepancy.searches import DISCREPANCY


def constant(name, low, high, mean, sd):
    return Parameter(name, "1", low, high, mean, sd, name, (mean,))


@dataclass(frozen=True, kw_only=True)
class Shaped(NamedEffect):
    """An effect that adds a shape of x."""

    form: str = "only"
    site: str = "muscle"
    parameters: tuple[Parameter, ...] = (Parameter("size", "1", 0.0, 10.0, 0.5, 5.0, "size", (0.5, 2.0)),)
    source: str = ""
    signature: str = ""
    split_by: str = ""
    effect: Callable[[np.ndarray], np.ndarray]


def form(name, shape):
    return Shaped(name=name, effect=shape)


WAVE = form("wave", lambda x: np.sin(3.0 * x))
KINK = form("kink", lambda x: np.maximum(x - 1.0, 0.0))
LINE = form("line", lambda x: x)
RISING = form("rising", lambda x: np.sign(np.gradient(x, axis=0)))
"""Depends on where x goes, not on where it is."""


@dataclass(frozen=True)
class Toy(OutputChannel):
    """y = offset + slope x + effects, over K trials."""

    x: np.ndarray
    measured: np.ndarray
    present: np.ndarray
    start_s: np.ndarray
    step_s: float = 0.01
    channel: str = "y"
    element: str = "toy"
    unit: str = "1"
    limits: DetectionSettings = DISCREPANCY.detection
    offered: tuple[NamedEffect, ...] = (WAVE, KINK, LINE)
    beside: tuple[Driver, ...] = ()

    @property
    def constants(self):
        return (constant("offset", -5.0, 5.0, 0.0, 2.0), constant("slope", -5.0, 5.0, 1.0, 2.0))

    @property
    def forms(self):
        return self.offered

    def simulate(self, constants, effects):
        y = constants["offset"] + constants["slope"] * self.x
        for each, values in effects:
            y = y + values["size"] * each.effect(self.x)
        return y

    def drivers(self):
        rate = np.gradient(self.x, self.step_s, axis=0)
        return [Driver("x", self.x), Driver("x_rate", rate, rate=True), *self.beside]

    def take(self, trials):
        chosen = list(trials)
        return replace(self, **{n: getattr(self, n)[..., chosen] for n in ("x", "measured", "present", "start_s")})


def make_toy(seed, hidden=(), noise=0.1, trials=8, samples=300, wander=0.0, element="toy", **kwargs):
    """Return a toy with hidden effects: pairs of a shape and its size."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples)[:, None] * 0.01
    speed = generator.uniform(1.5, 5.0, trials)
    x = 1.2 * np.sin(speed * time + generator.uniform(0.0, 6.0, trials)) + generator.uniform(-0.6, 0.6, trials)
    y = 0.3 + 1.4 * x + sum(size * shape(x) for shape, size in hidden)
    y = y + noise * generator.standard_normal(x.shape) + wander * generator.standard_normal(trials)
    return Toy(x, y, np.ones(x.shape, dtype=bool), np.arange(trials) * 10.0, element=element, **kwargs)
