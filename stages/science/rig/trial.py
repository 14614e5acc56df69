"""A trial, and the recording of what was applied and measured in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from stages.science.signals.trajectories import Array

STATUS = {
    "ok": "as measured",
    "missed": "the loop came too late: values of the sample before",
    "late": "taken more than a period late",
    "frozen": "the sensor's value had not changed for too long",
    "invalid": "the device told no value: the last one that it told",
    "saturated": "at the end of the sensor's range",
    "over": "beyond a limit, or a pressure that does not follow its command",
    "ramp": "measured while the muscles were let down after a stop",
}
"""What a sample may be, and what that means."""

CLIPPED_BY = {
    "": "nothing: as asked",
    "pressure": "the muscle's lowest or highest command",
    "co_contraction": "the ceiling on muscles that pull against each other",
    "rate": "the largest rate of change",
    "ramp": "the way to the first command or down after a stop",
}
"""What may make the command that is applied differ from the one that was asked."""

PER_SAMPLE = ("time_s", "late_s", "reference_shown_s", "measured_shown_s")
"""What a recording holds once for all muscles and joints."""


@dataclass(frozen=True)
class Proposal:
    """Why a trial is proposed, for whoever decides on it: which of how many it is, from 1, and the reason in words."""

    position: int
    total: int
    reason: str = ""
    trajectory: int | None = None
    """Movement of the bank, where it is one."""
    utilities: Mapping[int, float] = field(default_factory=dict)
    """By movement of the bank: how much each one tells, where that was asked."""
    utility_unit: str = ""
    """Of these; empty where it is unknown."""
    errors: tuple[float, ...] = ()
    """Of the trials learned from so far: error rate of the models' prediction before."""
    can_skip: bool = False
    """Whether another movement can take its place now."""
    can_reject: bool = False
    """Whether enough are left without it."""


@dataclass(frozen=True)
class Manner:
    """How free movements differ from natural ones: range, and durations of reaches and rests, over natural ones."""

    range_ratio: float
    duration_ratio: float
    rest_ratio: float


NATURAL = Manner(1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial to execute.

    Parameters
    ----------
    kind : str
        ``free`` (the experimenter moves as they like), ``tracked`` (a participant follows the reference) or ``passive``
        (nobody moves).
    participant : str
        Who is in the machine; ``nobody`` in a passive trial.
    pressure_command_kpa : (T, M) ndarray
        Commanded pressures, kPa gauge, each held until the next sample.
    reference_rad : (T, J) ndarray or None
        Joint angles to follow, rad; only in a tracked trial.
    label : str
        Names the trial for an operator.
    number : int or None
        Which of its study's trials of this kind it is, from 0; None where nothing counts them.
    proposal : Proposal or None
        Why it is proposed; None where nobody is asked.
    manner : Manner
        How the experimenter moves in a free trial; a person is told in words, by the proposal.
    """

    kind: Literal["free", "tracked", "passive"]
    participant: str
    pressure_command_kpa: Array
    reference_rad: Array | None = None
    label: str = ""
    number: int | None = None
    proposal: Proposal | None = None
    manner: Manner = NATURAL

    def __post_init__(self) -> None:
        if self.kind not in ("free", "tracked", "passive"):
            raise ValueError(f"trial kind: expected free, tracked or passive, got '{self.kind}'")
        if (self.kind == "tracked") != (self.reference_rad is not None):
            raise ValueError(f"a {self.kind} trial takes {'a' if self.kind == 'tracked' else 'no'} reference_rad")
        command = _as_matrix("pressure_command_kpa", self.pressure_command_kpa)
        object.__setattr__(self, "pressure_command_kpa", command)
        if self.reference_rad is not None:
            reference = _as_matrix("reference_rad", self.reference_rad)
            object.__setattr__(self, "reference_rad", reference)
            if len(reference) != len(command):
                raise ValueError(f"reference_rad has {len(reference)} samples, pressure_command_kpa {len(command)}")


@dataclass(frozen=True, eq=False)
class Recording:
    """What was applied and measured in one trial, T samples of M muscles and J joints, and before it.

    Samples of the lead-in, in which muscles are filled, come first and count in T; a machine need not tell them.

    Parameters
    ----------
    time_s : (T,) ndarray
        From the trial's start, below 0 in the lead-in.
    pressure_command_kpa : (T, M) ndarray
        As applied, after limits, kPa gauge.
    pressure_kpa, contraction, contraction_velocity_per_s, force_n : (T, M) ndarray
        Sensors; contraction and its velocity follow from the encoders and the nominal geometry.
    joint_angle_rad, joint_velocity_rad_per_s : (T, J) ndarray
        Encoders, and their filtered derivative.
    status : (T, M) ndarray of str
        What each sample is, a key of `STATUS`; ``ok`` throughout if not given.
    clipped_by : (T, M) ndarray of str
        What made the command differ from the one asked, a key of `CLIPPED_BY`; empty throughout if not given.
    late_s : (T,) ndarray
        How much later than at ``time_s`` the sample was taken, s; 0 throughout if not given.
    reference_shown_s, measured_shown_s : (T,) ndarray
        When a screen showed the reference of this sample, and the first measured posture not older than it, s from
        the trial's start; nan where none did, and throughout if not given.
    """

    time_s: Array
    pressure_command_kpa: Array
    pressure_kpa: Array
    contraction: Array
    contraction_velocity_per_s: Array
    force_n: Array
    joint_angle_rad: Array
    joint_velocity_rad_per_s: Array
    status: NDArray[Any] = field(default_factory=lambda: np.array("ok"))
    clipped_by: NDArray[Any] = field(default_factory=lambda: np.array(""))
    late_s: Array = field(default_factory=lambda: np.array(0.0))
    reference_shown_s: Array = field(default_factory=lambda: np.array(np.nan))
    measured_shown_s: Array = field(default_factory=lambda: np.array(np.nan))

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            like = self.joint_angle_rad if each.name.startswith("joint") else self.pressure_command_kpa
            expected = self.time_s.shape if each.name in PER_SAMPLE else (len(self.time_s), like.shape[-1])
            if value.ndim == 0:
                object.__setattr__(self, each.name, np.full(expected, value))
            elif value.shape != expected:
                raise ValueError(f"recording: expected {each.name} of shape {expected}, got {value.shape}")

    @property
    def lead(self) -> int:
        """Samples of the lead-in."""
        return int(np.searchsorted(self.time_s, 0.0))

    def cut(self, part: slice) -> Self:
        """Return some of its samples."""
        return type(self)(**{each.name: getattr(self, each.name)[part] for each in fields(self)})

    def without_lead_in(self) -> Self:
        """Return the trial alone."""
        return self.cut(slice(self.lead, None))


def _as_matrix(name: str, values: Array) -> Array:
    matrix = np.ascontiguousarray(values, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] < 2:
        raise ValueError(f"{name}: expected a matrix of samples by columns, got shape {np.shape(values)}")
    if not np.isfinite(matrix).all():
        row = int(np.argmin(np.isfinite(matrix).all(axis=1)))
        raise ValueError(f"{name}: expected finite numbers, got {matrix[row]} at sample {row}")
    return matrix
