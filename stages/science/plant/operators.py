"""How the cable's dry frictions turn: what they share, its bounds and where fits begin."""

from collections.abc import Mapping

import numpy as np

from stages.science.plant.effect import Parameter, State
from stages.science.signals.operators import follow_stops
from stages.science.signals.trajectories import Array

PRESLIDING = Parameter(
    "presliding", "1", 0.0001, 0.004, 0.001, 0.001, "contraction over which it yields first", (0.0008, 0.0025)
)


def slide_after_yielding(state: State, parameters: Mapping[str, float]) -> Array:
    """Return the direction of a friction, (T, K), that turns within `presliding` of contraction after a reversal."""
    return follow_stops(state.contraction, np.array([parameters["presliding"]]))
