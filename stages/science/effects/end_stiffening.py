"""Stiffening towards an end of the range: beyond some contraction a force grows exponentially.

`contracted_end`: a short, thick muscle meets its fittings and loses tension. `stretched_end`: the threads are straight
and tension rises.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import take_share
from stages.science.plant.effect import ChainEffect, Parameter, Values
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
)
