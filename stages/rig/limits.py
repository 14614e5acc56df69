"""Limits on what is commanded: a pressure range and a largest rate of change, by type of muscle.

A command flows in; the command that may be applied flows out, and is what a recording holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np
from numba import njit
from pydantic import Field, PositiveFloat, model_validator

from stages.plant.declaration import Declared, nearest
from stages.plant.exoskeleton import Muscle
from stages.signals.trajectories import Array


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


def apply_limits(command_kpa: Array, limits: Limits, muscles: Sequence[Muscle], sampling_rate_hz: float) -> Array:
    """Return the nearest command within the limits, sample after sample.

    Parameters
    ----------
    command_kpa : (T, M) ndarray
        What is asked, kPa gauge; the muscles are filled to the first sample before the trial.
    limits : mapping of str to PressureLimit
        By type of muscle.
    muscles : sequence of Muscle
        The M muscles.
    sampling_rate_hz : float
        Samples per second.

    Returns
    -------
    (T, M) ndarray
        What is applied, kPa gauge.
    """
    rows = [limits[muscle.type] for muscle in muscles]
    applied = np.clip(command_kpa, [row.low_kpa for row in rows], [row.high_kpa for row in rows])
    step = np.array([row.slew_kpa_per_s for row in rows]) / sampling_rate_hz
    limited: Array = _limit_slew(applied, step)
    return limited


@njit(cache=True)
def _limit_slew(wanted: Array, step: Array) -> Array:
    applied = wanted.copy()
    for k in range(1, applied.shape[0]):
        for m in range(applied.shape[1]):
            before = applied[k - 1, m]
            applied[k, m] = min(max(applied[k, m], before - step[m]), before + step[m])
    return applied
