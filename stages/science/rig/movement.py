"""How an experimenter moves when nothing is asked of them."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.signals.trajectories import Array, reach_postures


class Movement(Declared):
    """Reaches between random postures, with rests."""

    shortest_move_s: PositiveFloat = Field(description="quickest reach, s")
    longest_move_s: PositiveFloat = Field(description="slowest reach, s")
    shortest_rest_s: float = Field(ge=0.0, description="shortest rest, s")
    longest_rest_s: float = Field(ge=0.0, description="longest rest, s")
    range_share: float = Field(gt=0.0, le=1.0, description="share of the joint's range that postures span, 1")

    @model_validator(mode="after")
    def _order(self) -> Self:
        for kind, low, high in (
            ("move", self.shortest_move_s, self.longest_move_s),
            ("rest", self.shortest_rest_s, self.longest_rest_s),
        ):
            if low > high:
                raise ValueError(f"expected shortest_{kind}_s <= longest_{kind}_s, got {low} and {high}")
        return self


def move_freely(movement: Movement, exoskeleton: Exoskeleton, samples: int, generator: np.random.Generator) -> Array:
    """Draw a natural movement of all joints, (samples, J), rad."""
    lower = np.array([joint.lower_rad for joint in exoskeleton.joints])
    upper = np.array([joint.upper_rad for joint in exoskeleton.joints])
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
