"""The simulated rig: an exoskeleton under a plant, with people in it.

Configuration and trials flow in, recordings flow out. Every random number comes from the generator given to `execute`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from stages.plant.exoskeleton import Exoskeleton
from stages.plant.interaction import Motion, interact
from stages.plant.participant import Participant, embody, intend, nobody, rest
from stages.plant.plant import Plant
from stages.rig.contract import Recording, Rig, Trial
from stages.rig.limits import Limits, apply_limits, check_limits
from stages.rig.movement import Movement, move_freely
from stages.rig.sensors import record
from stages.signals.trajectories import Array


class SimulatedRig(Rig, BaseModel):
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
        How long the first command and posture are held before the trial, s; not recorded.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    real: ClassVar[bool] = False

    exoskeleton: Exoskeleton
    plant: Plant
    participants: dict[str, Participant]
    experimenter: Participant
    movement: Movement
    limits: Limits
    lead_in_s: float = Field(ge=0.0)
    _connected: bool = PrivateAttr(default=False)

    @model_validator(mode="after")
    def _check_fit(self) -> Self:
        self.plant.check_against(self.exoskeleton)
        check_limits(self.limits, self.exoskeleton.muscles)
        taken = {"experimenter", "nobody"} & set(self.participants)
        if taken:
            raise ValueError(f"participants: the name '{taken.pop()}' is reserved; give the participant another one")
        return self

    @property
    def muscles(self) -> Sequence[str]:
        """Names of the muscles."""
        return self.exoskeleton.muscle_names

    @property
    def joints(self) -> Sequence[str]:
        """Names of the joints."""
        return self.exoskeleton.joint_names

    @property
    def muscle_joints(self) -> Sequence[str]:
        """Name of the joint that each muscle moves."""
        return [muscle.joint for muscle in self.exoskeleton.muscles]

    @property
    def sampling_rate_hz(self) -> float:
        """Samples per second."""
        return self.exoskeleton.sampling_rate_hz

    @property
    def samples(self) -> int:
        """Samples of one trial."""
        return self.exoskeleton.samples

    @property
    def people(self) -> Sequence[str]:
        """The participants and the experimenter."""
        return [*self.participants, "experimenter"]

    @property
    def connected(self) -> bool:
        """Whether the rig is inside its ``with`` block."""
        return self._connected

    def connect(self) -> None:
        """Begin."""
        self._connected = True

    def release(self) -> None:
        """End."""
        self._connected = False

    def run(self, trial: Trial, generator: np.random.Generator) -> Recording:
        """Simulate one trial."""
        command = apply_limits(trial.pressure_command_kpa, self.limits, self.exoskeleton.muscles, self.sampling_rate_hz)
        lead = round(self.lead_in_s * self.sampling_rate_hz)
        motion = self._move(trial, _hold_first(command, lead), lead, generator)
        return record(_cut(motion, lead), command, self.exoskeleton, self.plant, generator)

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
