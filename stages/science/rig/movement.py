"""How an experimenter moves when nothing is asked of them."""

import numpy as np
from pydantic import Field, PositiveFloat

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.limits import ordered
from stages.science.signals.trajectories import Array, reach_postures


class Movement(Declared):
    """Reaches between random postures, with rests."""

    shortest_move_s: PositiveFloat = Field(description="quickest reach, s")
    longest_move_s: PositiveFloat = Field(description="slowest reach, s")
    shortest_rest_s: float = Field(ge=0.0, description="shortest rest, s")
    longest_rest_s: float = Field(ge=0.0, description="longest rest, s")
    range_share: float = Field(gt=0.0, le=1.0, description="share of the joint's range that postures span, 1")

    _moves = ordered("shortest_move_s", "longest_move_s", strictly=False)
    _rests = ordered("shortest_rest_s", "longest_rest_s", strictly=False)


def move_freely(movement: Movement, exoskeleton: Exoskeleton, samples: int, generator: np.random.Generator) -> Array:
    """Draw a natural movement of all joints, (samples, J), rad."""
    lower, upper = np.array([(joint.lower_rad, joint.upper_rad) for joint in exoskeleton.joints]).T
    margin = 0.5 * (1.0 - movement.range_share) * (upper - lower)
    return reach_postures(
        generator,
        lower + margin,
        upper - margin,
        samples,
        exoskeleton.sampling_rate_hz,
        (movement.shortest_move_s, movement.longest_move_s),
        (movement.shortest_rest_s, movement.longest_rest_s),
    )
