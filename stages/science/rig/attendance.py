"""Who attends a trial: an operator who decides on it, a participant who sees it.

A trial that is proposed and the samples that are taken flow to them; decisions flow back, as the exceptions here where
a trial does not become part of the study.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple, TypeVar

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.trajectories import Array

Landed = TypeVar("Landed")

DECLINED = {
    "skip": "skipped by the operator",
    "repeat": "to be repeated, says the operator",
    "reject": "rejected by the operator",
}
"""Decisions that keep a trial out of the study, and what they mean."""


class TrialDeclined(Exception):
    """An operator did not let a trial become part of the study.

    The decision is one of `DECLINED`; told with it are the operator's note, and why the trial was stopped, if it was.
    """

    def __init__(self, decision: str, trial: Trial, note: str = "", stopped: str = ""):
        why = f"{stopped}; " if stopped else ""
        super().__init__(f"{why}{DECLINED[decision]}{f': {note}' if note else ''}")
        self.decision, self.trial, self.note, self.stopped = decision, trial, note, stopped


class StudyPaused(Exception):
    """An operator ends the study for today; the label is that of the next trial, the rest as of `TrialDeclined`."""

    def __init__(self, label: str, note: str = "", stopped: str = ""):
        why = f"{stopped}; " if stopped else ""
        super().__init__(f"{why}the operator stopped for today; next is {label}{f' ({note})' if note else ''}")
        self.asks: dict[str, str] = {}
        """Nothing to execute: what makes a pause of it."""


def until_kept(land: Callable[[], Landed]) -> Landed:
    """Return what landing a trial returns, once it need not be repeated; `TrialDeclined` tells it is declined."""
    while True:
        try:
            return land()
        except TrialDeclined as declined:
            if declined.decision != "repeat":
                raise


class Moment(NamedTuple):
    """One sample of J joints and M muscles, as it is shown while a trial runs; before it, muscles are being filled."""

    time_s: float
    angle_rad: Array
    command_kpa: Array
    pressure_kpa: Array
    force_n: Array


class Attendance:
    """Who sees trials and decides on them; a rig tells it what it does. Here it is nobody, who lets all trials pass."""

    attends: ClassVar[bool] = False
    """Whether it is somebody."""
    note: str = ""
    """What the operator wrote with the last decisions."""

    def describe(self, exoskeleton: Exoskeleton, pointed: bool) -> None:
        """Take the machine, and whether the participant points at postures."""

    def ask_pointer(self) -> Array | None:
        """Return the posture that the participant points at, rad; None before the first. Never waits."""
        return None

    def propose(self, trial: Trial) -> None:
        """Return once the trial may begin; `TrialDeclined` and `StudyPaused` tell that it may not."""

    def begin(self, trial: Trial, starts_at_s: float) -> None:
        """Take note that the trial's first sample is due at a time of the monotonic clock, s."""

    def show(self, moment: Moment) -> None:
        """Take the newest sample; never waits."""

    def why_stop(self) -> str:
        """Return why somebody wants the trial stopped; empty where nobody does. Never waits."""
        return ""

    def judge(self, trial: Trial, recording: Recording | None, stopped: str) -> None:
        """Return once it is decided that the recording is part of the study; without one, why it was stopped is told.

        `TrialDeclined` and `StudyPaused` tell that it is not.
        """

    def add_display(self, recording: Recording) -> Recording:
        """Return the recording with when its samples were shown."""
        return recording

    def tell(self, problem: str) -> None:
        """Show that the rig ended the trial."""
