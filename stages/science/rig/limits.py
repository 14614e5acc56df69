"""Limits: what may be commanded, what a reference may ask of a joint, and what ends a trial.

A command flows in; the command that may be applied flows out, with what made it differ, and is what a recording holds.
References flow in before anything moves, samples while it does; what forbids them flows out in words.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

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


def ordered(low: str, high: str, strictly: bool = True) -> Any:
    """Return the validator of a section in which one value lies below another one, or is no higher than it."""

    def check(section: Declared) -> Declared:
        lowest, highest = getattr(section, low), getattr(section, high)
        if lowest > highest or (strictly and lowest == highest):
            raise ValueError(f"expected {low} {'<' if strictly else '<='} {high}, got {lowest} and {highest}")
        return section

    return model_validator(mode="after")(check)


class PressureLimit(Declared):
    """What one type of muscle may be commanded."""

    low_kpa: float = Field(ge=0.0, description="lowest command, kPa gauge")
    high_kpa: PositiveFloat = Field(description="highest command, kPa gauge")
    slew_kpa_per_s: PositiveFloat = Field(description="largest rate of change, kPa/s")

    _order = ordered("low_kpa", "high_kpa")


Limits = dict[str, PressureLimit]


class JointLimit(Declared):
    """What one joint may do."""

    lower_rad: float = Field(ge=-6.3, le=6.3, description="smallest angle, rad")
    upper_rad: float = Field(ge=-6.3, le=6.3, description="largest angle, rad")
    speed_rad_per_s: PositiveFloat = Field(description="largest speed, rad/s")

    _order = ordered("lower_rad", "upper_rad")


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
        """Check that everything has its limit, and that no command reaches a ceiling; a `ValueError` names the key."""
        wanted = {"ceilings": [muscle.type for muscle in exoskeleton.muscles], "joints": exoskeleton.joint_names}
        for kind, names in wanted.items():
            for name in names:
                if name not in getattr(self, kind):
                    raise ValueError(f"guard.{kind}: none for {name}; add guard.{kind}.{name}")
        for muscle in exoskeleton.muscles:
            ceiling_kpa, high_kpa = self.ceilings[muscle.type].pressure_kpa, limits[muscle.type].high_kpa
            if ceiling_kpa <= high_kpa:
                raise ValueError(
                    f"guard.ceilings.{muscle.type}.pressure_kpa: expected more than the {high_kpa} kPa that may be "
                    f"commanded (limits.{muscle.type}.high_kpa), got {ceiling_kpa}"
                )


def check_limits(limits: Limits, muscles: Sequence[Muscle]) -> None:
    """Check that every muscle has limits within what its data sheet permits; a `ValueError` names the muscle."""
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
    """Return the nearest command within the limits, sample after sample, and what made it differ (T, M).

    Commands are in kPa gauge, the muscles being filled to the first sample beforehand; what made them differ is told by
    keys of `CLIPPED_BY`. As long as one side of a joint is commanded more than its ceiling on co-contraction, the other
    one is not; None for no ceiling.
    """
    rows = [limits[muscle.type] for muscle in exoskeleton.muscles]
    low, high, slew = np.array([(row.low_kpa, row.high_kpa, row.slew_kpa_per_s) for row in rows]).T.copy()
    side = np.array([1 if muscle.role == "agonist" else -1 for muscle in exoskeleton.muscles])
    ceiling = np.array([(co_contraction_kpa or {}).get(name, np.inf) for name in exoskeleton.joint_names])
    step, joint = slew / exoskeleton.sampling_rate_hz, np.array(exoskeleton.joint_of_muscle)
    wanted = np.ascontiguousarray(command_kpa, dtype=float)
    applied, codes = _limit(wanted, low, high, step, joint, side, ceiling)
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
    """Say what a bank asks for that a rig's limits forbid, before anything moves; arguments as of `Rig.check_bank`.

    There is one line for each limit that is passed: where it is passed first, by how much, and in how many movements.
    """
    for muscle in exoskeleton.muscles:
        rows = samples[samples["muscle"] == muscle.name]
        allowed, joint = limits[muscle.type], guard.joints[muscle.joint]
        changes = rows.groupby(trials)[["joint_angle_rad", "time_s"]].diff(speed_samples(exoskeleton.sampling_rate_hz))
        angle, speed = rows["joint_angle_rad"], (changes["joint_angle_rad"] / changes["time_s"]).abs()
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


def speed_samples(sampling_rate_hz: float) -> int:
    """Return the samples over which a speed is measured."""
    return max(round(SPEED_WINDOW_S * sampling_rate_hz), 1)
