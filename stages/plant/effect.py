"""What a named effect is: a site, parameters with their priors, a source, and one of two forms.

A chain effect maps whole arrays at its site; a joint effect adds to the terms of the one compiled integrator. In both,
the first parameter is the magnitude, and zero magnitude means that the effect is absent.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

from stages.plant.declaration import nearest
from stages.plant.muscle import MuscleConstants
from stages.signals.trajectories import Array

Site = Literal["command", "valve", "pressure", "muscle", "transmission", "joint"]
Signal = Literal["pressure_command_kpa", "pressure_kpa", "acting_pressure_kpa", "contraction", "force_n", "tension_n"]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name : str
        Ends with its unit, where it has one.
    unit : str
        ``"1"`` for a ratio.
    low, high : float
        Closed bounds.
    prior_mean, prior_sd : float
        Of a Gaussian prior, cut at the bounds.
    description : str
        One line.
    """

    name: str
    unit: str
    low: float
    high: float
    prior_mean: float
    prior_sd: float
    description: str


@dataclass(frozen=True)
class State:
    """What a chain effect may look at beside the signal that it maps; every array has the signal's shape (T, K).

    Parameters
    ----------
    step_s : float
        Time between samples.
    muscles : MuscleConstants
        Constants of the K columns.
    command_kpa, pressure_kpa, contraction, velocity_per_s : (T, K) ndarray
        Signals at this point of the chain. Upstream of the muscle the last two are zero; from there on the first is the
        pressure at the valve, and the second the pressure that acts.
    """

    step_s: float
    muscles: MuscleConstants
    command_kpa: Array
    pressure_kpa: Array
    contraction: Array
    velocity_per_s: Array


@dataclass(frozen=True)
class ChainEffect:
    """An effect that maps whole arrays: ``apply(signal, state, parameters)`` returns the changed signal."""

    name: str
    site: Site
    signal: Signal
    parameters: tuple[Parameter, ...]
    source: str
    apply: Callable[[Array, State, Mapping[str, float]], Array]


@dataclass(frozen=True)
class JointEffect:
    """An effect inside the joint's motion: ``terms(parameters)`` returns what it adds to the integrator's terms."""

    name: str
    parameters: tuple[Parameter, ...]
    source: str
    terms: Callable[[Mapping[str, float]], dict[str, float]]
    site: Site = "joint"


Effect = ChainEffect | JointEffect


@cache
def list_effects() -> tuple[str, ...]:
    """Return the names of all effects: the modules of ``stages.plant.effects``."""
    package = importlib.import_module("stages.plant.effects")
    return tuple(sorted(module.name for module in pkgutil.iter_modules(package.__path__)))


def find_effect(name: str) -> Effect:
    """Return an effect by name.

    Raises
    ------
    ValueError
        When there is none, offering the nearest name.
    """
    known = list_effects()
    if name not in known:
        raise ValueError(f"unknown effect '{name}': {nearest(name, known)}")
    effect: Effect = importlib.import_module(f"stages.plant.effects.{name}").EFFECT
    return effect
