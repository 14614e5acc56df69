"""The true machine: four muscles on two joints, and what the data sheet says of them.

Flows in: a generator. Flows out: ``Machine``, the true constants (one value per muscle); ``DATA_SHEET`` is what a user
is told. True constants differ mildly from the data sheet's and from muscle to muscle. Muscle arrays are (4,) in the
order of ``MUSCLES``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MUSCLES = ("pam1", "pam2", "pam3", "pam4")
JOINTS = ("SFE", "EFE")
VALVE_TAU_S = 0.04
BRAID_ANGLE_DEG = 25.0
CONTRACTION_FACTOR = 1.08
FULL_PRESSURE_KPA = 600.0
PASCAL_PER_KPA = 1000.0


@dataclass(frozen=True)
class MuscleSheet:
    """One muscle as its data sheet and the drawing of the exoskeleton describe it."""

    joint: str
    role: str
    type: str
    rest_length_m: float
    nominal_diameter_m: float
    moment_arm_m: float
    contraction_at_angle_0: float
    sign: int
    damping_n_s: float


DATA_SHEET = {
    "pam1": MuscleSheet("SFE", "agonist", "MAS-40", 0.32, 0.04, 0.042, 0.02, 1, 90.0),
    "pam2": MuscleSheet("SFE", "antagonist", "MAS-10", 0.30, 0.01, 0.036, 0.19, -1, 7.5),
    "pam3": MuscleSheet("EFE", "agonist", "MAS-40", 0.30, 0.04, 0.036, 0.015, 1, 90.0),
    "pam4": MuscleSheet("EFE", "antagonist", "MAS-10", 0.28, 0.01, 0.032, 0.185, -1, 7.5),
}


def sheet_column(name: str) -> Array:
    """One property of all muscles, (4,), from the data sheet."""
    return np.array([getattr(DATA_SHEET[muscle], name) for muscle in MUSCLES], dtype=np.float64)


JOINT_OF_MUSCLE = np.array([JOINTS.index(DATA_SHEET[muscle].joint) for muscle in MUSCLES])


class StaticLaw(Protocol):
    """What a muscle pulls at rest, other than the ideal braid's law."""

    def tension(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Tension, N, at pressures, kPa, and contractions, (4, ...)."""


@dataclass(frozen=True)
class Machine:
    """True constants, (4,) each; a ``law``, where there is one, replaces the ideal braid's.

    ``passive_share`` is (4, 4): the sleeve's cubic in contraction over full force; ``hand``, of -1 and 1, is the way in
    which an effect that could go either way goes.
    """

    diameter_m: Array
    braid_rad: Array
    contraction_factor: Array
    damping_n_s: Array
    passive_share: Array
    arm_error: Array
    zero_error: Array
    valve_tau_s: Array
    regulator_gain: Array
    regulator_offset_kpa: Array
    pressure_gain: Array
    pressure_zero_kpa: Array
    force_gain: Array
    force_zero_share: Array
    pressure_filter_hz: Array
    force_filter_hz: Array
    hand: Array
    law: StaticLaw | None = None

    @property
    def full_force_n(self) -> Array:
        """Tension at rest length and 600 kPa, N, (4,)."""
        return self.static_force(np.full(4, FULL_PRESSURE_KPA), np.zeros(4))

    def contraction(self, travel_rad: Array) -> Array:
        """Return the true contraction (4, ...) for the angle (4, ...) that each muscle's cable has travelled, rad."""
        slope = arm_over_length()
        zero = sheet_column("contraction_at_angle_0") + self.zero_error
        return column(zero, travel_rad) + column(slope * (1.0 + self.arm_error), travel_rad) * travel_rad

    def static_force(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Braid's tension (virtual work), or the law's in its place, N, of the shape of its arguments (4, ...)."""
        if self.law is not None:
            return self.law.tension(pressure_kpa, contraction)
        area = column(0.25 * np.pi * self.diameter_m**2, contraction)
        angle = column(self.braid_rad, contraction)
        length = (1.0 - column(self.contraction_factor, contraction) * contraction) ** 2
        return PASCAL_PER_KPA * pressure_kpa * area * (3.0 * length * np.cos(angle) ** 2 - 1.0) / np.sin(angle) ** 2

    def passive_force(self, contraction: Array) -> Array:
        """Return what the sleeve and tube add whatever the pressure, N."""
        share = sum(column(self.passive_share[:, k], contraction) * (contraction / 0.1) ** k for k in range(4))
        return column(self.full_force_n, contraction) * share


def arm_over_length() -> Array:
    """Signed contraction per radian by the drawing, (4,)."""
    return sheet_column("sign") * sheet_column("moment_arm_m") / sheet_column("rest_length_m")


def column(values: Array, like: Array) -> Array:
    """One value per muscle (4,), shaped to broadcast against ``like`` (4, ...)."""
    return values.reshape((-1,) + (1,) * (like.ndim - 1))


def build_machine(rng: np.random.Generator, varied: bool = True) -> Machine:
    """Build one session's machine; ``varied=False``: the data sheet's own, ideal sensors, from the same draws."""
    scale = 1.0 if varied else 0.0

    def vary(spread: float, size: int | tuple[int, int] = 4) -> Array:
        return scale * spread * np.clip(rng.standard_normal(size), -2.0, 2.0)

    ideal_hz = np.full(4, np.inf)
    filters_hz = 400.0 * np.exp(np.clip(0.05 * rng.standard_normal((2, 4)), -0.1, 0.1))
    return Machine(
        diameter_m=sheet_column("nominal_diameter_m") * (1.0 + vary(0.008)),
        braid_rad=np.deg2rad(BRAID_ANGLE_DEG + vary(0.25)),
        contraction_factor=CONTRACTION_FACTOR * (1.0 + vary(0.01)),
        damping_n_s=sheet_column("damping_n_s") * (1.0 + vary(0.15)),
        passive_share=vary(1.0, (4, 4)) * np.array([3e-4, 3e-4, 2e-4, 2e-5]),
        arm_error=vary(0.01),
        zero_error=vary(0.0015),
        valve_tau_s=VALVE_TAU_S * (1.0 + vary(0.06)),
        regulator_gain=1.0 + vary(0.008),
        regulator_offset_kpa=vary(0.6),
        pressure_gain=1.0 + vary(0.008),
        pressure_zero_kpa=vary(0.4),
        force_gain=1.0 + vary(0.01),
        force_zero_share=vary(0.0005),
        pressure_filter_hz=filters_hz[0] if varied else ideal_hz,
        force_filter_hz=filters_hz[1] if varied else ideal_hz,
        hand=rng.choice([-1.0, 1.0], 4),
    )
