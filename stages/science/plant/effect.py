"""What a named effect is: a site, parameters with their priors, a source, and one of four shapes.

A chain effect maps whole arrays at its site; a joint effect adds to the terms of the joints' one compiled integrator,
and a dynamic effect to that of another machine; an element effect maps what an element on a test bench answers. In all,
the first parameter is the magnitude, and zero magnitude means that the effect is absent. An effect may have several
forms in the literature: they share its name, and the module of that name lists them.
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from stages.science.plant.declaration import list_modules, nearest
from stages.science.plant.muscle import MuscleConstants
from stages.science.signals.trajectories import Array

Site = Literal["command", "valve", "pressure", "muscle", "transmission", "joint", "sensor"]
Signal = Literal[
    "pressure_command_kpa",
    "pressure_kpa",
    "sensed_pressure_kpa",
    "acting_pressure_kpa",
    "contraction",
    "force_n",
    "tension_n",
    "sensed_force_n",
]
Values = Mapping[str, float]
"""Parameters of an effect, or constants of a machine, by name."""
Signals = Mapping[str, Array]
"""Signals by name, of one shape."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, with closed bounds and a Gaussian prior that is cut there."""

    name: str
    """Ends with its unit, where it has one."""
    unit: str
    """``"1"`` for a ratio."""
    low: float
    high: float
    prior_mean: float
    prior_sd: float
    description: str
    starts: tuple[float, ...]
    """Where a fit begins, within the bounds; of the magnitude, none is zero."""
    optional: bool = False
    """Whether a list of effects may leave it out."""


@dataclass(frozen=True)
class State:
    """What a chain effect may look at beside the signal that it maps; arrays have the signal's shape (T, K).

    Signals are those at this point of the chain. Upstream of the muscle contraction and velocity are zero; from there
    on the command is the pressure at the valve, and the pressure the one that acts.
    """

    step_s: float
    muscles: MuscleConstants
    command_kpa: Array
    pressure_kpa: Array
    contraction: Array
    velocity_per_s: Array
    time_s: Array
    """Time within the trial, (T,)."""
    start_s: Array
    """When each column's trial began in the session, (K,); zero where that is not known."""

    def select(self, columns: NDArray[np.bool_]) -> Self:
        """Return the state of some columns; `columns` is a (K,) mask."""
        changed: dict[str, Any] = {
            name: np.ascontiguousarray(getattr(self, name)[:, columns])
            for name in ("command_kpa", "pressure_kpa", "contraction", "velocity_per_s")
        }
        muscles = MuscleConstants(*(constant[columns] for constant in self.muscles))
        return replace(self, muscles=muscles, start_s=self.start_s[columns], **changed)


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """What every effect tells: its name and the literature's form of it, where it acts, and the rest."""

    name: str
    form: str
    site: str
    parameters: tuple[Parameter, ...]
    """The magnitude first."""
    source: str
    """Where the form comes from."""
    signature: str
    """What its absence from a model leaves in the residual, in one sentence."""
    split_by: str
    """The experiment that tells it from effects that ordinary excitation may not tell from it."""
    scales: bool = True
    """Whether what it does grows in proportion to its magnitude, to begin with."""
    tried: bool = False
    """Whether a search judges it by some steps of a fit from each of its starts, and not by a slope."""


@dataclass(frozen=True, kw_only=True)
class ChainEffect(NamedEffect):
    """An effect that maps whole arrays: ``apply(signal, state, parameters)`` returns a new array of their shape."""

    site: Site
    signal: Signal
    apply: Callable[[Array, State, Mapping[str, float]], Array]
    invert: Callable[[Array, State, Mapping[str, float]], Array] | None = None
    """Returns the signal of which ``apply`` made another; without it, fixed-point passes of ``apply`` do."""


@dataclass(frozen=True, kw_only=True)
class JointEffect(NamedEffect):
    """An effect inside the joint's motion: ``terms(parameters)`` returns what it adds to the integrator's terms."""

    site: Site = "joint"
    terms: Callable[[Mapping[str, float]], dict[str, float]]


@dataclass(frozen=True, kw_only=True)
class DynamicEffect(NamedEffect):
    """An effect inside a machine that is one integrator: ``terms(parameters)`` returns what it adds to its terms.

    The site is the machine's `SITE`. Sizes are told in the machine's own scales, so that bounds hold for every machine
    of the kind. One that does not scale sets in somewhere: then a fit has to be tried from each of its starts.
    """

    terms: Callable[[Mapping[str, float]], dict[str, float]]
    unsigned: bool = False
    """Whether it leaves no reading below zero. Then it is none of an output with some, and constants begin anew."""


@dataclass(frozen=True)
class Bench:
    """What an effect of an element may look at beside the answer that it maps; arrays are (T, R), a column a record."""

    along: Array
    """The signal along which the element is moved, over its scale, zero in the middle of its range."""
    rate: Array
    """How fast it is moved, scales per pace."""
    step_s: float
    time_scale_s: float
    """Time of a usual movement through one scale."""
    session_s: Array
    """Time in the session."""
    load: Array
    """What presses surfaces on each other, over its largest; one where the element does not tell what does."""


@dataclass(frozen=True, kw_only=True)
class ElementEffect(NamedEffect):
    """An effect of an element on a test bench: ``apply(answer, bench, parameters)`` returns the changed answer.

    The answer is over its scale, so that bounds hold for every element. None that has several sliders scales either,
    as no one slope tells them apart.
    """

    form: str = "element"
    site: Literal["element"] = "element"
    apply: Callable[[Array, Bench, Mapping[str, float]], Array]
    loaded: bool = False
    """Whether it grows with the load: it acts only in elements that tell what presses."""


Effect = ChainEffect | JointEffect | DynamicEffect | ElementEffect

EFFECTS = "stages.science.effects"


def list_effects() -> tuple[str, ...]:
    """Return the names of all effects: the modules of `EFFECTS`."""
    return list_modules(EFFECTS)


def name_module(effect: str) -> str:
    """Return the dotted name of the module of an effect."""
    return f"{EFFECTS}.{effect}"


@cache
def list_forms(name: str) -> tuple[Effect, ...]:
    """Return an effect's forms, the usual one first.

    Raises
    ------
    ValueError
        When there is no such effect, offering the nearest name.
    """
    known = list_effects()
    if name not in known:
        raise ValueError(f"unknown effect '{name}': {nearest(name, known)}")
    module = importlib.import_module(name_module(name))
    return getattr(module, "FORMS", (module.EFFECT,))


def find_effect(name: str, form: str | None = None) -> Effect:
    """Return an effect by name, in the form given or its usual one.

    Raises
    ------
    ValueError
        When there is none, offering the nearest name.
    """
    forms = list_forms(name)
    for effect in forms:
        if form is None or effect.form == form:
            return effect
    raise ValueError(f"effect {name} has no form '{form}': {nearest(str(form), [each.form for each in forms])}")
