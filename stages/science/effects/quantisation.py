"""A sensor with coarse counts: what it shows is a whole number of them.

The only effect that is not continuous in its magnitude; it never errs by more than half a count. Differences between
values that are whole multiples of one number give it away.
"""

from dataclasses import replace

import numpy as np

from stages.science.plant.effect import ChainEffect, Parameter
from stages.science.signals.trajectories import Array


def _round(signal: Array, count: Array | float) -> Array:
    return np.round(signal / count) * count if np.any(count) else signal


EFFECT = ChainEffect(
    name="quantisation",
    form="force",
    site="sensor",
    signal="sensed_force_n",
    parameters=(Parameter("count_share", "1", 0.0, 0.2, 0.002, 0.005, "count over the largest force", (0.003, 0.02)),),
    source="Widrow, Kollar, Quantization noise (2008)",
    signature="force moves in equal steps and stands between them",
    split_by="a slow sweep of pressure: the steps are equal",
    apply=lambda signal, state, parameters: _round(signal, parameters["count_share"] * state.muscles.full_force_n),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        parameters=(Parameter("count_kpa", "kPa", 0.0, 200.0, 1.0, 2.0, "count", (1.0, 5.0)),),
        signature="pressure moves in equal steps and stands between them",
        apply=lambda signal, state, parameters: _round(signal, parameters["count_kpa"]),
    ),
)
