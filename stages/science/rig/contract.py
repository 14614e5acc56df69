"""What every rig is: it takes a trial and returns what was applied and measured.

A `Trial` flows in, a `Recording` flows out; `tidy` turns it into the columns that tables of measurements share.
Simulated and real rigs are siblings: shapes are known before connecting, trials run inside ``with rig:``, and the rig
lets go of its actuators whatever happens.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import PrivateAttr, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.participant import Participant
from stages.science.rig.attendance import Attendance, TrialDeclined
from stages.science.rig.trial import CLIPPED_BY, PER_SAMPLE, STATUS, Recording, Trial
from stages.science.signals.columns import Column, column

LONGEST_LEAD_IN_S = 60.0
"""Longest time before a trial in which muscles are filled, s."""

MOST_ROWS = 50_000_000
"""Rows of a table of measurements, beyond which its ten numbers a row take over 4 GB and its copies no longer fit."""

Watch = Callable[[Mapping[str, NDArray[Any]]], None]
"""Is handed rows of samples, as of `tidy`, while a trial runs."""


class RigError(RuntimeError):
    """A rig was asked for what it cannot do now; the message says what to do instead."""


class TrialStopped(RigError):
    """A trial was stopped before its end, and the muscles were let down as far as the machine could be reached.

    ``noticed_at_s`` is when the reason was noticed, by the monotonic clock, s.
    """

    def __init__(self, message: str, noticed_at_s: float):
        super().__init__(message)
        self.noticed_at_s = noticed_at_s


class Rig(Declared):
    """Executes trials on the machine of the configuration; a subclass runs one trial, and says how it connects.

    Beside the participants, ``experimenter`` moves freely and ``nobody`` is in passive trials.
    """

    real: ClassVar[bool]
    recorded: ClassVar[bool] = False
    """Whether its trials were executed before, and nothing else can be."""

    exoskeleton: Exoskeleton
    participants: dict[str, Participant]
    _connected: bool = PrivateAttr(default=False)
    _attendance: Attendance = PrivateAttr(default_factory=Attendance)

    @model_validator(mode="after")
    def _keep_reserved_names(self) -> Self:
        taken = {"experimenter", "nobody"} & set(self.participants)
        if taken:
            raise ValueError(f"participants: the name '{taken.pop()}' is reserved; give the participant another one")
        return self

    @property
    def muscles(self) -> Sequence[str]:
        """Names of the muscles, in the order of the recordings' columns."""
        return self.exoskeleton.muscle_names

    @property
    def joints(self) -> Sequence[str]:
        """Names of the joints, in the order of the recordings' columns."""
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
        """Who may be in the machine: the participants and the experimenter."""
        return [*self.participants, "experimenter"]

    @property
    def pointed(self) -> bool:
        """Whether a participant points at postures on a page."""
        return False

    @property
    def attendance(self) -> Attendance:
        """Who sees its trials and decides on them; nobody by default."""
        return self._attendance

    def connect_interface(self, attendance: Attendance) -> None:
        """Have somebody see its trials and decide on them."""
        attendance.describe(self.exoskeleton, self.pointed)
        self._attendance = attendance

    @property
    def connected(self) -> bool:
        """Whether trials can be executed now, inside the ``with`` block."""
        return self._connected

    def connect(self) -> None:
        """Take hold of the hardware."""
        self._connected = True

    def release(self) -> None:
        """Let go of every actuator, each being tried, then raise the first error met; harmless when not connected."""
        self._connected = False

    @abstractmethod
    def run(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        """Execute a checked trial while connected; `execute` is what callers use."""

    def check(self, trial: Trial) -> None:
        """Check a trial before anything moves.

        Raises
        ------
        ValueError
            When the trial does not fit the rig, saying what it has, or asks for what its limits forbid.
        """
        for name, values, columns, what in (
            ("pressure_command_kpa", trial.pressure_command_kpa, len(self.muscles), "muscles"),
            ("reference_rad", trial.reference_rad, len(self.joints), "joints"),
        ):
            if values is not None and values.shape != (self.samples, columns):
                raise ValueError(
                    f"{name}: this rig takes {self.samples} samples of {columns} {what}, got shape {values.shape}"
                )
        if (trial.kind == "passive") != (trial.participant == "nobody"):
            raise ValueError(
                f"participant '{trial.participant}' in a {trial.kind} trial: 'nobody' goes with passive, and only there"
            )
        if trial.kind != "passive" and trial.participant not in self.people:
            raise ValueError(f"no participant '{trial.participant}'; this rig knows {', '.join(sorted(self.people))}")

    def check_bank(self, samples: pd.DataFrame, by: str) -> None:
        """Check movements that are to be replayed against the rig's limits, if it has any, before anything moves.

        Rows are of one muscle and time: muscle, time_s, pressure_command_kpa, joint_angle_rad of its joint, and a
        column that numbers the movements.

        Raises
        ------
        ValueError
            Saying which movement passes which limit.
        """

    def execute(self, trial: Trial, generator: np.random.Generator, watch: Watch | None = None) -> Recording:
        """Execute one trial of this rig's shape; the generator is the only source of randomness.

        Rows of samples are handed to `watch` while the trial runs, but by a rig that knows them only at the end.

        Raises
        ------
        RigError
            When the rig is not connected; `TrialStopped` when it stopped the trial.
        ValueError
            As `check`. After any exception but the next ones the actuators are released.
        TrialDeclined, StudyPaused
            When who attends does not let it become part of the study.
        """
        if not self.connected:
            raise RigError(f"{type(self).__name__} is not connected; write: with rig: rig.execute(trial, generator)")
        try:
            self.check(trial)
            return self._attend(trial, generator, watch)
        except TrialDeclined:
            raise
        except BaseException as error:
            _release_after(self, error)
            raise

    def _attend(self, trial: Trial, generator: np.random.Generator, watch: Watch | None) -> Recording:
        attendance = self.attendance
        attendance.propose(trial)
        try:
            recording = self.run(trial, generator, watch)
        except BaseException as error:
            told = str(error) or type(error).__name__
            if isinstance(error, TrialStopped) and attendance.why_stop():
                attendance.judge(trial, None, told)
            else:
                attendance.tell(told)
            raise
        attendance.judge(trial, recording, "")
        return attendance.add_display(recording)

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException as error:
            _release_after(self, error)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.release()
        else:
            _release_after(self, error)


def tidy(recording: Recording, rig: Rig) -> dict[str, NDArray[Any]]:
    """Return a recording as the columns of `RECORDING_COLUMNS` (M T,), in order, joint columns by the muscle's joint.

    There is a row per muscle and time: all of the first muscle, then the next.
    """
    names = np.array(rig.muscles, dtype=object)
    columns: dict[str, NDArray[Any]] = {}
    for name in RECORDING_COLUMNS:
        if name == "muscle":
            columns[name] = np.repeat(names, len(recording.time_s))
        elif name in PER_SAMPLE:
            columns[name] = np.tile(getattr(recording, name), len(names))
        else:
            values = getattr(recording, name)
            values = values[:, rig.exoskeleton.joint_of_muscle] if name.startswith("joint") else values
            columns[name] = values.T.ravel().astype(object if name in ("status", "clipped_by") else float)
    return columns


MEASUREMENT_COLUMNS: dict[str, Column] = {
    "time_s": column(float, "time from the trial's start; below 0 in the lead-in", "s", -LONGEST_LEAD_IN_S, 3600.0),
    "muscle": column(str, "name of the muscle"),
    "pressure_command_kpa": column(
        float, "commanded gauge pressure as applied, held until the next sample", "kPa", 0.0, 1000.0
    ),
    "pressure_kpa": column(float, "gauge pressure at the valve", "kPa", -50.0, 1100.0),
    "contraction": column(float, "contraction by encoder and geometry, ratio of rest length", "1", -0.2, 0.5),
    "contraction_velocity_per_s": column(float, "filtered derivative of contraction", "1/s", -20.0, 20.0),
    "force_n": column(float, "tension at the load cell", "N", 0.0, 10000.0),
    "joint_angle_rad": column(float, "angle of the muscle's joint", "rad", -6.3, 6.3),
    "joint_velocity_rad_per_s": column(float, "filtered derivative of the joint's angle", "rad/s", -100.0, 100.0),
}
"""What was measured in each sample; a table adds its own keys, such as the trial."""

_SHOWN = (
    "when a screen showed the reference of this sample, from the trial's start; missing where none did",
    "when a screen first showed a posture measured at time_s or later; missing where none did",
)
RECORDING_COLUMNS: dict[str, Column] = {
    **MEASUREMENT_COLUMNS,
    "status": column(str, "what the sample is: ok, or what is wrong with it", among=STATUS),
    "clipped_by": column(str, "what made the command differ from the one asked; empty = nothing did", among=CLIPPED_BY),
    "late_s": column(float, "how much later than at time_s the sample was taken", "s", -1.0, 3600.0),
    "reference_shown_s": column(float, _SHOWN[0], "s", -60.0, 3600.0, nullable=True),
    "measured_shown_s": column(float, _SHOWN[1], "s", -60.0, 3600.0, nullable=True),
}
"""What a rig records of each sample: what was measured, and how."""


def _release_after(rig: Rig, error: BaseException) -> None:
    try:
        rig.release()
    except Exception as second:
        error.add_note(f"then releasing the rig failed too: {second}")
