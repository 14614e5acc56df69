"""Dry friction of a cable that is largest as it begins to slide and falls with velocity to a constant size.

Without the rise it is Coulomb friction; a load cell at the muscle's tip does not see it.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import PRESLIDING, slide
from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    fading = np.exp(-((state.velocity_per_s / parameters["stribeck_per_s"]) ** 2))
    size = parameters["share"] * state.muscles.full_force_n * (1.0 + parameters["rise"] * fading)
    return signal - size * slide(state, parameters)


EFFECT = ChainEffect(
    name="stribeck_friction",
    form="gaussian",
    site="transmission",
    signal="tension_n",
    parameters=(
        Parameter("share", "1", 0.0, 0.4, 0.01, 0.02, "friction in quick sliding over the largest force", (0.01, 0.05)),
        Parameter("rise", "1", 0.0, 4.0, 0.8, 0.6, "friction at breakaway over that in quick sliding, less 1", (1.0,)),
        Parameter(
            "stribeck_per_s", "1/s", 0.003, 0.5, 0.05, 0.05, "contraction velocity at which it falls", (0.02, 0.08)
        ),
        Parameter(
            "sliding_per_s", "1/s", 0.0005, 0.02, 0.01, 0.01, "contraction velocity at which it slides", (0.005,)
        ),
    ),
    source=(
        "Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation methods for "
        "the control of machines with friction, Automatica 30 (1994)"
    ),
    signature="force steps at reversals by more in slow motion than in quick motion",
    split_by="reversals at constant pressure, from very slow to quick",
    apply=_apply,
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="presliding",
        parameters=(*EFFECT.parameters[:3], PRESLIDING),
        source=(
            "Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with friction, IEEE Trans. "
            "Autom. Control 40 (1995); its bristles here as one stop"
        ),
    ),
)
