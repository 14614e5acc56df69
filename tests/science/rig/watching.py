"""Trials by themselves, and somebody who lets every one begin and sees all of it, without an operator session."""

import numpy as np

from stages.science.rig.attendance import Attendance, TrialDeclined
from stages.science.rig.trial import Trial


class Watching(Attendance):
    """Keeps what is shown; stops a trial and has it repeated, or points at a posture, where that is wanted."""

    attends = True

    def __init__(self, stop_at_s=np.inf, points_at=None):
        self.stop_at_s, self.points_at, self.moments = stop_at_s, points_at, []

    def propose(self, trial):
        self.moments = []

    def begin(self, trial, starts_at_s):
        self.starts_at_s = starts_at_s

    def show(self, moment):
        self.moments.append(moment)

    def why_stop(self):
        return "enough" if self.moments and self.moments[-1].time_s >= self.stop_at_s else ""

    def ask_pointer(self):
        return self.points_at

    def judge(self, trial, recording, stopped):
        if stopped:
            raise TrialDeclined("repeat", trial.label, stopped=stopped)

    def collect(self):
        names = ("time_s", "command_kpa", "pressure_kpa")
        return (np.array([getattr(each, name) for each in self.moments]) for name in names)


def execute_whole(rig, trial, seed=0, watch=None):
    """Return what was recorded, with the lead-in."""
    with rig:
        return rig.execute(trial, np.random.default_rng(seed), watch)


def execute(rig, trial, seed=0, watch=None):
    """Return what was recorded of the trial alone."""
    return execute_whole(rig, trial, seed, watch).without_lead_in()


def wave(rig, kind="free", level=120.0):
    """A trial of pressures that rise and fall, higher on the second muscle of each joint."""
    who = {"free": "experimenter", "passive": "nobody"}[kind]
    rising = 1.0 + 0.4 * np.sin(np.linspace(0.0, 6.0, rig.samples))[:, None]
    return Trial(kind, who, level * rising * [1.0, 2.0, 1.0, 2.0], label=f"{kind} 1")
