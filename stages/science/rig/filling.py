"""How muscles are filled before a trial: evenly over most of the lead-in, then at rest until the trial begins.

The trial's first command flows in; the commands of the lead-in flow out. Nobody in the machine is filled against in
milliseconds, as the limits on the rate alone would permit.
"""

import numpy as np
from pydantic import Field

from stages.science.rig.contract import LONGEST_LEAD_IN_S, Rig
from stages.science.rig.limits import Limits
from stages.science.signals.trajectories import Array


def fill(first_kpa: Array, samples: int, share: float) -> Array:
    """Return the commands of a lead-in of L samples (L, M), kPa gauge; L = 0 where a trial begins with filled muscles.

    Over a share of it they rise at one rate from vented to the first commands (M,), as applied, which then hold. All
    muscles have the same share of their first commands at a time, so that what pulls against each other keeps to the
    limits that those keep to. Of all ways to fill in a time this one has the smallest rate; valves round its ends off.
    """
    risen = np.minimum(np.arange(samples) / max(round(share * samples), 1), 1.0)
    return risen[:, None] * first_kpa


class FillingRig(Rig):
    """A rig that applies commands within limits, and fills the muscles in a lead-in, at times below 0."""

    limits: Limits
    lead_in_s: float = Field(ge=0.0, le=LONGEST_LEAD_IN_S)
    filling_share: float = Field(ge=0.5, le=1.0)

    def _check_filling(self) -> None:
        """Check that every muscle can be filled to its highest command within its limit on the rate."""
        for muscle in self.exoskeleton.muscles:
            limit = self.limits[muscle.type]
            shortest_s = limit.high_kpa / limit.slew_kpa_per_s / self.filling_share
            if shortest_s > self.lead_in_s:
                raise ValueError(
                    f"lead_in_s: expected at least {shortest_s:.3g} s, in whose filling_share {muscle.name} can be "
                    f"filled to any command within limits.{muscle.type}.slew_kpa_per_s, got {self.lead_in_s}"
                )

    @property
    def _lead_samples(self) -> int:
        return round(self.lead_in_s * self.sampling_rate_hz)
