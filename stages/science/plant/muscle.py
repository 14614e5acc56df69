"""The static law of a pneumatic muscle, with linear damping, and the constants it takes.

Pressure, contraction and its velocity flow in; tension comes out. The law is linear in pressure and quadratic in
contraction, beside a part that does not depend on pressure.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from stages.science.signals.trajectories import Array


class MuscleConstants(NamedTuple):
    """Constants of K muscles, (K,) arrays, as compiled code takes them.

    `area_n_per_kpa` is the nominal area; `area_factor` makes it the effective one. `full_force_n`, of which effects
    have their share, is that of the nominal area, without `area_factor`, at the largest pressure and rest length, but
    of the braid's own angle: beside another angle the same share is another force.
    """

    area_n_per_kpa: Array
    braid_a: Array
    braid_b: Array
    contraction_factor: Array
    passive_linear_n: Array
    passive_quadratic_n: Array
    damping_n_s: Array
    valve_tau_s: Array
    contraction_at_angle_0: Array
    contraction_per_rad: Array
    torque_arm_m: Array
    full_force_n: Array
    area_factor: Array
    regulator_gain: Array
    regulator_offset_kpa: Array
    force_offset_n: Array


def braid_coefficients(angle_deg: float) -> tuple[float, float]:
    """Return a = 3 / tan^2 and b = 1 / sin^2 of the braid angle (Chou and Hannaford 1996)."""
    angle = np.deg2rad(angle_deg)
    return float(3.0 / np.tan(angle) ** 2), float(1.0 / np.sin(angle) ** 2)


def pull_at_rest(pressure_kpa: Array, muscles: MuscleConstants) -> Array:
    """Return the force, N, that pressures (T, K), kPa, would give at rest length; none below zero."""
    per_kpa = muscles.area_n_per_kpa * muscles.area_factor * (muscles.braid_a - muscles.braid_b)
    return per_kpa * np.maximum(pressure_kpa, 0.0)


@njit(cache=True, error_model="numpy")
def pull(pressure: float, contraction: float, velocity: float, muscles: MuscleConstants, m: int) -> float:
    """Return the tension of muscle `m`, N; never negative.

    Chou and Hannaford, Measurement and modeling of McKibben pneumatic artificial muscles, IEEE Trans. Robot. Autom. 12
    (1996): F = P pi r^2 (a (1 - C)^2 - b). The factor on C accounts for tapering ends (Tondu and Lopez, IEEE Control
    Syst. Mag. 20, 2000); the part without pressure is the rubber tube's.
    """
    area = muscles.area_n_per_kpa[m] * muscles.area_factor[m]
    shape = 1.0 - muscles.contraction_factor[m] * contraction
    active = pressure * area * (muscles.braid_a[m] * shape * shape - muscles.braid_b[m])
    rubber = contraction * (muscles.passive_linear_n[m] + muscles.passive_quadratic_n[m] * contraction)
    return max(active - (rubber + muscles.damping_n_s[m] * velocity), 0.0)


@njit(cache=True, error_model="numpy")
def _pull_columns(pressure: Array, contraction: Array, velocity: Array, muscles: MuscleConstants) -> Array:
    tension = np.empty_like(pressure)
    for k in range(pressure.shape[0]):
        for m in range(pressure.shape[1]):
            tension[k, m] = pull(pressure[k, m], contraction[k, m], velocity[k, m], muscles, m)
    return tension


def compute_tension(pressure_kpa: Array, contraction: Array, velocity_per_s: Array, muscles: MuscleConstants) -> Array:
    """Return the tension (T, K), N, of each muscle by the static law with linear damping; a slack one pulls with zero.

    Of pressures in the muscle, kPa gauge, contractions, ratios of rest length, positive when shorter, and their rates,
    1/s, (T, K) each.
    """
    pressure, contraction, velocity = (
        np.ascontiguousarray(each, dtype=float) for each in (pressure_kpa, contraction, velocity_per_s)
    )
    return _pull_columns(pressure, contraction, velocity, muscles)
