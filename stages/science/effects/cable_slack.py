"""Slack of the cable: the muscle takes it up before any tension reaches the joint.

`offset_length` makes the muscle shorter by the slack than the joint's geometry says; it goes slack earlier, and while
always taut this is a zero of contraction. `hanging` loses tension beyond a contraction, where the cable hangs, and
`opening` slackens a cable that hardly pulls, so that the muscle is shorter until it pulls again; it opens and closes
in time, as what guides the cable gives way.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.plant.filters import lag
from stages.science.plant.muscle import compute_tension
from stages.science.signals.trajectories import Array


def _apply_hanging(signal: Array, state: State, parameters: Values) -> Array:
    way = np.clip((state.contraction - parameters["onset"]) / parameters["width"], 0.0, 1.0)
    return signal * (1.0 - parameters["lost"] * way * way * (3.0 - 2.0 * way))


def _apply_opening(signal: Array, state: State, parameters: Values) -> Array:
    load = compute_tension(state.pressure_kpa, signal, state.velocity_per_s, state.muscles) / state.muscles.full_force_n
    opened = 1.0 / (1.0 + np.exp(np.clip((load - parameters["load"]) / parameters["width"], -50.0, 50.0)))
    return signal + parameters["slack"] * lag(opened, parameters["tau_s"], state.step_s)


EFFECT = ChainEffect(
    name="cable_slack",
    form="offset_length",
    site="transmission",
    signal="contraction",
    parameters=(Parameter("slack", "1", 0.0, 0.1, 0.01, 0.01, "slack over rest length", (0.01, 0.03)),),
    source=(
        "Kaneko, Wada, Maekawa, Tanie, A new consideration on tendon-tension control system of robot hands, IEEE ICRA "
        "(1991)"
    ),
    signature="force is short, more where the muscle is short, and reaches zero before the model does",
    split_by="low pressure at the end of the range where the muscle is shortest, until it goes slack",
    apply=lambda signal, state, parameters: signal + parameters["slack"],
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="hanging",
        signal="tension_n",
        parameters=(
            Parameter("lost", "1", 0.0, 1.0, 1.0, 0.5, "share of tension lost where the cable hangs", (0.9,)),
            Parameter("onset", "1", 0.0, 0.3, 0.12, 0.06, "contraction from which it hangs", (0.06, 0.12, 0.18)),
            Parameter("width", "1", 0.002, 0.1, 0.02, 0.02, "contraction over which tension is lost", (0.015,)),
        ),
        signature="force falls away beyond a contraction and is right below it",
        apply=_apply_hanging,
    ),
    replace(
        EFFECT,
        form="opening",
        parameters=(
            EFFECT.parameters[0],
            Parameter("load", "1", 0.005, 0.6, 0.1, 0.1, "load at which half is open, over the largest", (0.05, 0.2)),
            Parameter("width", "1", 0.005, 0.2, 0.03, 0.03, "load over which it opens, over the largest", (0.03,)),
            Parameter("tau_s", "s", 0.0, 1.0, 0.1, 0.1, "time constant with which it opens and closes", (0.02, 0.1)),
        ),
        signature="force is short at small loads and right at large ones",
        split_by="low pressure and high pressure at the same contraction",
        apply=_apply_opening,
    ),
)
