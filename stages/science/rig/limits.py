"""Limits: what may be commanded, what a reference may ask of a joint, and what ends a trial.

A command flows in; the command that may be applied flows out, with what made it differ, and is what a recording holds.
References flow in before anything moves, samples while it does; what forbids them flows out in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.exoskeleton import Exoskeleton, Muscle
from stages.science.rig.trial import CLIPPED_BY
from stages.science.signals.trajectories import Array

CODES = list(CLIPPED_BY)
PRESSURE, CO_CONTRACTION, RATE = (CODES.index(name) for name in ("pressure", "co_contraction", "rate"))
ROUNDING_KPA = 1e-9
"""Difference of two commands that is no clipping, kPa."""


SPEED_WINDOW_S = 0.03
"""Time over which a joint's speed is measured against its limit, s: above an encoder's counts, below a movement."""


class PressureLimit(Declared):
    """What one type of muscle may be commanded."""

    low_kpa: float = Field(ge=0.0, description="lowest command, kPa gauge")
    high_kpa: PositiveFloat = Field(description="highest command, kPa gauge")
    slew_kpa_per_s: PositiveFloat = Field(description="largest rate of change, kPa/s")

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.low_kpa >= self.high_kpa:
            raise ValueError(f"expected low_kpa < high_kpa, got {self.low_kpa} and {self.high_kpa}")
        return self


Limits = dict[str, PressureLimit]


class JointLimit(Declared):
    """What one joint may do."""

    lower_rad: float = Field(ge=-6.3, le=6.3, description="smallest angle, rad")
    upper_rad: float = Field(ge=-6.3, le=6.3, description="largest angle, rad")
    speed_rad_per_s: PositiveFloat = Field(description="largest speed, rad/s")

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.lower_rad >= self.upper_rad:
            raise ValueError(f"expected lower_rad < upper_rad, got {self.lower_rad} and {self.upper_rad}")
        return self


class Ceiling(Declared):
    """What is measured at one type of muscle and ends a trial where it is exceeded."""

    pressure_kpa: PositiveFloat = Field(description="largest measured pressure, kPa gauge")
    force_n: PositiveFloat = Field(description="largest measured tension, N")


class Guard(Declared):
    """What ends a trial, and how the muscles are let down then."""

    ceilings: dict[str, Ceiling] = Field(description="by type of muscle")
    joints: dict[str, JointLimit] = Field(description="by name of joint")
    ramp_down_s: float = Field(ge=0.02, le=10.0, description="time in which the muscles are let down, s")
    vented_kpa: PositiveFloat = Field(description="measured pressure below which a muscle is down, kPa gauge")
    vented_within_s: PositiveFloat = Field(description="time after which a muscle that is not down is told, s")
    follow_kpa: PositiveFloat | None = Field(description="how far pressure may be from commands, kPa; null = any")
    follow_s: PositiveFloat = Field(description="time for which commands count, and for which it may be off, s")
    missed_share: float = Field(ge=0.0, le=1.0, description="share of a trial's samples that may be missed, 1")
    borne_samples: int = Field(ge=0, description="samples in a row that a sensor may fail before the trial ends")
    frozen_s: PositiveFloat = Field(description="time without any change that ends it: pressure and force, s")
    frozen_encoder_s: PositiveFloat = Field(description="the same of an encoder, in a trial with a person, s")

    def check_against(self, exoskeleton: Exoskeleton, limits: Limits) -> None:
        """Check that everything has its limit, and that no command reaches a ceiling.

        Raises
        ------
        ValueError
            Naming the key.
        """
        for kind, wanted, given in (
            ("ceilings", {each.type: each.name for each in exoskeleton.muscles}, self.ceilings),
            ("joints", {name: name for name in exoskeleton.joint_names}, self.joints),
        ):
            for name in wanted:
                if name not in given:
                    raise ValueError(f"guard.{kind}: none for {name}; add guard.{kind}.{name}")
        for muscle in exoskeleton.muscles:
            if self.ceilings[muscle.type].pressure_kpa <= limits[muscle.type].high_kpa:
                raise ValueError(
                    f"guard.ceilings.{muscle.type}.pressure_kpa: expected more than the {limits[muscle.type].high_kpa} "
                    f"kPa that may be commanded (limits.{muscle.type}.high_kpa), "
                    f"got {self.ceilings[muscle.type].pressure_kpa}"
                )


def check_limits(limits: Limits, muscles: Sequence[Muscle]) -> None:
    """Check that every muscle has limits within what its data sheet permits.

    Raises
    ------
    ValueError
        Naming the muscle.
    """
    for muscle in muscles:
        if muscle.type not in limits:
            raise ValueError(
                f"limits: none for type {muscle.type} of muscle {muscle.name}; {nearest(muscle.type, limits)}"
            )
        if limits[muscle.type].high_kpa > muscle.max_pressure_kpa:
            raise ValueError(
                f"limits: {muscle.type} may be commanded {limits[muscle.type].high_kpa} kPa, "
                f"but muscle {muscle.name} is permitted {muscle.max_pressure_kpa} kPa "
                f"(max_pressure_kpa); lower high_kpa of {muscle.type}"
            )


def apply_limits(
    command_kpa: Array,
    limits: Limits,
    exoskeleton: Exoskeleton,
    co_contraction_kpa: Mapping[str, float] | None = None,
) -> tuple[Array, NDArray[Any]]:
    """Return the nearest command within the limits, sample after sample.

    Parameters
    ----------
    command_kpa : (T, M) ndarray
        What is asked, kPa gauge; the muscles are filled to the first sample beforehand.
    limits : mapping of str to PressureLimit
        By type of muscle.
    exoskeleton : Exoskeleton
        The machine.
    co_contraction_kpa : mapping of str to float or None
        By joint: as long as one side of it is commanded more than this, the other one is not; None for no ceiling.

    Returns
    -------
    tuple of (T, M) ndarray
        What is applied, kPa gauge, and what made it differ, keys of `CLIPPED_BY`.
    """
    rows = [limits[muscle.type] for muscle in exoskeleton.muscles]
    step = np.array([row.slew_kpa_per_s for row in rows]) / exoskeleton.sampling_rate_hz
    low, high = np.array([row.low_kpa for row in rows]), np.array([row.high_kpa for row in rows])
    side = np.array([1 if muscle.role == "agonist" else -1 for muscle in exoskeleton.muscles])
    ceilings = co_contraction_kpa or {}
    ceiling = np.array([ceilings.get(name, np.inf) for name in exoskeleton.joint_names])
    applied, codes = _limit(
        np.ascontiguousarray(command_kpa, dtype=float),
        low,
        high,
        step,
        np.array(exoskeleton.joint_of_muscle),
        side,
        ceiling,
    )
    return applied, np.array(CODES)[codes]


@njit(cache=True)
def _limit(
    wanted: Array,
    low: Array,
    high: Array,
    step: Array,
    joint: NDArray[np.int64],
    side: NDArray[np.int64],
    ceiling: Array,
) -> tuple[Array, NDArray[np.int64]]:
    applied, codes = wanted.copy(), np.zeros(wanted.shape, dtype=np.int64)
    count = wanted.shape[1]
    before = np.full(count, np.nan)
    for k in range(wanted.shape[0]):
        for m in range(count):
            value = min(max(wanted[k, m], low[m]), high[m])
            if abs(value - wanted[k, m]) > ROUNDING_KPA:
                codes[k, m] = PRESSURE
            if not np.isnan(before[m]):
                slow = min(max(value, before[m] - step[m]), before[m] + step[m])
                if abs(slow - value) > ROUNDING_KPA:
                    codes[k, m] = RATE
                value = slow
            applied[k, m] = value
        for j in range(ceiling.shape[0]):
            most, was = np.full(2, -np.inf), np.full(2, -np.inf)
            for m in range(count):
                if joint[m] == j:
                    s = (side[m] + 1) // 2
                    most[s] = max(most[s], applied[k, m])
                    was[s] = max(was[s], applied[k, m] if np.isnan(before[m]) else before[m])
            if min(most[0], most[1]) <= ceiling[j]:
                continue
            held = 0 if was[0] < was[1] else 1  # the side that was lower stays below, which no rate forbids
            for m in range(count):
                if joint[m] == j and (side[m] + 1) // 2 == held and applied[k, m] > ceiling[j]:
                    applied[k, m] = ceiling[j]
                    codes[k, m] = CO_CONTRACTION
        before = applied[k].copy()
    return applied, codes


def find_forbidden(
    samples: pd.DataFrame, trials: str, exoskeleton: Exoskeleton, guard: Guard, limits: Limits
) -> Iterator[str]:
    """Say what a bank asks for that the limits forbid, before anything moves.

    Parameters
    ----------
    samples : DataFrame
        Rows of movements that are to be replayed, each muscle's in the order of time: muscle, time_s,
        pressure_command_kpa and joint_angle_rad (of the muscle's joint).
    trials : str
        Column that numbers the movements.
    exoskeleton : Exoskeleton
        The machine.
    guard : Guard
        Limits of the joints.
    limits : mapping of str to PressureLimit
        By type of muscle.

    Yields
    ------
    str
        One line for each limit that is passed: where it is passed first, by how much, and in how many movements.
    """
    for muscle in exoskeleton.muscles:
        rows = samples[samples["muscle"] == muscle.name]
        allowed, joint = limits[muscle.type], guard.joints[muscle.joint]
        angle, speed = rows["joint_angle_rad"], _measure_speed(rows, trials, exoskeleton.sampling_rate_hz)
        command = rows["pressure_command_kpa"]
        wrong = {
            f"joint {muscle.joint} at {{:.3g}} rad, permitted {joint.lower_rad} to {joint.upper_rad}": (
                angle, ~angle.between(joint.lower_rad, joint.upper_rad)
            ),
            f"joint {muscle.joint} at {{:.3g}} rad/s, permitted {joint.speed_rad_per_s}": (
                speed, speed > joint.speed_rad_per_s
            ),
            f"muscle {muscle.name} at {{:.4g}} kPa, permitted {allowed.low_kpa} to {allowed.high_kpa}": (
                command, ~command.between(allowed.low_kpa - ROUNDING_KPA, allowed.high_kpa + ROUNDING_KPA)
            ),
        }  # fmt: skip
        for words, (values, beyond) in wrong.items():
            if beyond.any():
                first = rows[beyond].iloc[0]
                found = rows.loc[beyond, trials].nunique()
                yield (
                    f"{trials} {first[trials]} asks for {words.format(values[beyond].iloc[0])}, at "
                    f"{first['time_s']:.2f} s ({found} of {rows[trials].nunique()} ask for such)"
                )


def _measure_speed(rows: pd.DataFrame, trials: str, sampling_rate_hz: float) -> pd.Series:
    """Return the mean speed over the last `SPEED_WINDOW_S`, rad/s; nothing at the beginning."""
    steps = speed_samples(sampling_rate_hz)
    changes = rows.groupby(trials)[["joint_angle_rad", "time_s"]].diff(steps)
    speed: pd.Series = (changes["joint_angle_rad"] / changes["time_s"]).abs()
    return speed


def speed_samples(sampling_rate_hz: float) -> int:
    """Return the samples over which a speed is measured."""
    return max(round(SPEED_WINDOW_S * sampling_rate_hz), 1)
