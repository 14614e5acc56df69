"""Creep of the rubber tube: it resists a quick change of contraction more than a lasting one.

A spring in series with a slow damper (a Maxwell element) beside the muscle. After a reach the force drifts back for
seconds; under constant load the contraction goes on after a step of pressure.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stages.plant.effect import ChainEffect, Parameter, State
from stages.plant.valve import respond
from stages.signals.trajectories import Array


def apply(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the force, N, less what the slow element holds."""
    tau = np.full(signal.shape[1], parameters["tau_s"])
    held = state.contraction - respond(state.contraction, tau, tau, state.step_s)
    return signal - parameters["share"] * state.muscles.full_force_n * held


EFFECT = ChainEffect(
    name="creep",
    form="maxwell_element",
    site="muscle",
    signal="force_n",
    parameters=(
        Parameter(
            "share", "1", 0.0, 1.0, 0.1, 0.1, "slow stiffness per contraction over the largest force", (0.1, 0.5)
        ),
        Parameter("tau_s", "s", 0.3, 30.0, 2.0, 2.0, "time constant of the slow element", (0.5, 2.0, 8.0)),
    ),
    source=(
        "Vo-Minh, Kamers, Ramon, Van Brussel, Modeling and control of a pneumatic artificial muscle manipulator joint, "
        "part I, accounting for creep effect, Mechatronics 22 (2012)"
    ),
    signature="force overshoots after a reach and drifts back within seconds, while nothing moves",
    split_by="a step of contraction held for ten seconds at constant pressure",
    relatives=("hysteresis", "sensor_drift"),
    apply=apply,
)

FORMS = (EFFECT,)
