"""Dry friction of a joint: a torque of constant size against the direction of motion, smoothed around rest."""

from __future__ import annotations

from collections.abc import Mapping

from stages.plant.effect import JointEffect, Parameter


def terms(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the integrator's terms: size and smoothing of the friction torque."""
    return {"coulomb_nm": parameters["torque_nm"], "coulomb_rad_per_s": parameters["sliding_rad_per_s"]}


EFFECT = JointEffect(
    name="coulomb_friction",
    form="joint_torque",
    parameters=(
        Parameter("torque_nm", "N m", 0.0, 10.0, 0.5, 0.5, "friction torque while the joint moves", (0.5, 3.0)),
        Parameter(
            "sliding_rad_per_s", "rad/s", 0.01, 1.0, 0.05, 0.03, "velocity at which the joint slides", (0.02, 0.1)
        ),
    ),
    source=(
        "Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, Friction models and friction compensation, Eur. J. "
        "Control 4 (1998); the hyperbolic tangent is a usual smoothing"
    ),
    signature="the joint sticks at reversals and lags behind the torque by a constant amount",
    split_by="slow reversals of the joint at two pressures: the step at reversal stays the same",
    relatives=("stribeck_friction", "capstan_friction"),
    terms=terms,
)

FORMS = (EFFECT,)
