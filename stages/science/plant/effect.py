"""What a named effect is: a site, parameters with their priors, a source, and one of four shapes.

A chain effect maps whole arrays at its site; a joint effect adds to the terms of the joints' one compiled integrator,
and a dynamic effect to that of another machine; an element effect maps what an element on a test bench answers. In all,
the first parameter is the magnitude, and zero magnitude means that the effect is absent. An effect may have several
forms in the literature: they share its name, and the module of that name lists them.
"""

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, Self, get_args

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
    instead_of: str = ""
    """Name of another effect that has the same cause: beside either, a search does not look for the other."""

    @property
    def begins_later(self) -> bool:
        """Whether it begins at a moment of the session."""
        return FROM_START in (each.name for each in self.parameters)


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
    """An effect of an element on a test bench: ``apply(signal, bench, parameters)`` returns the changed signal.

    The signal is the answer over its scale, so that bounds hold for every element, or what `changes` says. None that
    has several sliders scales either, as no one slope tells them apart.
    """

    form: str = "element"
    site: Literal["element"] = "element"
    apply: Callable[[Array, Bench, Mapping[str, float]], Array]
    loaded: bool = False
    """Whether it grows with the load: it acts only in elements that tell what presses."""
    changes: Literal["drive", "displacement", "answer", "reading"] = "answer"
    """What it changes: each signal that drives the element, its displacement and the rate of that, the answer, or what
    the answer's sensor shows of it. They act in this order, wherever listed."""


Effect = ChainEffect | JointEffect | DynamicEffect | ElementEffect

FROM_START = "paces_from_start"
"""Parameter of an element's effect: a moment of the session, in paces. Fits begin at moments all along it."""

EFFECTS = "stages.science.effects"
ABSENT = "none"
"""The effect without parameters, which does nothing."""
SAMPLES, COLUMNS = 16, 2
"""Of the signal on which the arrays that an effect returns are tried."""
USUAL = {"contraction": 0.1, "force_n": 200.0, "tension_n": 200.0, "sensed_force_n": 200.0}
"""Middle of a signal; of a pressure, it is 150 kPa."""


def list_effects() -> tuple[str, ...]:
    """Return the names of all effects: the modules of `EFFECTS`."""
    return list_modules(EFFECTS)


def name_module(effect: str) -> str:
    """Return the dotted name of the module of an effect."""
    return f"{EFFECTS}.{effect}"


@cache
def list_forms(name: str) -> tuple[Effect, ...]:
    """Return an effect's forms, the usual one first.

    A `ValueError` says that there is no such effect, offering the nearest name, or that no fit and no simulation could
    use what its module declares.
    """
    known = list_effects()
    if name not in known:
        raise ValueError(f"unknown effect '{name}': {nearest(name, known)}")
    try:
        module = importlib.import_module(name_module(name))
    except Exception as error:
        file = f"{name_module(name).replace('.', '/')}.py"
        raise ValueError(f"effect {name}: {file} cannot be loaded: {type(error).__name__}: {error}") from error
    forms: tuple[Effect, ...] | None = getattr(module, "FORMS", None)
    if forms is None:
        if not hasattr(module, "EFFECT"):
            raise ValueError(f"effect {name}: expected EFFECT, or FORMS, in {module.__name__}")
        forms = (module.EFFECT,)
    for effect in forms:
        problem = next(_list_problems(effect, name), None)
        if problem:
            raise ValueError(f"effect {name}, form {effect.form}: {problem}")
    return forms


def find_effect(name: str, form: str | None = None) -> Effect:
    """Return an effect by name, in the form given or its usual one.

    A `ValueError` says that there is none, offering the nearest name.
    """
    forms = list_forms(name)
    for effect in forms:
        if form is None or effect.form == form:
            return effect
    raise ValueError(f"effect {name} has no form '{form}': {nearest(str(form), [each.form for each in forms])}")


