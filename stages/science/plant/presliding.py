"""Friction that yields a little before it slides: the way that it yields, and how much of it has come.

A muscle's contraction flows in; out flows the friction's direction, between -1 and 1. The cable's dry frictions share
it, and so its bounds and where fits begin.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stages.science.plant.effect import Parameter, State
from stages.science.plant.operators import follow_stops
from stages.science.signals.trajectories import Array

PRESLIDING = Parameter(
    "presliding", "1", 0.0001, 0.004, 0.001, 0.001, "contraction over which it yields first", (0.0008, 0.0025)
)


def slide_after_yielding(state: State, parameters: Mapping[str, float]) -> Array:
    """Return the direction of a friction, (T, K), that turns within `presliding` of contraction after a reversal."""
    return follow_stops(state.contraction, np.array([parameters["presliding"]]))
