"""The session between a rig, which runs in one thread, and the pages or the terminal, which run in another one.

Trials, samples and recordings flow in from the rig; what is to be seen flows out as one scene, and each decision of the
operator flows back. No page makes the rig wait while a trial runs, and the newest sample wins.
"""

import logging
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig import clock
from stages.science.rig.attendance import Attendance, Moment, StudyPaused, TrialDeclined
from stages.science.rig.contract import RigError
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.trajectories import Array

log = logging.getLogger("pamid")

ROLES = ("participant", "operator")
MOST_FRAMES = 100_000
"""Frames of a trial that are remembered, beyond which the oldest ones go."""
SHOWN_HZ = 60.0
"""Rate at which curves of a recording are shown."""
LATEST_FRAMES_S = 0.4
"""Time after a trial in which its last frames are waited for, s."""

Phase = Literal["busy", "proposed", "countdown", "running", "judging", "over"]
Word = Literal["accept", "skip", "keep", "repeat", "reject", "pause"]
ACCEPTED: tuple[Word, str] = ("accept", "")
KEPT: tuple[Word, str] = ("keep", "by itself")


class OperatorSettings(Declared):
    """How trials are attended."""

    countdown_s: float = Field(ge=0.0, le=60.0, description="from the operator's word to the filling of muscles, s")
    result_s: float = Field(ge=0.0, le=60.0, description="time of a result where trials follow by themselves, s")
    lost_after_s: PositiveFloat = Field(le=10.0, description="silence of a page after which it is lost, s")
    needed: list[Literal["participant", "operator"]] = Field(description="pages whose loss stops a trial")


Frame = tuple[float, ...]
"""When a page drew it (monotonic clock), and the times in the trial of reference and posture shown, s; nan for none."""


class Refused(Exception):
    """A decision does not fit what is asked now; the message says what does."""


