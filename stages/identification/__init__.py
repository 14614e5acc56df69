"""Identification of all muscles together: what is known of each, and which samples its model stands on.

Frames in the columns of the tables flow in; standardised arrays and frames of samples flow out. The science of one
model is in `gp`; here it meets names, units and muscles.
"""

from stages.identification.cost import measure_cost
from stages.identification.description import describe_choice, describe_models
from stages.identification.force_test import ForceTest
from stages.identification.loop_settings import DesignSettings, LoopSettings
from stages.identification.muscle_set import MuscleSet
from stages.identification.recorded_models import RecordedModels
from stages.identification.replay import Replay, TimeShift
from stages.identification.samples import keep_usable, place_evenly, spread_evenly, take, thin

__all__ = [
    "DesignSettings",
    "ForceTest",
    "LoopSettings",
    "MuscleSet",
    "RecordedModels",
    "Replay",
    "TimeShift",
    "describe_choice",
    "describe_models",
    "keep_usable",
    "measure_cost",
    "place_evenly",
    "spread_evenly",
    "take",
    "thin",
]
