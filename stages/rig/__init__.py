"""Rigs: what executes a trial and returns a recording, simulated or real, under one contract.

The rigs themselves are named by configuration and imported from there.
"""

from stages.rig.attendance import Proposal, TrialDeclined, until_kept
from stages.rig.contract import (
    MEASUREMENT_COLUMNS,
    MOST_ROWS,
    RECORDING_COLUMNS,
    Recording,
    Rig,
    RigError,
    Trial,
    TrialStopped,
    Watch,
    tidy,
)
from stages.rig.excitation import FreeMovements, RigWithLimits, check_levels
from stages.rig.pacing import measure_pace
from stages.rig.reference import track, tracked_trial
from stages.rig.sessions import RecordedSession, SessionRig, seal_truth
from stages.rig.sweeps import Sweeps, passive_trial

__all__ = [
    "MEASUREMENT_COLUMNS",
    "MOST_ROWS",
    "RECORDING_COLUMNS",
    "FreeMovements",
    "Proposal",
    "RecordedSession",
    "Recording",
    "Rig",
    "RigError",
    "RigWithLimits",
    "SessionRig",
    "Sweeps",
    "Trial",
    "TrialDeclined",
    "TrialStopped",
    "Watch",
    "check_levels",
    "measure_pace",
    "passive_trial",
    "seal_truth",
    "tidy",
    "track",
    "tracked_trial",
    "until_kept",
]
