"""A pressure that the rubber tube takes before it presses on the braid, missing from the force at any higher one.

`hinge` takes all of it from the first; `exponential` takes it gradually, as a tube that stiffens does.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array


def _apply_gradually(signal: Array, state: State, parameters: Values) -> Array:
    taken = parameters["threshold_kpa"] * -np.expm1(-np.maximum(signal, 0.0) / parameters["scale_kpa"])
    return np.maximum(signal - taken, np.minimum(signal, 0.0))


THRESHOLD = Parameter(
    "threshold_kpa", "kPa", 0.0, 100.0, 10.0, 10.0, "pressure that expands the tube alone", (8.0, 30.0)
)

EFFECT = ChainEffect(
    name="threshold_pressure",
    form="hinge",
    site="pressure",
    signal="acting_pressure_kpa",
    parameters=(THRESHOLD,),
    source=(
        "Klute, Hannaford, Accounting for elastic energy storage in McKibben artificial muscle actuators, J. Dyn. "
        "Syst. Meas. Control 122 (2000): the bladder takes part of the pressure"
    ),
    signature="force is short by a constant share of the area times pressure, at every pressure beyond the threshold",
    split_by="a slow sweep of pressure from zero at constant contraction",
    apply=lambda signal, state, parameters: signal - np.minimum(np.maximum(signal, 0.0), parameters["threshold_kpa"]),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="exponential",
        parameters=(
            THRESHOLD,
            Parameter(
                "scale_kpa", "kPa", 5.0, 300.0, 50.0, 50.0, "pressure at which most of it is taken", (30.0, 120.0)
            ),
        ),
        source="Holzapfel, Nonlinear solid mechanics (2000), chapter 6: a balloon of stiffening rubber",
        apply=_apply_gradually,
    ),
)
