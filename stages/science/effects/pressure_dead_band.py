"""A range of low pressure in which the muscle gives no force, and beyond which it gives all of it.

The tube lies loose inside the braid: until it touches there is no force, and once it touches, the whole pressure acts.
A threshold pressure, by contrast, stays missing from the force at every higher one. Between touching first and all
around, force rises smoothly over a part of the band.
"""

import numpy as np

from stages.science.plant.effect import ChainEffect, Parameter, State, Values
from stages.science.signals.trajectories import Array

SMALLEST_KPA = 1e-12


def _apply(signal: Array, state: State, parameters: Values) -> Array:
    band, softness = parameters["band_kpa"], parameters["softness"]
    start = (1.0 - softness) * band
    way = np.clip((signal - start) / max(band - start, SMALLEST_KPA), 0.0, 1.0)
    touching = way * way * (3.0 - 2.0 * way)
    return np.maximum(signal, 0.0) * touching + np.minimum(signal, 0.0)


EFFECT = ChainEffect(
    name="pressure_dead_band",
    form="contact",
    site="pressure",
    signal="acting_pressure_kpa",
    parameters=(
        Parameter("band_kpa", "kPa", 0.0, 200.0, 20.0, 20.0, "pressure from which all of it acts", (25.0, 60.0, 120.0)),
        Parameter("softness", "1", 0.05, 1.0, 0.3, 0.2, "part of the band over which force rises", (0.3, 0.9)),
    ),
    source=(
        "Tao, Kokotovic, Adaptive control of systems with actuator and sensor nonlinearities (1996): dead zones; "
        "that all of the pressure acts beyond is what a loose tube gives"
    ),
    signature="force is absent at low pressure and right above it",
    split_by="a slow sweep of pressure from zero at constant contraction",
    apply=_apply,
)
