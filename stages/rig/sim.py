"""The simulated rig: an exoskeleton under a plant, with people in it.

Configuration and trials flow in, recordings flow out. Every random number comes from the generator given to `execute`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from stages.plant.interaction import Motion, interact
from stages.plant.joint import STABLE, quickest_rate
from stages.plant.participant import Participant, embody, intend, nobody, rest
from stages.plant.plant import Plant
from stages.rig.configured import ConfiguredRig
from stages.rig.contract import Recording, Trial, Watch
from stages.rig.limits import Limits, apply_limits, check_limits
from stages.rig.movement import Movement, move_freely
from stages.rig.sensors import record
from stages.signals.trajectories import Array


class SimulatedRig(ConfiguredRig):
    """A rig without hardware.

    Parameters
    ----------
    exoskeleton : Exoskeleton
        Joints, muscles and sampling.
    plant : Plant
        Constants and effects.
    participants : dict of str to Participant
        Who may track a reference.
    experimenter : Participant
        Who moves freely, by the name ``experimenter``.
    movement : Movement
        How they move.
    limits : dict of str to PressureLimit
        By type of muscle.
    lead_in_s : float
        How long the first command and posture are held before the trial, s; not recorded. Valves and limbs
        settle within seconds.
    """

    real: ClassVar[bool] = False

    plant: Plant
    experimenter: Participant
    movement: Movement
    limits: Limits
    lead_in_s: float = Field(ge=0.0, le=60.0)

    @model_validator(mode="after")
    def _check_fit(self) -> Self:
        self.plant.check_against(self.exoskeleton)
        check_limits(self.limits, self.exoskeleton.muscles)
        people = {f"participants.{name}": each for name, each in self.participants.items()}
        for path, person in {**people, "experimenter": self.experimenter}.items():
            try:
                person.check_against(self.exoskeleton, self.samples + self._lead_samples)
            except ValueError as error:
                raise ValueError(f"{path}.{error}") from None
        self._check_step()
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

    @property
    def _lead_samples(self) -> int:
        return round(self.lead_in_s * self.sampling_rate_hz)

    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Simulate one trial."""
        command, clipped = apply_limits(trial.pressure_command_kpa, self.limits, self.exoskeleton)
        lead = self._lead_samples
        motion = self._move(trial, _hold_first(command, lead), lead, generator)
        recording = record(_cut(motion, lead), command, self.exoskeleton, self.plant, generator)
        return replace(recording, clipped_by=clipped)

    def _move(self, trial: Trial, command: Array, lead: int, generator: np.random.Generator) -> Motion:
        if trial.kind == "passive":
            start = np.array([0.5 * (joint.lower_rad + joint.upper_rad) for joint in self.exoskeleton.joints])
            intention = rest(self.exoskeleton, len(command))
            return interact(self.exoskeleton, self.plant, command, intention, nobody(self.exoskeleton), start)
        who = self.experimenter if trial.participant == "experimenter" else self.participants[trial.participant]
        shown = trial.reference_rad
        if shown is None:
            shown = move_freely(self.movement, self.exoskeleton, self.samples, generator)
        intention = intend(who, self.exoskeleton, _hold_first(shown, lead), generator)
        person = embody(who, self.exoskeleton)
        return interact(self.exoskeleton, self.plant, command, intention, person, intention.angle_rad[0])


def _hold_first(values: Array, lead: int) -> Array:
    return np.concatenate([np.repeat(values[:1], lead, axis=0), values])


def _cut(motion: Motion, lead: int) -> Motion:
    return Motion(**{name: values[lead:] for name, values in vars(motion).items()})
