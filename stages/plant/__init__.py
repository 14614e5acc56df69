"""The simulated machine and the person in it.

Configuration says which muscles move which joints (`exoskeleton`), with which constants and named effects (`plant`),
and how a person moves (`participant`). Commands and intentions flow in; pressures, forces and joint motion come out.
"""

from stages.plant.exoskeleton import MOST_CONTRACTED, Exoskeleton, Joint, Muscle
from stages.plant.participant import Participant

__all__ = ["MOST_CONTRACTED", "Exoskeleton", "Joint", "Muscle", "Participant"]
