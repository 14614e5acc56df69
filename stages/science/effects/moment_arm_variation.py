"""A moment arm that changes with the joint's angle, so that contraction is not what the constant arm says.

`linear` has an arm r (1 + v q) at angle q, `eccentric` a pulley off its axle, r (1 + v sin(q + phase)). Both map the
contraction of the constant arm to the true one. The rate of contraction, which enters the mild damping alone, is left
as it is, and so is the arm by which tension turns a simulated joint.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array


def _angle(contraction: Array, state: State) -> Array:
    return (contraction - state.muscles.contraction_at_angle_0) / state.muscles.contraction_per_rad


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    wound = 0.5 * _angle(signal, state) ** 2
    return signal + parameters["variation_per_rad"] * state.muscles.contraction_per_rad * wound


def _apply_eccentric(signal: Array, state: State, parameters: Values) -> Array:
    phase = parameters["phase_rad"]
    wound = np.cos(phase) - np.cos(_angle(signal, state) + phase)
    return signal + parameters["variation"] * state.muscles.contraction_per_rad * wound


EFFECT = ChainEffect(
    name="moment_arm_variation",
    form="linear",
    site="transmission",
    signal="contraction",
    parameters=(
        Parameter(
            "variation_per_rad", "1/rad", -0.8, 0.8, 0.0, 0.1, "change of the arm per angle over the arm", (0.1, -0.1)
        ),
    ),
    source=(
        "An, Takahashi, Harrigan, Chao, Determination of muscle orientations and moment arms, J. Biomech. Eng. 106 "
        "(1984): the arm is the derivative of tendon travel by angle"
    ),
    signature="force errs with the joint's angle and in proportion to pressure, in both directions of motion alike",
    split_by="slow sweeps over the whole range of the joint at three pressures",
    apply=_apply,
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="eccentric",
        parameters=(
            Parameter("variation", "1", -0.8, 0.8, 0.0, 0.1, "eccentricity over the arm", (0.15, -0.15)),
            Parameter("phase_rad", "rad", -1.6, 1.6, 0.0, 0.8, "angle between arm and eccentricity", (-0.7, 0.7)),
        ),
        apply=_apply_eccentric,
    ),
)
