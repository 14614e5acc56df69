"""Stiffening towards an end of the range: beyond some contraction a force grows exponentially.

`contracted_end`: a short, thick muscle meets its fittings and loses tension. `stretched_end`: the threads are straight
and tension rises. A motion meets a second spring at one end, `upper_stop` or `lower_stop`, or at both, `two_stops`. A
stop is at least as stiff as the spring that holds the motion; what is softer is the spring's own law.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stages.science.effects import take_share
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter, Values
from stages.science.signals.trajectories import Array

STEEPEST = 6.0
"""Largest exponent: beyond it the force exceeds any other by far, and a fit would see nothing else."""


def _grow(beyond: Array, parameters: Values) -> Array:
    return np.expm1(np.clip(beyond / parameters["length"], 0.0, STEEPEST))


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
    apply=take_share(lambda state, parameters: _grow(state.contraction - parameters["onset"], parameters)),
)


def _stand(*sides: str) -> Callable[[Values], dict[str, float]]:
    """Return what lists the terms of a stop above or below, or of one on each side, as far away."""

    def list_terms(parameters: Values) -> dict[str, float]:
        near = parameters["scale_over_place"]
        place = 1.0 / near if near else math.inf
        places = {"above": place, "below": -place}
        return {"stop": parameters["stiffness"], **{f"stop_{side}": places[side] for side in sides}}

    return list_terms


STOP = DynamicEffect(
    name="end_stiffening",
    form="upper_stop",
    site="motion",
    parameters=(
        Parameter("scale_over_place", "1", 0.0, 10.0, 0.0, 2.0, "a scale over the stop's place", (0.8, 1.3, 2.0, 4.0)),
        Parameter(
            "stiffness", "1", 1.0, 30.0, 3.0, 5.0, "deceleration one scale beyond it, scales per squared pace", (5.0,)
        ),
    ),
    source="Shaw, Holmes, A periodically forced piecewise linear oscillator, J. Sound and Vibration 90 (1983)",
    signature="the motion turns back sooner at one end than it should, and is right elsewhere",
    split_by="a slow push to both ends of the range",
    terms=_stand("above"),
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
        apply=take_share(lambda state, parameters: -_grow(parameters["onset"] - state.contraction, parameters)),
    ),
    STOP,
    replace(STOP, form="lower_stop", terms=_stand("below")),
    replace(STOP, form="two_stops", terms=_stand("above", "below")),
)