def _list_problems(effect: Effect, module: str) -> Iterator[str]:
    if effect.name != module:
        yield f"expected the name of its module, {module}, got {effect.name}"
    if isinstance(effect, ChainEffect):
        for name, value, known in (("site", effect.site, get_args(Site)), ("signal", effect.signal, get_args(Signal))):
            if value not in known:
                yield f"expected a {name} of {', '.join(known)}, got {value}"
    if not effect.parameters and module != ABSENT:
        yield "expected parameters, the magnitude first, got none"
    for number, each in enumerate(effect.parameters):
        if not each.low < each.high:
            yield f"{each.name}: expected bounds with low below high, got {each.low:g} and {each.high:g}"
        if not each.prior_sd > 0.0:
            yield f"{each.name}: expected a prior_sd above 0, got {each.prior_sd:g}"
        if not isinstance(each.starts, tuple) or not each.starts:
            yield f"{each.name}: expected starts, a tuple of numbers such as (0.1,), got {each.starts}"
        elif not all(each.low <= start <= each.high for start in each.starts):
            yield f"{each.name}: expected starts from {each.low:g} to {each.high:g}, got {each.starts}"
        elif number == 0 and 0.0 in each.starts:
            yield f"{each.name}: expected no start at 0, as the first parameter is the magnitude, got {each.starts}"
    if isinstance(effect, ChainEffect | ElementEffect) and effect.parameters:
        yield from _try(effect)


def _try(effect: ChainEffect | ElementEffect) -> Iterator[str]:
    """Yield what is wrong with the arrays that an effect returns at each of its starts, and without its magnitude."""
    signal, where = _make_samples(effect)
    for number in range(-1, max(len(each.starts) for each in effect.parameters)):
        values = {each.name: each.starts[min(max(number, 0), len(each.starts) - 1)] for each in effect.parameters}
        if number < 0:
            values[effect.parameters[0].name] = 0.0
        told = ", ".join(f"{name} {value:g}" for name, value in values.items())
        given = signal.copy()
        try:
            found = effect.apply(given, where, values)  # type: ignore[arg-type]
        except Exception as error:
            yield f"apply fails at {told}: {type(error).__name__}: {error}"
            return
        if not np.array_equal(given, signal):
            yield f"apply: expected a new array, got the signal changed in place at {told}"
        elif np.shape(found) != signal.shape:
            yield f"apply: expected an array of the signal's shape, {signal.shape}, got {np.shape(found)} at {told}"
        elif not np.isfinite(found).all():
            yield f"apply: expected finite values, got others at {told}"
        elif number < 0 and effect.parameters[0].low <= 0.0 and not np.allclose(found, signal, rtol=1e-6):
            yield f"apply: expected no change at magnitude 0, got some at {told}"


def _make_samples(effect: ChainEffect | ElementEffect) -> tuple[Array, State | Bench]:
    """Return a signal, and what is beside it."""
    wave = np.sin(np.linspace(0.0, 6.0, SAMPLES))[:, None] * np.ones(COLUMNS)
    still, step_s = np.ones(COLUMNS), 0.01
    along: Array = step_s * np.arange(SAMPLES, dtype=np.float64)
    if isinstance(effect, ElementEffect):
        session = along[:, None] * still
        return 0.5 * wave, Bench(0.5 * wave, np.gradient(wave, axis=0), step_s, 1.0, session, 0.5 + 0.2 * wave)
    constants = MuscleConstants(*np.outer(np.ones(len(MuscleConstants._fields)), still))._replace(
        braid_a=3.5 * still, valve_tau_s=0.04 * still, full_force_n=500.0 * still
    )
    rate, pressure = np.gradient(0.1 * wave, step_s, axis=0), 150.0 + 40.0 * wave
    where = State(step_s, constants, pressure, pressure, 0.1 + 0.03 * wave, rate, along, 0.0 * still)
    return USUAL.get(effect.signal, 150.0) * (1.0 + 0.3 * wave), where
