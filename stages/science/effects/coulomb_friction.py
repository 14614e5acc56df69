"""Dry friction of constant size against the direction of motion, smoothed around rest: of a joint, or of its cable.

A joint's friction is a torque inside the motion. A cable's takes tension while the muscle shortens and adds as much
while it lengthens; only a load cell at the joint's end sees it. The strands of a muscle's sleeve rub as hard as the
pressure presses them (`sleeve`); any load cell sees that.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import PRESLIDING, name_terms, slide, take_share
from stages.science.plant.effect import ChainEffect, DynamicEffect, ElementEffect, JointEffect, Parameter
from stages.science.signals.operators import follow_stops

SOURCE = (
    "Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, Friction models and friction compensation, Eur. J. "
    "Control 4 (1998); the hyperbolic tangent is a usual smoothing"
)

EFFECT = JointEffect(
    name="coulomb_friction",
    form="joint_torque",
    parameters=(
        Parameter("torque_nm", "N m", 0.0, 10.0, 0.5, 0.5, "friction torque while the joint moves", (0.5, 3.0)),
        Parameter(
            "sliding_rad_per_s", "rad/s", 0.01, 1.0, 0.05, 0.03, "velocity at which the joint slides", (0.02, 0.1)
        ),
    ),
    source=SOURCE,
    signature="the joint sticks at reversals and lags behind the torque by a constant amount",
    split_by="slow reversals of the joint at two pressures: the step at reversal stays the same",
    terms=name_terms(coulomb_nm="torque_nm", coulomb_rad_per_s="sliding_rad_per_s"),
)

CABLE = ChainEffect(
    name="coulomb_friction",
    form="cable",
    site="transmission",
    signal="tension_n",
    parameters=(
        Parameter("share", "1", 0.0, 0.4, 0.01, 0.02, "friction over the largest force", (0.01, 0.06)),
        Parameter(
            "sliding_per_s", "1/s", 0.0005, 0.02, 0.01, 0.01, "contraction velocity at which it slides", (0.003, 0.01)
        ),
    ),
    source=SOURCE,
    signature="force steps by the same amount at every reversal, short while the muscle shortens",
    split_by="slow reversals at two pressures: the step at reversal stays the same",
    apply=take_share(slide),
)

SLIDER = DynamicEffect(
    name="coulomb_friction",
    form="slider",
    site="motion",
    parameters=(
        Parameter("share", "1", 0.0, 2.0, 0.0, 0.1, "deceleration, scales per squared pace", (0.03,)),
        Parameter("sliding", "1", 0.005, 0.5, 0.03, 0.03, "velocity at which it slides, scales per pace", (0.03,)),
    ),
    source=SOURCE,
    signature="small motions are damped more than large ones, and the motion sticks before it rests",
    split_by="free decay: the envelope falls by as much with every period",
    terms=name_terms(coulomb="share", sliding="sliding"),
)

STRIBECK_SLIDER = replace(
    SLIDER,
    form="slider_stribeck",
    parameters=(
        *SLIDER.parameters,
        Parameter(
            "rise", "1", 0.0, 4.0, 0.5, 0.5, "how much larger it is where it begins to slide, over the share", (0.7,)
        ),
        Parameter(
            "falling", "1", 0.02, 2.0, 0.2, 0.2, "velocity at which half of that is left, scales per pace", (0.1, 0.4)
        ),
    ),
    source=(
        "Hess, Soom, Friction at a lubricated line contact operating at oscillating sliding velocities, J. Tribology "
        "112 (1990)"
    ),
    terms=name_terms(coulomb="share", sliding="sliding", rise="rise", falling="falling"),
)

SPINNING = replace(
    SLIDER,
    form="lag_friction",
    site="lag",
    parameters=(
        Parameter("share", "1", 0.0, 2.0, 0.0, 0.1, "velocity that it takes at rest of the lag, scales", (0.03, 0.2)),
    ),
    signature="velocity is short by the same amount in both directions, and stays at zero under small inputs",
    split_by="slow triangles of the input through zero: velocity stays at zero as long as the input is small",
    terms=name_terms(coulomb="share"),
)

YIELDING_SLIDER = replace(
    SLIDER,
    form="slider_presliding",
    parameters=(
        SLIDER.parameters[0],
        Parameter("presliding", "1", 0.0005, 0.1, 0.01, 0.02, "way in which it yields first, scales", (0.003, 0.02)),
    ),
    source=(
        "Al-Bender, Lampaert, Swevers, The generalized Maxwell-slip model, IEEE Trans. Autom. Control 50 (2005): one "
        "element"
    ),
    terms=name_terms(stiction="share", yielding="presliding"),
)

YIELDING_CABLE = replace(
    CABLE, form="cable_presliding", parameters=(CABLE.parameters[0], PRESLIDING), source=YIELDING_SLIDER.source
)

RUBBING_ELEMENT = ElementEffect(
    name="coulomb_friction",
    parameters=(
        Parameter("share", "1", -2.0, 2.0, 0.0, 0.3, "friction over the answer's scale", (0.1, -0.1)),
        Parameter("sliding", "1", 0.002, 1.0, 0.05, 0.05, "rate at which it slides, scales per pace", (0.02, 0.2)),
    ),
    source=SOURCE,
    signature="the answer steps by the same amount whenever motion turns",
    split_by="the same loop at three speeds: a step at the turn, however slow",
    apply=lambda answer, bench, parameters: answer + parameters["share"] * np.tanh(bench.rate / parameters["sliding"]),
)

STRIBECK_ELEMENT = replace(
    RUBBING_ELEMENT,
    form="element_stribeck",
    parameters=(RUBBING_ELEMENT.parameters[0], YIELDING_SLIDER.parameters[1], *STRIBECK_SLIDER.parameters[2:]),
    source=STRIBECK_SLIDER.source,
    signature="the answer steps whenever motion turns, by most where it is slow",
    split_by="the same loop at three speeds: the step falls with speed",
    apply=lambda answer, bench, parameters: (
        answer
        + parameters["share"]
        * follow_stops(bench.along, np.array([parameters["presliding"]]))
        * (1.0 + parameters["rise"] / (1.0 + (bench.rate / parameters["falling"]) ** 2))
    ),
)

SLEEVE = replace(
    YIELDING_CABLE,
    form="sleeve",
    site="muscle",
    signal="force_n",
    parameters=(replace(CABLE.parameters[0], description="friction over the force at this pressure"), PRESLIDING),
    source=(
        "Tondu, Lopez, Modeling and control of McKibben artificial muscle robot actuators, IEEE Control Systems "
        "Magazine 20 (2000): friction of the strands under the pressure"
    ),
    signature="force steps at every reversal in proportion to pressure",
    split_by="slow reversals at two pressures: the step at reversal grows with pressure",
    apply=take_share(slide, at_pressure=True),
)

FORMS = (
    EFFECT,
    CABLE,
    YIELDING_CABLE,
    SLEEVE,
    SLIDER,
    STRIBECK_SLIDER,
    YIELDING_SLIDER,
    SPINNING,
    RUBBING_ELEMENT,
    STRIBECK_ELEMENT,
)
