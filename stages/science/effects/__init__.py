"""Physical effects, one small module each, and what several of them share."""

from collections.abc import Callable

import numpy as np

from stages.science.plant.effect import Parameter, State, Values
from stages.science.plant.muscle import pull_at_rest
from stages.science.signals.operators import follow_stops
from stages.science.signals.trajectories import Array

PRESLIDING = Parameter(
    "presliding", "1", 0.0001, 0.004, 0.001, 0.001, "contraction over which it yields first", (0.0008, 0.0025)
)
"""Of a cable's dry friction that turns gradually after a reversal."""


def name_terms(**names: str) -> Callable[[Values], dict[str, float]]:
    """Return what gives each term, by its name, the value of the parameter that is named there."""
    return lambda parameters: {term: parameters[name] for term, name in names.items()}


def take_share(
    shape: Callable[[State, Values], Array], at_pressure: bool = False
) -> Callable[[Array, State, Values], Array]:
    """Return what takes from a force a share of the largest one, or of that at this pressure, times a shape (T, K)."""

    def apply(signal: Array, state: State, parameters: Values) -> Array:
        whole = pull_at_rest(state.pressure_kpa, state.muscles) if at_pressure else state.muscles.full_force_n
        return signal - parameters["share"] * whole * shape(state, parameters)

    return apply


def slide(state: State, parameters: Values) -> Array:
    """Return the direction of a cable's friction, (T, K); where it is told how, the cable yields before it slides."""
    if "presliding" in parameters:
        return follow_stops(state.contraction, np.array([parameters["presliding"]]))
    return np.tanh(state.velocity_per_s / parameters["sliding_per_s"])
