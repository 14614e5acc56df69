"""The simulated rig: an exoskeleton under a plant, with people in it.

Configuration and trials flow in, recordings flow out. Every random number comes from the generator given to `execute`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from stages.science.plant.interaction import Motion, interact
from stages.science.plant.joint import STABLE, quickest_rate
from stages.science.plant.participant import Intention, Participant, Person, embody, intend, nobody, rest
from stages.science.plant.plant import Plant
from stages.science.plant.stepping import Steps
from stages.science.rig import clock
from stages.science.rig.attendance import Moment
from stages.science.rig.contract import RigError, TrialStopped, Watch, tidy
from stages.science.rig.excitation import Movement, move_freely
from stages.science.rig.filling import FillingRig, fill
from stages.science.rig.limits import apply_limits, check_limits
from stages.science.rig.pacing import pace, undisturbed
from stages.science.rig.sensors import record
from stages.science.rig.trial import Recording, Trial
from stages.science.signals.trajectories import Array

SHOWN_HZ = 100.0
"""Rate at which a trial that takes its time is shown."""
SHORTEST_S = 0.25
"""Time below which nothing is kept of a trial that was stopped, s: no velocity can be told from it."""
LATE_S = 0.1
"""From which on a sample is late for a person who points, s: they acted on what was long over."""
POINTER_S = 0.04
"""Time constant that smooths what a pointer tells sixty times a second, s."""


class SimulatedRig(FillingRig):
    """A rig without hardware; with a lead-in of 0, trials begin with muscles that are filled and settled."""

    real: ClassVar[bool] = False

    plant: Plant
    experimenter: Participant
    movement: Movement
    realtime: bool
    pointer: str | None

    @model_validator(mode="after")
    def _check_fit(self) -> Self:
        self.plant.check_against(self.exoskeleton)
        check_limits(self.limits, self.exoskeleton.muscles)
        if self._lead_samples:
            self._check_filling()
        people = {f"participants.{name}": each for name, each in self.participants.items()}
        for path, person in {**people, "experimenter": self.experimenter}.items():
            try:
                person.check_against(self.exoskeleton, self.samples + self._lead_samples)
            except ValueError as error:
                raise ValueError(f"{path}.{error}") from None
        self._check_step()
        if self.pointer is not None and self.pointer not in self.participants:
            raise ValueError(
                f"pointer: expected one of the participants ({', '.join(self.participants)}), got {self.pointer}"
            )
        if self.pointer is not None and not self.realtime:
            raise ValueError("realtime: expected true, as a person points in real time; set rig.realtime=true")
        return self

    def _check_step(self) -> None:
        quickest, joint = max(
            (quickest_rate(joint, constants), joint.name)
            for person in (*self.participants.values(), self.experimenter)
            for joint, constants in zip(self.exoskeleton.joints, embody(person, self.exoskeleton), strict=True)
        )
        if self.plant.integration_step_s * quickest > STABLE:
            raise ValueError(
                f"plant.integration_step_s: expected at most {STABLE / quickest:.3g}, beyond which the motion of joint "
                f"{joint} against its end stop diverges, got {self.plant.integration_step_s}; lower it, or change "
                "what makes the joint quick: inertia_kg_m2, stop_nm_per_rad, stop_nm_s_per_rad, viscous_nm_s_per_rad, "
                "strength_nm, or a person's stiffness_per_rad and damping_ratio"
            )

    def connect(self) -> None:
        """Begin.

        Raises
        ------
        RigError
            When a person is to point at postures and there is no page to do so.
        """
        if self.pointer is not None:
            if not self.attendance.attends:
                raise RigError(f"participant {self.pointer} points at postures on a page: set operator_ui=pages")
            command = np.zeros((4, len(self.muscles)))
            steps = self._begin(self._middle, embody(self.experimenter, self.exoskeleton), command)
            while not steps.over:  # compiles what a step takes, before a person waits for it
                steps.step(command[0])
        super().connect()

    @property
    def _middle(self) -> Array:
        return np.array([0.5 * (joint.lower_rad + joint.upper_rad) for joint in self.exoskeleton.joints])

    def _begin(self, angle: Array, person: Sequence[Person], command: Array) -> Steps:
        """Begin a trial of commands (T, M) at rest in a posture (J,), which is intended throughout."""
        held = Intention(*(np.repeat(each[None], len(command), axis=0) for each in (angle, 0 * angle, 0 * angle)))
        steps = Steps(self.exoskeleton, self.plant, held, person, angle)
        steps.begin(command[0])
        return steps

    @property
    def pointed(self) -> bool:
        """Whether a participant points at postures on a page."""
        return self.pointer is not None

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Simulate one trial.

        Raises
        ------
        TrialStopped
            When who attends stopped one that takes its time.
        """
        command, clipped = apply_limits(trial.pressure_command_kpa, self.limits, self.exoskeleton)
        lead = self._lead_samples
        whole = np.concatenate([fill(command[0], lead, self.filling_share), command])
        follows = trial.participant == self.pointer
        if follows:
            moved, late_s = self._follow(trial, whole)
        else:
            moved, late_s = self._move(trial, whole, generator), np.zeros(len(whole))
        taken = len(moved.force_n)
        done = taken - lead
        if done < min(self.samples, SHORTEST_S * self.sampling_rate_hz):
            raise self._stopped(max(done, 0))
        clipped = np.concatenate([np.full((lead, len(self.muscles)), "ramp", dtype=clipped.dtype), clipped])
        recording = record(moved, whole[:taken], self.exoskeleton, self.plant, generator, lead=lead)
        status = np.repeat(np.where(late_s[:taken] > LATE_S, "late", "ok")[:, None], len(self.muscles), axis=1)
        recording = replace(recording, clipped_by=clipped[:taken], late_s=late_s[:taken], status=status)
        if self.realtime and not follows:
            done = self._play(trial, whole, recording)
        if watch is not None and (self.attendance.attends or done < len(command)):
            watch(tidy(recording.cut(slice(lead + done)), self))
        if done < len(command):
            raise self._stopped(done)
        return recording

    def _stopped(self, done: int) -> TrialStopped:
        when = f"{done / self.sampling_rate_hz:.2f} s into the trial"
        return TrialStopped(f"stopped {when}: {self.attendance.why_stop()}", clock.now_s())

    def _play(self, trial: Trial, command: Array, recording: Recording) -> int:
        """Show a recording at the pace of its clock; return how many samples of the trial were over at a stop."""
        angle, pressure, force = recording.joint_angle_rad, recording.pressure_kpa, recording.force_n
        for index in self._keep_time(trial):
            sample = recording.time_s[index], angle[index], command[index], pressure[index], force[index]
            self.attendance.show(Moment(*sample))
            if self.attendance.why_stop():
                return max(index - self._lead_samples, 0)
        return self.samples

    def _follow(self, trial: Trial, command: Array) -> tuple[Motion, Array]:
        """Simulate a trial while a person points; return also how late each sample was, s. A stop ends it early."""
        lower, upper = np.array([(joint.lower_rad, joint.upper_rad) for joint in self.exoskeleton.joints]).T
        pointed = self.attendance.ask_pointer()
        if pointed is None:
            pointed = self._middle if trial.reference_rad is None else trial.reference_rad[0]
        angle = np.clip(pointed, lower, upper)
        steps = self._begin(angle, embody(self.participants[trial.participant], self.exoskeleton), command)
        share = 1.0 - math.exp(-1.0 / (self.sampling_rate_hz * POINTER_S))
        begun_s, late_s = clock.now_s(), np.zeros(len(command))
        for index in self._keep_time(trial):
            newest = self.attendance.ask_pointer()
            aim = angle if newest is None else np.clip(newest, lower, upper)
            while steps.at < index:
                step = share * (aim - angle)
                angle = angle + step
                steps.aim(angle, step * self.sampling_rate_hz)
                steps.step(command[steps.at])
                late_s[steps.at] = max(clock.now_s() - begun_s - steps.at / self.sampling_rate_hz, 0.0)
            at = steps.at
            time_s = (at - self._lead_samples) / self.sampling_rate_hz
            self.attendance.show(Moment(time_s, steps.angle[at], command[at], steps.pressure[at], steps.force[at]))
            if self.attendance.why_stop():
                break
        return steps.collect(), late_s

    def _keep_time(self, trial: Trial) -> Iterator[int]:
        """Yield the sample that is due, lead-in included, at most `SHOWN_HZ` times a second, and the last one."""
        every = max(round(self.sampling_rate_hz / SHOWN_HZ), 1)
        last = self._lead_samples + self.samples - 1
        with undisturbed():
            for tick in pace(-(-last // every) + 1, every / self.sampling_rate_hz):
                if tick.index == 0:
                    self.attendance.begin(trial, tick.due_s + self._lead_samples / self.sampling_rate_hz)
                yield min(tick.index * every, last)

    def _move(self, trial: Trial, command: Array, generator: np.random.Generator) -> Motion:
        if trial.kind == "passive":
            intention, person = rest(self.exoskeleton, len(command)), nobody(self.exoskeleton)
            return interact(self.exoskeleton, self.plant, command, intention, person, self._middle)
        who = self.experimenter if trial.participant == "experimenter" else self.participants[trial.participant]
        shown = trial.reference_rad
        if shown is None:
            shown = move_freely(self.movement, self.exoskeleton, self.samples, generator, trial.manner)
        held = np.concatenate([np.repeat(shown[:1], self._lead_samples, axis=0), shown])
        intention = intend(who, self.exoskeleton, held, generator)
        person = embody(who, self.exoskeleton)
        return interact(self.exoskeleton, self.plant, command, intention, person, intention.angle_rad[0])
