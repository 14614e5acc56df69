"""Friction of a Bowden cable: tension falls along the sheath in the direction in which the cable slides.

While the muscle shortens the joint feels less than the muscle pulls, and more while it lengthens. A load cell at the
muscle's tip does not see it; the motion of the joint does.
"""

from dataclasses import replace

import numpy as np

from stages.science.effects import PRESLIDING, slide
from stages.science.plant.effect import ChainEffect, Parameter

BEND, SLIDES = "friction coefficient times the sheath's total bend", "contraction velocity at which the cable slides"

EFFECT = ChainEffect(
    name="capstan_friction",
    form="exponential",
    site="transmission",
    signal="tension_n",
    parameters=(
        Parameter("friction_times_wrap", "1", 0.0, 1.0, 0.12, 0.08, BEND, (0.1, 0.35)),
        Parameter("sliding_per_s", "1/s", 0.001, 0.02, 0.01, 0.01, SLIDES, (0.003, 0.01)),
    ),
    source=(
        "Kaneko, Yamashita, Tanie, Basic considerations on transmission characteristics for tendon drive robots, "
        "Int. Conf. Advanced Robotics (1991): the capstan equation along a sheath"
    ),
    signature="force at the joint is short by a share of itself while the muscle shortens, and over while it lengthens",
    split_by="slow reversals at two pressures: the step at reversal grows with tension",
    apply=lambda signal, state, parameters: (
        signal * np.exp(-parameters["friction_times_wrap"] * slide(state, parameters))
    ),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="presliding",
        parameters=(EFFECT.parameters[0], PRESLIDING),
        source=(
            "Do, Tjahjowidodo, Lau, Yamamoto, Phee, Hysteresis modeling and position control of tendon-sheath "
            "mechanism in flexible endoscopic systems, Mechatronics 24 (2014)"
        ),
    ),
)
