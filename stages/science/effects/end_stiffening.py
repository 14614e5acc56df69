"""Stiffening towards an end of the range: beyond some contraction a force grows exponentially.

`contracted_end`: a short, thick muscle meets its fittings and loses tension. `stretched_end`: the threads are straight
and tension rises. A motion meets a second spring at one end, `upper_stop` or `lower_stop`.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array

STEEPEST = 6.0
"""Largest exponent: beyond it the force exceeds any other by far, and a fit would see nothing else."""


def _grow(beyond: Array, parameters: Values) -> Array:
    return np.expm1(np.clip(beyond / parameters["length"], 0.0, STEEPEST))


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    beyond = _grow(state.contraction - parameters["onset"], parameters)
    return signal - parameters["share"] * state.muscles.full_force_n * beyond


def _apply_stretched(signal: Array, state: State, parameters: Values) -> Array:
    beyond = _grow(parameters["onset"] - state.contraction, parameters)
    return signal + parameters["share"] * state.muscles.full_force_n * beyond


SHARE = Parameter(
    "share", "1", 0.0, 0.5, 0.01, 0.02, "force one length beyond, over 1.7 times the largest", (0.005, 0.04)
)
LENGTH = Parameter("length", "1", 0.005, 0.2, 0.02, 0.02, "contraction over which it grows by e", (0.015, 0.05))

EFFECT = ChainEffect(
    name="end_stiffening",
    form="contracted_end",
    site="muscle",
    signal="force_n",
    parameters=(
        SHARE,
        Parameter("onset", "1", 0.0, 0.3, 0.14, 0.05, "contraction beyond which it stiffens", (0.08, 0.14)),
        LENGTH,
    ),
    source=(
        "Sarosi, New approximation algorithm for the force of fluidic muscles, IEEE Symp. Applied Computational "
        "Intelligence and Informatics (2012): a term of force exponential in contraction"
    ),
    signature="force errs at one end of the range, more steeply the further, and is right elsewhere",
    split_by="slow reaches to both ends of the range at two pressures",
    apply=_apply,
)

STOP = DynamicEffect(
    name="end_stiffening",
    form="upper_stop",
    site="motion",
    parameters=(
        Parameter(
            "share", "1", 0.0, 100.0, 0.0, 2.0, "deceleration one scale beyond, scales per squared pace", (1.0, 10.0)
        ),
        Parameter("onset", "1", -3.0, 3.0, 0.5, 0.5, "place beyond which it stiffens, scales", (0.2, 0.5, 0.8)),
    ),
    source="Shaw, Holmes, A periodically forced piecewise linear oscillator, J. Sound and Vibration 90 (1983)",
    signature="the motion turns back sooner at one end than it should, and is right elsewhere",
    split_by="a slow push to both ends of the range",
    terms=lambda parameters: {"stop": parameters["share"], "stop_at": parameters["onset"], "stop_side": 1.0},
    scales=False,
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="stretched_end",
        parameters=(
            SHARE,
            Parameter("onset", "1", -0.05, 0.2, 0.05, 0.05, "contraction below which it stiffens", (0.05, 0.1)),
            LENGTH,
        ),
        apply=_apply_stretched,
    ),
    STOP,
    replace(
        STOP,
        form="lower_stop",
        parameters=(
            STOP.parameters[0],
            replace(
                STOP.parameters[1],
                prior_mean=-0.5,
                starts=(-0.2, -0.5, -0.8),
                description="place below which it stiffens, scales",
            ),
        ),
        terms=lambda parameters: {"stop": parameters["share"], "stop_at": parameters["onset"], "stop_side": -1.0},
    ),
)
