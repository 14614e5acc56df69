"""A pressure that the rubber tube takes before it presses on the braid, missing from the force at any higher one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stages.plant.effect import ChainEffect, Parameter, State
from stages.signals.trajectories import Array


def apply(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the pressure that acts on the braid, kPa."""
    threshold = parameters["threshold_kpa"]
    return signal - np.minimum(np.maximum(signal, 0.0), threshold)


EFFECT = ChainEffect(
    name="threshold_pressure",
    form="hinge",
    site="pressure",
    signal="acting_pressure_kpa",
    parameters=(
        Parameter("threshold_kpa", "kPa", 0.0, 100.0, 10.0, 10.0, "pressure that expands the tube alone", (8.0, 30.0)),
    ),
    source=(
        "Klute, Hannaford, Accounting for elastic energy storage in McKibben artificial muscle actuators, J. Dyn. "
        "Syst. Meas. Control 122 (2000): the bladder takes part of the pressure"
    ),
    signature="force is short by a constant share of the area times pressure, at every pressure beyond the threshold",
    split_by="a slow sweep of pressure from zero at constant contraction",
    relatives=("pressure_dead_band", "sensor_offset"),
    apply=apply,
)

FORMS = (EFFECT,)
