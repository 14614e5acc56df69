"""Friction that grows with velocity, beyond the nominal damping.

`linear` is the nominal damping itself, which a fit of the constants takes up; `power_law` bends with velocity, and
`pressure_scaled` grows with pressure.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import name_terms, take_share
from stages.science.plant.effect import ChainEffect, DynamicEffect, ElementEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array

USUAL_PER_S = 0.1


def _quicken(state: State, parameters: Values) -> Array:
    quick = state.velocity_per_s / USUAL_PER_S
    return np.copysign(np.abs(quick) ** parameters["exponent"], quick) if "exponent" in parameters else quick


def _share_of(what: str) -> Parameter:
    return Parameter("share", "1", 0.0, 0.5, 0.02, 0.03, f"friction at 0.1 /s over {what}", (0.02, 0.1))


EFFECT = ChainEffect(
    name="viscous_friction",
    form="linear",
    site="muscle",
    signal="force_n",
    parameters=(_share_of("the largest force"),),
    source=(
        "Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, Friction models and friction compensation, Eur. J. "
        "Control 4 (1998)"
    ),
    signature="force is short in proportion to the velocity of shortening, and right at rest",
    split_by="the same way at three speeds and two pressures",
    apply=take_share(_quicken),
)

DAMPED_MOTION = DynamicEffect(
    name="viscous_friction",
    form="linear_damping",
    site="motion",
    parameters=(
        Parameter("share", "1", 0.0, 50.0, 0.0, 1.0, "deceleration at one scale per pace, scales per pace", (0.1, 1.0)),
    ),
    source=EFFECT.source,
    signature="the motion runs ahead in proportion to its velocity",
    split_by="coasting without force: velocity decays exponentially",
    terms=name_terms(damping="share"),
)

QUADRATIC = DynamicEffect(
    name="viscous_friction",
    form="quadratic_drag",
    site="motion",
    parameters=(
        Parameter(
            "share", "1", 0.0, 10.0, 0.0, 0.2, "deceleration at one scale per pace, scales per squared pace", (0.05,)
        ),
    ),
    source="Nayfeh, Mook, Nonlinear oscillations (1979), section 3.3.2: quadratic damping",
    signature="the resonance flattens as the motion grows: damping lacks at high velocity",
    split_by="free decay from a large motion: its envelope bends",
    terms=name_terms(drag="share"),
)

SPINNING = replace(
    QUADRATIC,
    form="lag_quadratic_drag",
    site="lag",
    parameters=(
        Parameter("share", "1", 0.0, 5.0, 0.0, 0.2, "of the drive at one scale of velocity, scales", (0.05, 0.3)),
    ),
    source=(
        "Munson, Young, Okiishi, Huebsch, Fundamentals of fluid mechanics, 6th edition (2009), chapter 12: the torque "
        "of fans and pumps grows with the square of their speed"
    ),
    signature="velocity is short where it is large, and falls off quicker from there",
    split_by="steps of the input of several sizes: the velocity at rest of each",
)

DAMPED_ELEMENT = ElementEffect(
    name="viscous_friction",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.3, "friction at one scale per pace over the answer's", (0.1, -0.1)),
    ),
    source=EFFECT.source,
    signature="the answer errs in proportion to the rate of motion, and is right at rest",
    split_by="the same loop at three speeds: its width grows with speed",
    apply=lambda answer, bench, parameters: answer + parameters["share"] * bench.rate,
)

DRAGGED_ELEMENT = replace(
    DAMPED_ELEMENT,
    form="element_quadratic_drag",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.1, "drag at one scale per pace over the answer's", (0.03, -0.03)),
    ),
    source="Merritt, Hydraulic control systems (1967), chapter 3: turbulent flow through orifices",
    signature="the answer errs with the square of the rate of motion, against it, and is right at rest",
    split_by="the same loop at three speeds: its width grows with the square of speed",
    apply=lambda answer, bench, parameters: answer + parameters["share"] * bench.rate * np.abs(bench.rate),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="power_law",
        parameters=(
            _share_of("the largest force"),
            Parameter("exponent", "1", 0.2, 2.5, 1.0, 0.5, "power of velocity", (0.5, 1.8)),
        ),
    ),
    replace(
        EFFECT,
        form="pressure_scaled",
        parameters=(_share_of("the force at this pressure and rest length"),),
        source=(
            "Reynolds, Repperger, Phillips, Bandry, Modeling the dynamic characteristics of pneumatic muscle, Ann. "
            "Biomed. Eng. 31 (2003): damping grows with pressure"
        ),
        apply=take_share(_quicken, at_pressure=True),
    ),
    DAMPED_MOTION,
    QUADRATIC,
    SPINNING,
    DAMPED_ELEMENT,
    DRAGGED_ELEMENT,
)
