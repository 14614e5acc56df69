"""A passive spring beside the muscle whose force grows with the cube of contraction from a middle.

Rubber and braid harden towards both ends of the range: less tension when short, more when stretched. Here the spring
acts along a driven muscle; in an oscillator the same law is a term of the equation of motion.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, ElementEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array

USUAL = 0.1


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    away = (state.contraction - parameters["middle"]) / USUAL
    return signal - parameters["share"] * state.muscles.full_force_n * away * away * away


EFFECT = ChainEffect(
    name="cubic_stiffness",
    form="hardening",
    site="muscle",
    signal="force_n",
    parameters=(
        Parameter(
            "share", "1", -0.5, 0.5, 0.0, 0.05, "spring's force at 0.1 from the middle over the largest", (0.03, -0.03)
        ),
        Parameter("middle", "1", 0.0, 0.25, 0.1, 0.05, "contraction at which the spring is at rest", (0.06, 0.12)),
    ),
    source="Kovacic, Brennan, The Duffing equation: nonlinear oscillators and their behaviour (2011)",
    signature="force errs by a cubic of contraction, the same at every pressure and in both directions",
    split_by="a slow sweep over the whole range of contraction at two pressures",
    apply=_apply,
)

DUFFING = DynamicEffect(
    name="cubic_stiffness",
    form="duffing",
    site="motion",
    parameters=(
        Parameter(
            "share", "1", -0.9, 10.0, 0.0, 0.5, "deceleration at one scale, scales per squared pace", (0.1, -0.05)
        ),
    ),
    source=EFFECT.source,
    signature="the resonance bends towards higher frequency as the motion grows, and lower where the spring softens",
    split_by="a slow sweep through the resonance at a small and a large input",
    terms=name_terms(cubic="share"),
)

PENDULUM = DynamicEffect(
    name="cubic_stiffness",
    form="pendulum",
    site="motion",
    parameters=(Parameter("swing", "1", 0.0, 6.0, 0.0, 1.0, "squared angle of one scale, squared rad", (0.3, 1.0)),),
    source="Nayfeh, Mook, Nonlinear oscillations (1979), 2.1.1: the restoring torque of a pendulum is a sine",
    signature=DUFFING.signature,
    split_by=DUFFING.split_by,
    terms=name_terms(swing="swing"),
)

HARDENING_ELEMENT = ElementEffect(
    name="cubic_stiffness",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.3, "at one scale from the middle over the answer's", (0.1, -0.1)),
    ),
    source=EFFECT.source,
    signature="the answer errs by a cubic of what moves it, the same in both directions",
    split_by="a slow sweep over the whole range",
    apply=lambda answer, bench, parameters: answer + parameters["share"] * bench.along * bench.along * bench.along,
)

FORMS = (EFFECT, DUFFING, PENDULUM, HARDENING_ELEMENT)
