"""Hysteresis of the braid: threads rub on threads, so a muscle pulls less while it shortens than while it lengthens.

Four stop operators of growing width, side by side, follow the contraction; their mean, between -1 and 1, takes a share
of the force that the pressure would give at rest length. The signature is a loop of force over contraction that grows
with pressure and does not depend on speed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit

from stages.plant.effect import ChainEffect, Parameter, State
from stages.signals.trajectories import Array

ELEMENTS = 4


@njit(cache=True, error_model="numpy")
def _follow_stops(contraction: Array, widths: Array) -> Array:
    samples, columns = contraction.shape
    mean = np.zeros((samples, columns))
    for m in range(columns):
        for width in widths:
            stop = 0.0
            for k in range(1, samples):
                stop = min(max(stop + (contraction[k, m] - contraction[k - 1, m]) / width, -1.0), 1.0)
                mean[k, m] += stop / widths.shape[0]
    return mean


def apply(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the force, N, less the friction of the braid."""
    widths = parameters["width"] * np.arange(1, ELEMENTS + 1) / ELEMENTS
    muscles = state.muscles
    full = muscles.area_n_per_kpa * (muscles.braid_a - muscles.braid_b) * np.maximum(state.pressure_kpa, 0.0)
    return signal - parameters["share"] * full * _follow_stops(state.contraction, widths)


EFFECT = ChainEffect(
    name="hysteresis",
    form="maxwell_slip",
    site="muscle",
    signal="force_n",
    parameters=(
        Parameter(
            "share", "1", 0.0, 0.3, 0.03, 0.03, "friction over the force at this pressure and rest length", (0.03, 0.12)
        ),
        Parameter(
            "width", "1", 0.002, 0.1, 0.02, 0.01, "contraction over which the widest element turns", (0.008, 0.03)
        ),
    ),
    source=(
        "Vo-Minh, Tjahjowidodo, Ramon, Van Brussel, A new approach to modeling hysteresis in a pneumatic artificial "
        "muscle using the Maxwell-slip model, IEEE/ASME Trans. Mechatronics 16 (2011)"
    ),
    signature="a loop of force over contraction, whatever the speed, that turns within a small way after each reversal",
    split_by="small reversals inside a large one, slow, at constant pressure",
    relatives=("coulomb_friction", "creep"),
    apply=apply,
)

FORMS = (EFFECT,)
