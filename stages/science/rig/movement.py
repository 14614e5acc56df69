"""How an experimenter moves when nothing is asked of them."""

import numpy as np
from pydantic import Field, PositiveFloat

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.limits import ordered
from stages.science.rig.trial import NATURAL, Manner
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


def move_freely(
    movement: Movement,
    exoskeleton: Exoskeleton,
    samples: int,
    generator: np.random.Generator,
    manner: Manner = NATURAL,
) -> Array:
    """Draw a movement of all joints, (samples, J), rad: a natural one, or one in another manner.

    A smaller one lies about a posture that is drawn within the natural range; a wider one about the middle of the
    joint's range, and ends with that.
    """
    lower, upper = np.array([(joint.lower_rad, joint.upper_rad) for joint in exoskeleton.joints]).T
    margin = 0.5 * (1.0 - movement.range_share) * (upper - lower)
    low, high = lower + margin, upper - margin
    if manner.range_ratio < 1.0:
        half = 0.5 * manner.range_ratio * (high - low)
        centre = generator.uniform(low + half, high - half)
        low, high = centre - half, centre + half
    elif manner.range_ratio > 1.0:
        wider = 0.5 * (manner.range_ratio - 1.0) * (high - low)
        low, high = np.maximum(low - wider, lower), np.minimum(high + wider, upper)
    move_ratio, rest_ratio = manner.duration_ratio, manner.rest_ratio
    return reach_postures(
        generator,
        low,
        high,
        samples,
        exoskeleton.sampling_rate_hz,
        (move_ratio * movement.shortest_move_s, move_ratio * movement.longest_move_s),
        (rest_ratio * movement.shortest_rest_s, rest_ratio * movement.longest_rest_s),
    )
