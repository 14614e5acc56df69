"""What is wrong with a sample while a trial runs.

Counts and values flow in, sample after sample; out flow a status for each muscle and, where the trial has to end, why.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.science.rig.festo.channels import ChannelMap, CountRange
from stages.science.rig.limits import Ceiling, Guard, speed_samples
from stages.science.signals.trajectories import Array

AWAKE = 0.02
"""Share of its ceiling from which on a pressure or tension that stands still is taken for frozen: below, a vented
regulator and a slack muscle do stand still."""


@dataclass(frozen=True)
class Sample:
    """One sample of all sensors (M,) and (J,), with their last values where they told nothing.

    Velocities are means over the last `SPEED_WINDOW_S`; the status (M,) is of keys of `STATUS`; the breach is why the
    trial has to end, empty where it goes on.
    """

    pressure_kpa: Array
    force_n: Array
    joint_angle_rad: Array
    joint_velocity_rad_per_s: Array
    status: NDArray[np.str_]
    breach: str


class Supervisor:
    """Looks at one sample after the other; where somebody moves, encoders do not stand still."""

    def __init__(self, channels: ChannelMap, counts: CountRange, guard: Guard, moved: bool):
        self.channels, self.counts, self.guard = channels, counts, guard
        self.exoskeleton = exoskeleton = channels.exoskeleton
        rate = exoskeleton.sampling_rate_hz
        muscles, joints = len(exoskeleton.muscles), len(exoskeleton.joints)
        still = [guard.frozen_s] * (2 * muscles) + [guard.frozen_encoder_s if moved else np.inf] * joints
        self._longest_still = np.array(still) * rate
        self._still = np.zeros(2 * muscles + joints)
        self._failing = np.zeros(2 * muscles + joints, dtype=int)
        self._before: Array | None = None
        self._told: Array | None = None
        self._commands: deque[Array] = deque(maxlen=max(round(guard.follow_s * rate), 2))
        self._stray = np.zeros(muscles, dtype=int)
        self._angles: deque[tuple[float, Array]] = deque(maxlen=speed_samples(rate) + 1)
        self._ceilings = [guard.ceilings[muscle.type] for muscle in exoskeleton.muscles]
        largest = [each.pressure_kpa for each in self._ceilings] + [each.force_n for each in self._ceilings]
        self._awake = AWAKE * np.array(largest)

    def look(self, counts: Array, command_kpa: Array, at_s: float) -> Sample:
        """Judge the counts (2 M + J,) of all inputs under commands (M,), kPa gauge, at a time of any clock, s."""
        muscles = len(self.exoskeleton.muscles)
        none, ended = self.counts.sort_out(counts[: 2 * muscles])
        lost = np.concatenate([none | ended, np.zeros(len(counts) - 2 * muscles, dtype=bool)])
        told = counts if self._told is None else np.where(lost, self._told, counts)
        self._told = told
        pressure, force, angle = self.channels.to_values(told)
        self._angles.append((at_s, angle))
        frozen = self._find_frozen(counts, np.concatenate([pressure, force]))
        self._failing = np.where(lost, self._failing + 1, 0)
        speed = self._measure_speed()
        over = self._find_over(pressure, force, angle, speed)
        strays = self._find_stray(pressure, command_kpa)
        still = _either(frozen[: 2 * muscles]) | frozen[2 * muscles :][list(self.exoskeleton.joint_of_muscle)]
        beyond = np.isin(np.arange(muscles), [*over, *strays])
        words = ["invalid", "saturated", "frozen", "over"]
        status = np.select([_either(none), _either(ended), still, beyond], words, "ok")
        return Sample(pressure, force, angle, speed, status, self._find_breach(none, counts, frozen, over or strays))

    def _find_frozen(self, counts: Array, values: Array) -> NDArray[np.bool_]:
        same = np.zeros(len(counts), dtype=bool) if self._before is None else counts == self._before
        self._before = counts
        awake = np.concatenate([values > self._awake, np.ones(len(counts) - len(values), dtype=bool)])
        self._still = np.where(same & awake, self._still + 1, 0)
        return np.asarray(self._still >= self._longest_still)

    def _measure_speed(self) -> Array:
        (begun_s, first), (ended_s, last) = self._angles[0], self._angles[-1]
        due_s = (len(self._angles) - 1) / self.exoskeleton.sampling_rate_hz
        if due_s == 0.0:
            return np.zeros(len(last))
        return (last - first) / max(ended_s - begun_s, due_s)  # a sample may be read before its time is taken

    def _find_stray(self, pressure: Array, command_kpa: Array) -> dict[int, str]:
        """Return the muscles whose pressure has not followed the commands for too long."""
        self._commands.append(command_kpa)
        if self.guard.follow_kpa is None:
            return {}
        lowest, highest = np.min(self._commands, axis=0), np.max(self._commands, axis=0)
        off = (pressure < lowest - self.guard.follow_kpa) | (pressure > highest + self.guard.follow_kpa)
        self._stray = np.where(off, self._stray + 1, 0)
        return {
            int(m): f"{self.exoskeleton.muscles[m].name} at {pressure[m]:.0f} kPa while {command_kpa[m]:.0f} kPa are "
            f"commanded, for {self.guard.follow_s} s (rig.guard.follow_kpa; null for a run without air)"
            for m in np.flatnonzero(self._stray >= (self._commands.maxlen or 0))
        }

    def _find_over(self, pressure: Array, force: Array, angle: Array, speed: Array) -> dict[int, str]:
        """Return what passes which limit, by muscle."""
        found: dict[int, str] = {}
        for m, (muscle, ceiling) in enumerate(zip(self.exoskeleton.muscles, self._ceilings, strict=True)):
            j = self.exoskeleton.joint_of_muscle[m]
            joint = self.guard.joints[muscle.joint]
            words = ""
            if pressure[m] > ceiling.pressure_kpa:
                words = f"{muscle.name} at {pressure[m]:.0f} kPa, ceiling {ceiling.pressure_kpa} kPa"
            elif force[m] > ceiling.force_n:
                words = f"{muscle.name} at {force[m]:.0f} N, ceiling {ceiling.force_n} N"
            elif not joint.lower_rad <= angle[j] <= joint.upper_rad:
                words = f"{muscle.joint} at {angle[j]:.3f} rad, limits {joint.lower_rad} and {joint.upper_rad} rad"
            elif abs(speed[j]) > joint.speed_rad_per_s:
                words = f"{muscle.joint} at {abs(speed[j]):.1f} rad/s, limit {joint.speed_rad_per_s} rad/s"
            if words:
                found[m] = words
        return found

    def _find_breach(
        self, none: NDArray[np.bool_], counts: Array, frozen: NDArray[np.bool_], over: dict[int, str]
    ) -> str:
        if over:
            return next(iter(over.values()))
        failing = np.flatnonzero(self._failing > self.guard.borne_samples)
        if failing.size:
            first = int(failing[0])
            if none[first]:
                return f"{self.channels.names[first]} tells no value (count {counts[first]:.0f})"
            ends = f"{self.counts.low} to {self.counts.high}"
            return f"{self.channels.names[first]} is at its end (count {counts[first]:.0f}, range {ends})"
        if frozen.any():
            first = int(np.argmax(frozen))
            lasted_s = self._still[first] / self.exoskeleton.sampling_rate_hz
            key = "frozen_s" if first < 2 * len(self._ceilings) else "frozen_encoder_s"
            name, count = self.channels.names[first], counts[first]
            return f"{name} has not changed for {lasted_s:.2f} s (count {count:.0f}; rig.guard.{key})"
        return ""


def _either(amiss: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return at which muscles the pressure sensor or the load cell is amiss."""
    pressure, force = np.split(amiss, 2)
    return pressure | force


def judge_held(channels: ChannelMap, valid: CountRange, ceilings: Sequence[Ceiling], muscle: int, counts: Array) -> str:
    """Return why a held muscle is let down at once; a channel of another one at its end says nothing about it."""
    pressure, force, _ = channels.to_values(counts)
    values, analogue = np.concatenate([pressure, force]), counts[: 2 * len(ceilings)]
    largest = np.array([each.pressure_kpa for each in ceilings] + [each.force_n for each in ceilings])
    told = ~np.logical_or(*valid.sort_out(analogue))
    over = np.flatnonzero(told & (values > largest))
    if over.size:
        first = int(over[0])
        unit = "kPa" if first < len(ceilings) else "N"
        return f"{channels.names[first]} at {values[first]:.0f} {unit}, ceiling {largest[first]} {unit}"
    return "" if told[muscle] else f"{channels.names[muscle]} cannot tell the pressure (count {analogue[muscle]:.0f})"
