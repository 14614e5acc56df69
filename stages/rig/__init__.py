"""Rigs: what executes a trial and returns a recording, simulated or real, under one contract.

The rigs themselves are named by configuration and imported from there.
"""

from stages.rig.contract import MEASUREMENT_COLUMNS, MOST_ROWS, Recording, Rig, RigError, Trial, tidy
from stages.rig.excitation import FreeMovements, RigWithLimits, check_levels
from stages.rig.reference import track, tracked_trial
from stages.rig.sessions import RecordedSession, SessionRig, seal_truth
from stages.rig.sweeps import Sweeps, passive_trial

__all__ = [
    "MEASUREMENT_COLUMNS",
    "MOST_ROWS",
    "FreeMovements",
    "RecordedSession",
    "Recording",
    "Rig",
    "RigError",
    "RigWithLimits",
    "SessionRig",
    "Sweeps",
    "Trial",
    "check_levels",
    "passive_trial",
    "seal_truth",
    "tidy",
    "track",
    "tracked_trial",
]
