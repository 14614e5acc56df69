"""A compliant end in series with the muscle: cable and fittings stretch under tension, so the muscle is shorter.

The contraction that acts is that of the geometry plus the stretch, which is in balance with the static law's tension.
"""

import numpy as np
from numba import njit

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.plant.muscle import MuscleConstants, pull
from stages.science.signals.trajectories import Array

PASSES = 8


@njit(cache=True, error_model="numpy")
def _balance(pressure: Array, contraction: Array, velocity: Array, muscles: MuscleConstants, stretch: float) -> Array:
    """Newton's rule from no stretch: tension is convex and falls with contraction, so it never oversteps."""
    acting = np.empty_like(contraction)
    for m in range(contraction.shape[1]):
        area = muscles.area_n_per_kpa[m] * muscles.area_factor[m]
        a, factor = muscles.braid_a[m], muscles.contraction_factor[m]
        linear, quadratic = muscles.passive_linear_n[m], muscles.passive_quadratic_n[m]
        per_n = stretch / muscles.full_force_n[m]
        for k in range(contraction.shape[0]):
            x = contraction[k, m]
            for _ in range(PASSES):
                tension = pull(pressure[k, m], x, velocity[k, m], muscles, m)
                slope = -2.0 * pressure[k, m] * area * a * factor * (1.0 - factor * x) - linear - 2.0 * quadratic * x
                falling = min(slope, 0.0) if tension > 0.0 else 0.0
                x -= (x - contraction[k, m] - per_n * tension) / (1.0 - per_n * falling)
            acting[k, m] = x
    return acting


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    pressure, contraction, velocity = map(np.ascontiguousarray, (state.pressure_kpa, signal, state.velocity_per_s))
    return _balance(pressure, contraction, velocity, state.muscles, parameters["stretch"])


EFFECT = ChainEffect(
    name="series_elasticity",
    form="linear_spring",
    site="transmission",
    signal="contraction",
    parameters=(
        Parameter("stretch", "1", 0.0, 0.2, 0.01, 0.01, "stretch at the largest force over rest length", (0.01, 0.05)),
    ),
    source=(
        "Zajac, Muscle and tendon: properties, models, scaling, and application to biomechanics and motor control, "
        "Crit. Rev. Biomed. Eng. 17 (1989): a contractile element in series with an elastic one"
    ),
    signature="force is short where it is large, more than in proportion, whatever the direction of motion",
    split_by="a wide range of pressure times contraction, standing still",
    apply=_apply,
)
