"""What rigs share whose machine and people stand in the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from pydantic import BaseModel, ConfigDict, PrivateAttr, model_validator

from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.participant import Participant
from stages.science.rig.attendance import Attendance
from stages.science.rig.contract import Rig


class ConfiguredRig(Rig, BaseModel):
    """A rig for a described machine; a subclass runs trials.

    Beside the participants, ``experimenter`` moves freely and ``nobody`` is in passive trials.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    exoskeleton: Exoskeleton
    participants: dict[str, Participant]
    _connected: bool = PrivateAttr(default=False)
    _attendance: Attendance | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _keep_reserved_names(self) -> Self:
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
    def attendance(self) -> Attendance | None:
        """Who sees its trials and decides on them, if somebody does."""
        return self._attendance

    @property
    def pointed(self) -> bool:
        """Whether a participant points at postures on a page."""
        return False

    def connect_interface(self, attendance: Attendance) -> None:
        """Have somebody see its trials and decide on them."""
        attendance.describe(self.exoskeleton, self.pointed)
        self._attendance = attendance

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