class OperatorSession(Attendance):
    """Attends the trials of a rig; `drawn` says whether the participant sees them, and can point at postures."""

    attends = True

    def __init__(self, settings: OperatorSettings, drawn: bool = True):
        self.settings, self.drawn = settings, drawn
        self.note = ""
        self._changed = threading.Condition()
        self.number = 0
        """Of the scene; another one means that something else is to be seen."""
        self.moment: Moment | None = None
        """The newest sample of this trial."""
        self._phase: Phase = "busy"
        self._question = 0
        self._machine: dict[str, Any] = {}
        self._described: dict[str, Any] | None = None
        self._rate_hz, self._every = 1.0, 1
        self._choices: tuple[Word, ...] = ()
        self._decision: tuple[Word, str] | None = None
        self._starts_at_s: float | None = None
        self._began_s: float | None = None
        self._stop = ""
        self._automatic = False
        self._outcome: dict[str, Any] = {}
        self._history: list[dict[str, str]] = []
        self._frames: deque[Frame] = deque(maxlen=MOST_FRAMES)
        self._pages: dict[int, tuple[str, float]] = {}  # role, and when it was heard, s
        self._pointer: Array | None = None

    # what the rig does

    def describe(self, exoskeleton: Exoskeleton, pointed: bool) -> None:
        """Take the machine that is shown; refuse with `RigError` to be pointed at where nobody sees it."""
        if pointed and not self.drawn:
            raise RigError("a participant who points at postures does so on a page: set operator_ui=pages")
        self._rate_hz = exoskeleton.sampling_rate_hz
        self._every = max(round(self._rate_hz / SHOWN_HZ), 1)
        self._machine = {
            "pointer": pointed,
            "joints": [each.model_dump(include={"name", "lower_rad", "upper_rad"}) for each in exoskeleton.joints],
            "muscles": [
                {"name": each.name, "joint": each.joint, "role": each.role, "max_kpa": each.max_pressure_kpa}
                for each in exoskeleton.muscles
            ],
        }
        self._turn("busy")

    def propose(self, trial: Trial) -> None:
        """Return once a trial is accepted and counted down; `TrialDeclined` and `StudyPaused` say why it is not."""
        can_skip = trial.proposal and trial.proposal.can_skip
        choices: tuple[Word, ...] = ("accept", "skip", "pause") if can_skip else ("accept", "pause")
        self._described, self._outcome, self.moment = self._describe(trial), {}, None
        while True:
            word, note = ACCEPTED if self._automatic else self._ask("proposed", choices)
            if word != "accept":
                self._leave(trial, word, note)
            self.note = note
            if self._count_down():
                return
            self._automatic = False

    def begin(self, trial: Trial, starts_at_s: float) -> None:
        """Take note that the trial's first sample is due at a time of the monotonic clock, s."""
        with self._changed:
            self._starts_at_s = self._began_s = starts_at_s
            self._frames.clear()
            self._turn("running")

    def show(self, moment: Moment) -> None:
        """Take the newest sample."""
        self.moment = moment

    def why_stop(self) -> str:
        """Return why somebody wants the trial stopped."""
        if not self._stop and self._phase in ("countdown", "running") and (lost := self._find_lost()):
            self.stop(lost)
        return self._stop

    def judge(self, trial: Trial, recording: Recording | None, stopped: str) -> None:
        """Return once the recording is kept; `TrialDeclined` and, without one, `StudyPaused` say why it is not."""
        can_reject = trial.proposal is not None and trial.proposal.can_reject
        again: tuple[Word, ...] = ("repeat", "reject") if can_reject else ("repeat",)
        self._outcome = {"stopped": stopped} if recording is None else self._sum_up(trial, recording)
        if recording is None:
            self._automatic = False
            log.warning("%s: %s", trial.label or trial.kind, stopped)
        choices: tuple[Word, ...] = (*again, "pause") if recording is None else ("keep", *again)
        if self._automatic:
            self._turn("judging")
            until_s = clock.now_s() + self.settings.result_s
            with self._changed:
                while self._automatic and clock.now_s() < until_s:
                    clock.wait(self._changed, min(0.1, until_s - clock.now_s()))
        word, note = KEPT if self._automatic else self._ask("judging", choices)
        self._starts_at_s = None
        self.note = "; ".join(filter(None, (self.note, note)))
        if word != "keep":
            self._leave(trial, word, self.note, stopped)
        self._remember(trial, word, self.note)
        self._turn("busy")

    def tell(self, problem: str) -> None:
        """Show that the rig ended the trial and the run with it."""
        self._outcome = {"problem": problem}
        self._turn("over")

    def add_display(self, recording: Recording) -> Recording:
        """Return a recording with when a participant's page showed its samples, s from the trial's start."""
        if self._began_s is None:
            return recording
        if self._count("participant"):
            clock.sleep(self._began_s + float(recording.time_s[-1]) + LATEST_FRAMES_S - clock.now_s())
        with self._changed:
            shown = np.array(sorted(self._frames), dtype=float).reshape(-1, 3)
        found = {}
        for name, column in (("reference_shown_s", 1), ("measured_shown_s", 2)):
            drawn = shown[np.isfinite(shown[:, column])]
            reached = np.maximum.accumulate(drawn[:, column])
            first = np.searchsorted(reached, recording.time_s - 1e-9)
            times = np.append(drawn[:, 0] - self._began_s, np.nan)
            found[name] = times[np.minimum(first, len(drawn))]
        return replace(recording, **found)

    def ask_pointer(self) -> Array | None:
        """Return the posture that the participant points at, rad; None before the first."""
        return self._pointer

    # what pages do

    def see(self) -> dict[str, Any]:
        """Return all that is to be seen but the newest sample."""
        with self._changed:
            return {
                "number": self.number,
                "question": self._question,
                "phase": self._phase,
                "machine": self._machine,
                "trial": self._described,
                "choices": list(self._choices),
                "automatic": self._automatic,
                "starts_at_s": self._starts_at_s,
                "outcome": self._outcome,
                "history": list(self._history),
                "stop": self._stop,
                "pages": {role: self._count(role) for role in ROLES},
                "needed": list(self.settings.needed),
            }

    def decide(self, word: str, note: str, question: int) -> None:
        """Take the operator's decision on the question of a scene.

        It raises `Refused` where another one is asked by now, it has no such answer, or a page is missing.
        """
        with self._changed:
            if question != self._question or self._decision is not None:
                raise Refused("this was decided already, or something else is asked now")
            if word not in self._choices:
                raise Refused(f"expected one of {', '.join(self._choices) or 'no decisions now'}, got {word!r}")
            missing = [role for role in self.settings.needed if not self._count(role)]
            if word == "accept" and missing:
                raise Refused(f"the {' and the '.join(missing)} page is not open, whose loss would stop the trial")
            # a terminal of another encoding may pass on characters that no file can hold
            text = note.encode("utf-8", "replace").decode("utf-8").strip()
            self._decision = next(each for each in self._choices if each == word), text
            self._changed.notify_all()

    def stop(self, why: str) -> None:
        """Have the trial stopped, one that was just accepted too, and nothing begin by itself any more."""
        with self._changed:
            self._automatic = False
            self._stop = self._stop or why
            self._turn()

    def go_on(self, automatic: bool) -> None:
        """Have trials follow each other by themselves until somebody stops one, or no longer."""
        with self._changed:
            self._automatic = automatic
            if automatic and self._phase not in ("countdown", "running"):
                self._stop = ""
            self._turn()

    def draw(self, frames: Sequence[Frame], starts_at_s: float) -> None:
        """Take what a participant's page drew of the trial that begins at a time; of another one, nothing is taken."""
        with self._changed:
            if starts_at_s == self._began_s:
                self._frames.extend(frames)

    def point(self, angle_rad: Array) -> None:
        """Take the posture that the participant points at, rad."""
        self._pointer = angle_rad

    def join(self, key: int, role: str) -> None:
        """Take note of an open page, and again each time it is heard."""
        with self._changed:
            self.number += key not in self._pages
            self._pages[key] = role, clock.now_s()

    def leave(self, key: int) -> None:
        """Take note that a page was closed."""
        with self._changed:
            self.number += self._pages.pop(key, None) is not None

    # within

    def _turn(self, phase: Phase | None = None) -> None:
        """Tell who waits that something has changed."""
        with self._changed:
            self._phase = phase or self._phase
            self.number += 1
            self._changed.notify_all()

    def _ask(self, phase: Phase, choices: tuple[Word, ...]) -> tuple[Word, str]:
        """Wait for a decision; a signal ends the wait."""
        with self._changed:
            self._phase, self._choices, self._decision = phase, choices, None
            if phase == "proposed":
                self._stop = ""
            self._question += 1
            self.number += 1
            while self._decision is None and not (self._automatic and phase == "proposed"):
                clock.wait(self._changed, 0.1)
            decision = self._decision or ACCEPTED
            self._choices = ()
            return decision

    def _count_down(self) -> bool:
        """Return whether nobody stopped the trial before it began."""
        self._starts_at_s = clock.now_s() + self.settings.countdown_s
        self._turn("countdown")
        with self._changed:
            while not self.why_stop():
                left_s = self._starts_at_s - clock.now_s()
                if left_s <= 0.0:
                    return True
                clock.wait(self._changed, min(0.05, left_s))
            self._starts_at_s = None
            self._outcome = {"stopped": f"stopped before it began: {self._stop}"}
            return False

    def _find_lost(self) -> str:
        for role in self.settings.needed:
            heard = [heard_s for its, heard_s in list(self._pages.values()) if its == role]
            if not heard:
                return f"the {role}'s page was closed"
            silent_s = clock.now_s() - max(heard)
            if silent_s > self.settings.lost_after_s:
                return f"the {role}'s page was not heard for {silent_s:.1f} s"
        return ""

    def _count(self, role: str) -> int:
        return sum(its == role for its, _ in list(self._pages.values()))

    def _leave(self, trial: Trial, word: Word, note: str, stopped: str = "") -> None:
        """End a trial that does not become part of the study."""
        self._starts_at_s = None
        self._remember(trial, word, note)
        self._turn("over" if word == "pause" else "busy")
        if word == "pause":
            raise StudyPaused(trial.label or trial.kind, note, stopped)
        raise TrialDeclined(word, trial, note, stopped)

    def _remember(self, trial: Trial, word: Word, note: str) -> None:
        log.info("operator: %s %s%s", word, trial.label or trial.kind, f" ({note})" if note else "")
        self._history.append({"trial": _entitle(trial), "decision": word, "note": note})

    def _sum_up(self, trial: Trial, recording: Recording) -> dict[str, Any]:
        """Return what is shown of a recording, without its lead-in."""
        recording = recording.without_lead_in()
        names = ("time_s", "joint_angle_rad", "pressure_command_kpa", "pressure_kpa", "force_n")
        summary: dict[str, Any] = {name: getattr(recording, name)[:: self._every].tolist() for name in names}
        summary["samples"] = len(recording.time_s)
        summary["not_ok"] = int((recording.status != "ok").any(axis=1).sum())
        if trial.reference_rad is not None:
            off = recording.joint_angle_rad - trial.reference_rad[: len(recording.time_s)]
            summary["tracking_error_rad"] = np.sqrt(np.mean(off**2, axis=0)).tolist()
        return summary

    def _describe(self, trial: Trial) -> dict[str, Any]:
        """Return what is shown of a trial before it is executed."""
        told, every, samples = trial.proposal, self._every, len(trial.pressure_command_kpa)
        return {
            "title": _entitle(trial),
            "label": trial.label or trial.kind,
            "kind": trial.kind,
            "duration_s": samples / self._rate_hz,
            "time_s": (np.arange(samples)[::every] / self._rate_hz).tolist(),
            "pressure_command_kpa": trial.pressure_command_kpa[::every].tolist(),
            "reference_rad": None if trial.reference_rad is None else trial.reference_rad[::every].tolist(),
            **{name: getattr(told, name, None) for name in ("position", "total", "trajectory", "utility_unit")},
            "reason": told.reason if told else "",
            "utilities": [[int(k), float(v)] for k, v in told.utilities.items()] if told else [],
            "errors": list(told.errors) if told else [],
        }


def _entitle(trial: Trial) -> str:
    """Return which trial it is, of how many, and who does what in it."""
    doing = {"passive": "nobody moves", "free": f"{trial.participant} moves freely"}
    does = doing.get(trial.kind, f"{trial.participant} follows the reference")
    return f"trial {trial.proposal.position} of {trial.proposal.total}: {does}" if trial.proposal else does
