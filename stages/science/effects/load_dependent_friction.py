"""Dry friction that grows with what presses the surfaces on each other: seals under pressure, plates under a field.

`element_lagged` follows the load late, as a field does a current, or the pressure at a seal that in the chamber.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import Bench, ElementEffect, Parameter, Values
from stages.science.plant.filters import lag
from stages.science.signals.trajectories import Array


def _rub(answer: Array, bench: Bench, load: Array, parameters: Values) -> Array:
    size = parameters["share"] * (load + parameters["unloaded"])
    return answer + size * np.tanh(bench.rate / parameters["sliding"])


def _apply_late(answer: Array, bench: Bench, parameters: Values) -> Array:
    late = lag(bench.load, parameters["paces"] * bench.time_scale_s, bench.step_s)
    return _rub(answer, bench, late, parameters)


EFFECT = ElementEffect(
    name="load_dependent_friction",
    parameters=(
        Parameter("share", "1", -5.0, 5.0, 0.0, 0.5, "what full load adds, over the answer's scale", (0.1, -0.1)),
        Parameter("sliding", "1", 0.002, 1.0, 0.05, 0.05, "rate at which it slides, scales per pace", (0.02, 0.2)),
        Parameter("unloaded", "1", 0.0, 2.0, 0.2, 0.5, "friction without load over what full load adds", (0.1,)),
    ),
    source=(
        "Belforte, Raparelli, Mazza, Analysis of typical component behaviour for pneumatic cylinders, Proc. 7th Int. "
        "Fluid Power Workshop, Bath (1994): friction of seals is affine in the pressures"
    ),
    signature="the answer steps whenever motion turns, and more so under load",
    split_by="slow reversals at two loads: the step grows with the load",
    apply=lambda answer, bench, parameters: _rub(answer, bench, bench.load, parameters),
    scales=False,
    loaded=True,
)

LAGGED = replace(
    EFFECT,
    form="element_lagged",
    parameters=(
        *EFFECT.parameters,
        Parameter("paces", "1", 0.01, 5.0, 0.2, 0.5, "time in which it follows the load, over the pace", (0.05, 0.5)),
    ),
    source=(
        "Spencer, Dyke, Sain, Carlson, Phenomenological model for magnetorheological dampers, J. Eng. Mech. 123 "
        "(1997): a yield force that follows the voltage through a first-order lag"
    ),
    signature="the answer steps whenever motion turns, and more so some time after the load has grown",
    split_by="a step of the load while the speed is constant",
    apply=_apply_late,
)

FORMS = (EFFECT, LAGGED)
