"""Movements of a bank that are bent: smooth changes of a reference and of pressure commands, within what the bank asks.

The bank's references flow in, and changes as coefficients of B-splines; a bent reference and commands flow out, which
no angle, speed, pressure or rate takes beyond those of the bank.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
import pandas as pd
from numba import njit

from stages.science.signals.trajectories import Array

DEGREE = 3
"""Of the splines: cubic ones, whose acceleration has no jumps."""
DIGITS = 6
"""Significant digits of coefficients, which are told in words."""

Changes = Mapping[str, Array]
"""Coefficients (K,) by joint, rad, and by muscle, kPa; what is not in it keeps its own."""


@dataclass(frozen=True)
class Bounds:
    """What the movements of a bank ask of a joint, rad, or of a muscle, kPa: lowest, highest, and fastest a sample."""

    low: float
    high: float
    step: float

    @property
    def span(self) -> float:
        """Range, in the same unit."""
        return self.high - self.low


@dataclass(frozen=True)
class Bending:
    """How movements of a bank may be bent: bounds by joint and by muscle, the joint of each muscle, and T samples.

    A joint's speed is measured over `speed_samples`.
    """

    bounds: Mapping[str, Bounds]
    joints: Mapping[str, str]
    samples: int
    speed_samples: int

    @classmethod
    def read(cls, references: pd.DataFrame, joints: Mapping[str, str], samples: int, speed_samples: int) -> Self:
        """Take bounds from the rows of all movements, as a trial replays them.

        Their columns are trajectory, muscle, pressure_command_kpa, and joint_angle_rad of the muscle's joint.
        """
        bounds = {}
        for muscle, joint in joints.items():
            rows = references[references["muscle"] == muscle]
            for name, column, lag in ((joint, "joint_angle_rad", speed_samples), (muscle, "pressure_command_kpa", 1)):
                steps = rows.groupby("trajectory", sort=False)[column].diff(lag).abs() / lag
                bounds[name] = Bounds(float(rows[column].min()), float(rows[column].max()), float(steps.max()))
        return cls(bounds, joints, samples, speed_samples)

    def bend_angle(self, joint: str, angle_rad: Array, change: Array) -> Array:
        """Return a joint's reference (T,), rad, with as much of a change (K,), rad, as stays within its bounds."""
        bound, added = self.bounds[joint], self._add_up(change)
        lag, rounding = self.speed_samples, 1e-12
        limits = [
            (angle_rad, added, min(bound.low, angle_rad.min()), max(bound.high, angle_rad.max())),
            (angle_rad[lag:] - angle_rad[:-lag], added[lag:] - added[:-lag], -bound.step * lag, bound.step * lag),
        ]
        share = 1.0
        for own, more, low, high in limits:
            room = np.where(more > 0.0, high - own, own - low)
            moved = np.abs(more) > rounding
            share = min(share, float(np.min(np.maximum(room[moved], 0.0) / np.abs(more[moved]), initial=1.0)))
        return np.asarray(angle_rad + share * added)

    def bend_command(self, muscle: str, command_kpa: Array, change: Array) -> Array:
        """Return a muscle's command (T,), kPa, changed by a change (K,), kPa, and kept within its bounds."""
        bound = self.bounds[muscle]
        wanted = np.clip(command_kpa + self._add_up(change), bound.low, bound.high)
        return np.asarray(_limit_steps(wanted, bound.step))

    def bend(self, rows: pd.DataFrame, changes: Changes) -> pd.DataFrame:
        """Return a movement's rows, in the order of time by muscle, with its references and commands bent."""
        bent = rows.copy()
        for muscle, joint in self.joints.items():
            its = (rows["muscle"] == muscle).to_numpy()
            if joint in changes:
                angle = rows.loc[its, "joint_angle_rad"].to_numpy()
                bent.loc[its, "joint_angle_rad"] = self.bend_angle(joint, angle, changes[joint])
            if muscle in changes:
                command = rows.loc[its, "pressure_command_kpa"].to_numpy()
                bent.loc[its, "pressure_command_kpa"] = self.bend_command(muscle, command, changes[muscle])
        return bent

    def _add_up(self, change: Array) -> Array:
        return _make_splines(self.samples, change.size) @ change


@lru_cache(maxsize=4)
def _make_splines(samples: int, coefficients: int) -> Array:
    """Return cubic B-splines on even knots over a trial, (T, K)."""
    from scipy.interpolate import BSpline  # slow to import, and most commands bend nothing

    inner = np.linspace(0.0, 1.0, coefficients - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    return np.asarray(BSpline.design_matrix(np.linspace(0.0, 1.0, samples), knots, DEGREE).toarray())


def round_coefficients(change: Array) -> Array:
    """Return coefficients as `describe_changes` tells them."""
    return np.array([float(f"{each:.{DIGITS}g}") for each in change])


def describe_changes(changes: Changes) -> str:
    """Return changes as ``SFE 0.1 0 -0.2 0.05, pam1 12 0 0 -30``."""
    return ", ".join(f"{name} {' '.join(f'{each:.{DIGITS}g}' for each in change)}" for name, change in changes.items())


def read_changes(described: str) -> dict[str, Array]:
    """Return the changes that `describe_changes` wrote."""
    parts: Sequence[list[str]] = [each.split(" ") for each in described.split(", ") if each]
    return {name: np.array([float(each) for each in change]) for name, *change in parts}


@njit(cache=True)
def _limit_steps(wanted: Array, step: float) -> Array:
    limited = wanted.copy()
    for k in range(1, len(wanted)):
        limited[k] = min(max(wanted[k], limited[k - 1] - step), limited[k - 1] + step)
    return limited
