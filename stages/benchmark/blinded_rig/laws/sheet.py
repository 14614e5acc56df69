"""What every law is matched to: the data sheet's full force.

Flows in: a generator. Flows out: full forces of a session's muscles, N, (4,), and small variations of constants.
"""

import numpy as np

from stages.benchmark.blinded_rig.machine import BRAID_ANGLE_DEG, FULL_PRESSURE_KPA, PASCAL_PER_KPA, Array, sheet_column


def full_force_n() -> Array:
    """Tension at rest length and 600 kPa by the data sheet, N, (4,)."""
    angle = np.deg2rad(BRAID_ANGLE_DEG)
    area = 0.25 * np.pi * sheet_column("nominal_diameter_m") ** 2
    return PASCAL_PER_KPA * FULL_PRESSURE_KPA * area * (3.0 * np.cos(angle) ** 2 - 1.0) / np.sin(angle) ** 2


def vary(rng: np.random.Generator, value: float, share: float) -> Array:
    """One value per muscle, (4,), within two standard deviations of ``share``."""
    return value * (1.0 + share * np.clip(rng.standard_normal(4), -2.0, 2.0))
