"""A measured-like table: forces at a grid of pressures and contractions, as a test bench gives them.

Isobaric stretches of a blend of the other laws, with a bench's irregularities of a few tenths of a per cent, drawn per
session, are joined by shape-preserving cubic pieces in both directions (Fritsch, F. N. & Carlson, R. E. (1980),
"Monotone piecewise cubic interpolation", SIAM Journal on Numerical Analysis 17, 238-246). Outside the grid the law goes
on straight.

Flows in: pressure, kPa, and contraction, (4, ...). Flows out: tension, N, (4, ...).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import PchipInterpolator

from stages.benchmark.blinded_rig.laws.exponential import build_exponential
from stages.benchmark.blinded_rig.laws.sheet import full_force_n, vary
from stages.benchmark.blinded_rig.laws.virtual_work import build_virtual_work
from stages.benchmark.blinded_rig.machine import FULL_PRESSURE_KPA, Array

PRESSURES_KPA = np.linspace(0.0, 700.0, 15)
CONTRACTIONS = np.linspace(-0.04, 0.28, 17)


@dataclass(frozen=True)
class Table:
    """Forces, N, (4, pressures, contractions), and their slopes per step of the grid in each direction and in both."""

    force_n: Array
    by_pressure: Array
    by_contraction: Array
    by_both: Array

    def tension(self, pressure_kpa: Array, contraction: Array) -> Array:
        """Tension, N, (4, ...)."""
        pressure, stroke = np.broadcast_arrays(pressure_kpa, contraction)
        rows = (pressure - PRESSURES_KPA[0]) / (PRESSURES_KPA[1] - PRESSURES_KPA[0])
        columns = (stroke - CONTRACTIONS[0]) / (CONTRACTIONS[1] - CONTRACTIONS[0])
        flat = (rows.reshape(len(self.force_n), -1), columns.reshape(len(self.force_n), -1))
        tables = (self.force_n, self.by_pressure, self.by_contraction, self.by_both)
        return interpolate(*tables, *flat).reshape(pressure.shape)


@njit(cache=True)
def interpolate(table: Array, dx: Array, dy: Array, dxy: Array, x: Array, y: Array) -> Array:
    """Bicubic Hermite pieces of (muscles, rows, columns) at (muscles, samples), in steps of the grid."""
    out = np.empty_like(x)
    last_row, last_column = table.shape[1] - 1, table.shape[2] - 1
    for m in range(x.shape[0]):
        for i in range(x.shape[1]):
            across, along = min(max(x[m, i], 0.0), last_row), min(max(y[m, i], 0.0), last_column)
            r, c = min(int(across), last_row - 1), min(int(along), last_column - 1)
            u, v = across - r, along - c
            total, slope_x, slope_y = 0.0, 0.0, 0.0
            for a in range(2):
                value_u, slope_u, bent_u, turned_u = hermite(u, a)
                for b in range(2):
                    value_v, slope_v, bent_v, turned_v = hermite(v, b)
                    f, fx, fy, fxy = (
                        table[m, r + a, c + b], dx[m, r + a, c + b], dy[m, r + a, c + b], dxy[m, r + a, c + b],
                    )  # fmt: skip
                    by_v, by_v_x = f * value_v + fy * slope_v, fx * value_v + fxy * slope_v
                    total += value_u * by_v + slope_u * by_v_x
                    slope_x += bent_u * by_v + turned_u * by_v_x
                    slope_y += value_u * (f * bent_v + fy * turned_v) + slope_u * (fx * bent_v + fxy * turned_v)
            out[m, i] = total + slope_x * (x[m, i] - across) + slope_y * (y[m, i] - along)
    return out


@njit(cache=True)
def hermite(u: float, end: int) -> tuple[float, float, float, float]:
    """Weights of an end's value and slope at ``u`` of [0, 1], and the derivatives of both."""
    if end == 0:
        return (
            (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * (1.0 - u) ** 2, 6.0 * u * (u - 1.0), (1.0 - u) * (1.0 - 3.0 * u),
        )  # fmt: skip
    return u * u * (3.0 - 2.0 * u), u * u * (u - 1.0), 6.0 * u * (1.0 - u), u * (3.0 * u - 2.0)


def tabulate_forces(force_n: Array) -> Table:
    """Shape-preserving slopes of forces (4, pressures, contractions), N."""

    def slopes(values: Array, axis: int) -> Array:
        return PchipInterpolator(np.arange(values.shape[axis]), values, axis=axis).derivative()(
            np.arange(values.shape[axis])
        )

    # the derivative keeps the interpolated axis in its place
    across, along = slopes(force_n, 1), slopes(force_n, 2)
    return Table(force_n, across, along, slopes(along, 1))


def build_table(rng: np.random.Generator) -> Table:
    """Draw one session's table: a blend of two laws, and irregularities of the bench."""
    shape = (4, PRESSURES_KPA.size, CONTRACTIONS.size)
    pressure = np.broadcast_to(PRESSURES_KPA[:, None], shape)
    stroke = np.broadcast_to(CONTRACTIONS, shape)
    share = np.clip(vary(rng, 0.5, 0.3), 0.2, 0.8)[:, None, None]
    blend = share * build_exponential(rng).tension(pressure, stroke)
    blend = blend + (1.0 - share) * build_virtual_work(rng).tension(pressure, stroke)
    loaded = 0.15 + 0.85 * PRESSURES_KPA[:, None] / FULL_PRESSURE_KPA
    uneven = vary(rng, 0.005, 0.2)[:, None, None] * loaded * rng.standard_normal(shape)
    by_row = vary(rng, 0.003, 0.2)[:, None, None] * rng.standard_normal((4, PRESSURES_KPA.size, 1))
    return tabulate_forces(blend + full_force_n()[:, None, None] * (uneven + by_row))
