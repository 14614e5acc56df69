"""A mass that is driven: on a spring with a damper, or free; the plant of records from machines that move.

Inputs on a fine grid flow in, with constants and the terms that named effects add; the output at the sampling instants
flows out. Lengths are told in a scale of the output and time in a pace, for a spring one radian of the natural motion,
so that one effect has the same bounds on every machine: with x the output over its scale, without its offset, w its
velocity in scales per pace, and f the drive, x' = w and w' = f - hold x - damping w + terms, where a spring holds 1.
All terms are always compiled; those at zero are absent.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from stages.science.plant.filters import lag, read
from stages.science.signals.operators import follow_play
from stages.science.signals.trajectories import Array

Between = Literal["band_limited", "linear", "held", "averaged"]
SITE = "motion"
BENT = 12.0
"""Straight lines through points of a bent curve lie beside it by its second difference over this, on average."""
WIDE = 8
"""Columns that are advanced together: as many numbers as one instruction takes, where there are such instructions."""
TABLE = (
    *("cubic", "quadratic", "hysteretic", "damping", "drag", "coulomb", "sliding", "turning", "stiction", "yielding"),
    *("rise", "falling", "stop", "stop_above", "stop_below", "swing"),
)
"""Rows of the table of constants that the integrator reads."""
COULOMB = TABLE.index("coulomb")
SINE = (-1.0 / 39916800.0, 1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0)
"""Of the series of a sine over its angle, the last of ten powers first."""
DIVISORS = tuple(1.0 / count for count in range(10, 0, -1))
"""Of the series of an exponential."""
FURTHEST = 1e3
"""Scales beyond which the motion is cut: a soft spring may let go, and a fit has to go on with finite numbers."""


class MotionTerms(NamedTuple):
    """What effects add, over the force that brings one scale in a squared pace; without a value given, nothing."""

    cubic: float = 0.0
    quadratic: float = 0.0
    coulomb: float = 0.0
    sliding: float = 1.0
    rise: float = 0.0
    falling: float = 1.0
    stiction: float = 0.0
    yielding: float = 1.0
    drag: float = 0.0
    stop: float = 0.0
    stop_above: float = math.inf
    stop_below: float = -math.inf
    swing: float = 0.0
    damping: float = 0.0
    hysteretic: float = 0.0
    turning: float = 1.0
    delay: float = 0.0
    drive_cut: float = 0.0
    drive_play: float = 0.0
    drive_lag: float = 0.0
    sensor_offset: float = 0.0
    folded: float = 0.0
    unread: float = 0.0
    lowest: float = -math.inf
    highest: float = math.inf


@njit(cache=True, error_model="numpy")
def turn(value: float) -> float:
    """Return tanh to 1e-14, by operations that several columns share an instruction for."""
    part = -min(abs(value), 20.0) / 32.0
    series = 1.0
    for divisor in DIVISORS:
        series = 1.0 + part * divisor * series
    for _ in range(6):
        series *= series
    return math.copysign((1.0 - series) / (1.0 + series), value)


@njit(cache=True, error_model="numpy", forceinline=True)  # a call would keep columns from sharing instructions
def _find_rates(
    x: float, w: float, z: float, drive: float, hold: float, constants: tuple[float, ...], rubs: bool
) -> tuple[float, float]:
    cubic, quadratic, hysteretic, damping, drag, coulomb, per_sliding, per_turning, rise, per_falling = constants[:10]
    stop, above, below, swing = constants[10:]
    turned = min(swing * x * x, math.pi**2)  # upright, a pendulum has no torque
    bent = 0.0  # sin(y) / y - 1, to 2e-5 there
    for factor in SINE:
        bent = turned * (factor + bent)
    dw = drive - stop * (max(x - above, 0.0) + min(x - below, 0.0))
    dw -= x * (hold + hold * bent + x * (quadratic + cubic * x)) + hysteretic * z + w * (damping + drag * abs(w))
    if rubs:
        quick = w * per_falling
        dw -= coulomb * turn(w * per_sliding) * (1.0 + rise / (1.0 + quick * quick))
    return dw, w * per_turning * (1.0 - (z * z if w * z > 0.0 else 0.0))


@njit(cache=True, error_model="numpy")
def _advance(
    state: Array, drive: Array, hold: Array, table: Array, h: float, first: int, lanes: int, rubs: bool
) -> None:
    """Advance columns by a step of the classical rule; drive and hold are told at its beginning, middle and end.

    States and constants lie one after the other, `WIDE` numbers each, and the count of columns is told at run time:
    so that a compiler finds that it may take several at once.
    """
    drive1, drive2, drive4 = drive[first], drive[first + 1], drive[first + 2]
    hold1, hold2, hold4 = hold[first], hold[first + 1], hold[first + 2]
    for k in range(lanes):
        x, w, z, s = state[k], state[WIDE + k], state[2 * WIDE + k], state[3 * WIDE + k]
        constants = (
            table[k],
            table[WIDE + k],
            table[2 * WIDE + k],
            table[3 * WIDE + k],
            table[4 * WIDE + k],
            table[5 * WIDE + k],
            table[6 * WIDE + k],
            table[7 * WIDE + k],
            table[10 * WIDE + k],
            table[11 * WIDE + k],
            table[12 * WIDE + k],
            table[13 * WIDE + k],
            table[14 * WIDE + k],
            table[15 * WIDE + k],
        )
        stuck = table[8 * WIDE + k] * s
        dw1, dz1 = _find_rates(x, w, z, drive1[k] - stuck, hold1[k], constants, rubs)
        w2, z2 = w + 0.5 * h * dw1, z + 0.5 * h * dz1
        dw2, dz2 = _find_rates(x + 0.5 * h * w, w2, z2, drive2[k] - stuck, hold2[k], constants, rubs)
        w3, z3 = w + 0.5 * h * dw2, z + 0.5 * h * dz2
        dw3, dz3 = _find_rates(x + 0.5 * h * w2, w3, z3, drive2[k] - stuck, hold2[k], constants, rubs)
        w4, z4 = w + h * dw3, z + h * dz3
        dw4, dz4 = _find_rates(x + h * w3, w4, z4, drive4[k] - stuck, hold4[k], constants, rubs)
        moved = min(max(x + h / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4), -FURTHEST), FURTHEST)
        state[k] = moved
        state[WIDE + k] = min(max(w + h / 6.0 * (dw1 + 2.0 * dw2 + 2.0 * dw3 + dw4), -FURTHEST), FURTHEST)
        state[2 * WIDE + k] = min(max(z + h / 6.0 * (dz1 + 2.0 * dz2 + 2.0 * dz3 + dz4), -1.0), 1.0)
        state[3 * WIDE + k] = min(max(s + (moved - x) * table[9 * WIDE + k], -1.0), 1.0)


@njit(cache=True, error_model="numpy")
def _look(rows: Array, column: int, first: int, share: float, cut: float, into: Array, k: int) -> None:
    """Fill a column with instants of a row from one on, each a share on the way to the next, within a limit."""
    count = into.shape[0]
    last = rows.shape[1] - 1
    if first >= 0 and first + count <= last:
        for m in range(count):
            value = rows[column, first + m]
            into[m, k] = min(max(value + share * (rows[column, first + m + 1] - value), -cut), cut)
        return
    for m in range(count):
        left = min(max(first + m, 0), last)
        right = min(max(first + m + 1, 0), last)
        value = rows[column, left]
        into[m, k] = min(max(value + share * (rows[column, right] - value), -cut), cut)


@njit(cache=True, error_model="numpy", nogil=True)
def _integrate(
    drive: Array, hold: Array, start: Array, table: Array, limit: Array, late: Array, h: float, substeps: int
) -> Array:
    fine = 2 * substeps
    columns, last = drive.shape[0], drive.shape[1] - 1
    samples = last // fine + 1
    motion = np.empty((samples, columns))
    varies = hold.shape[1] > 1
    for first in range(0, columns, WIDE):
        width = min(columns - first, WIDE)
        lanes = 1 if width == 1 else (4 if width <= 4 else WIDE)
        state, constants = np.zeros(4 * WIDE), np.zeros(len(table) * WIDE)
        drives, holds = np.zeros((fine + 1, WIDE)), np.zeros((fine + 1, WIDE))
        rubs = False
        for k in range(width):
            column = first + k
            state[k], state[WIDE + k] = start[0, column], start[1, column]
            for place in range(len(table)):
                constants[place * WIDE + k] = table[place, column]
            rubs = rubs or table[COULOMB, column] != 0.0
            for m in range(fine + 1):
                holds[m, k] = hold[column, 0]
            motion[0, column] = state[k]
        for sample in range(1, samples):
            at = (sample - 1) * fine
            for k in range(width):
                column = first + k
                shift = math.floor(-late[column])
                _look(drive, column, at + int(shift), -late[column] - shift, limit[column], drives, k)
                if varies:
                    _look(hold, column, at + int(shift), -late[column] - shift, np.inf, holds, k)
            for i in range(substeps):
                _advance(state, drives, holds, constants, h, 2 * i, lanes, rubs)
            for k in range(width):
                motion[sample, first + k] = state[k]
    return motion


def _follow(drive: Array, lags: Array, begun: Array, step: float, held: bool) -> Array:
    """Return drives (K, M) behind lags, (K,) steps being in the unit of these, from how they begin, (K,)."""
    followed, since = drive.copy(), step * np.arange(drive.shape[1])
    for k in np.flatnonzero(lags):
        fading = (begun[k] - drive[k, 0]) * np.exp(-since / lags[k])
        followed[k] = lag(drive[k][:, None], lags[k], step, held)[:, 0] + fading
    return followed


def integrate(
    drive: Array,
    hold: Array,
    start: Array,
    damping: Array,
    terms: Sequence[MotionTerms],
    pace: float,
    substeps: int,
    late: Array,
    offset: Array | float = 0.0,
    held: bool = False,
) -> Array:
    """Return motions at the sampling instants, (T, K), in scales, as the sensor of the terms shows them.

    A column's motion is the same, bit for bit, whatever columns lie beside it.

    Parameters
    ----------
    drive, hold : (K, (T - 1) * 2 * substeps + 1) ndarray
        Acceleration that the inputs bring, scales per squared pace, and the spring's hold, per squared pace, or (K, 1).
    start, damping : (2, K), (K,) ndarray
        Place and velocity, scales and scales per pace; damping per pace.
    terms : sequence of MotionTerms
        Of all effects together, for each column.
    pace, substeps : float, int
        Time between samples over the pace; steps of the classical Runge-Kutta rule in it, whose error is some 1e-5 with
        a fifth of a pace each.
    late, offset : (K,) ndarray
        By which drive and hold act, samples, maybe negative; what the sensor adds after all, scales: its ends are
        readings with it, and motions are told without.
    held : bool
        Whether a drive that lags is one that stays from instant to instant.
    """
    told = {name: np.array([getattr(each, name) for each in terms]) for name in MotionTerms._fields}
    h = pace / substeps
    told["damping"] = damping + told["damping"]
    largest = told["coulomb"] * (1.0 + told["rise"])
    told["sliding"] = np.maximum(told["sliding"], 0.5 * largest * h)  # a step cannot turn more sharply
    inverted = ("sliding", "turning", "yielding", "falling")
    table = np.stack([1.0 / told[name] if name in inverted else told[name] for name in TABLE])
    limit = np.array([1.0 / cut if cut > 0.0 else np.inf for cut in told["drive_cut"]])
    late = (told["delay"] * 2.0 * np.pi / pace + late) * (2 * substeps)
    if told["drive_play"].any():
        played = zip(drive, told["drive_play"], strict=True)
        drive = np.stack([follow_play(each[:, None], width)[:, 0] for each, width in played])
    if told["drive_lag"].any():  # what lags is unknown at first: the motion is taken to begin in balance
        balance = hold[:, 0] * start[0] + told["damping"] * start[1]
        drive = _follow(drive, told["drive_lag"], balance, 0.5 * h, held)
        if hold.shape[1] > 1:
            hold = _follow(hold, told["drive_lag"], hold[:, 0], 0.5 * h, held)
    drive, hold, start = (np.ascontiguousarray(each) for each in (drive, hold, start))
    moved = _integrate(drive, hold, start, table, limit, late, h, substeps) + told["sensor_offset"]
    if told["folded"].any():
        moved = moved + 2.0 * told["folded"] * np.maximum(-(moved + offset), 0.0)
    ends = (told[name] - offset for name in ("lowest", "highest"))
    return read(moved, told["unread"], *ends)


def refine(signal: Array, substeps: int, between: Between) -> Array:
    """Return an input (T, ...) at the instants that the integrator looks at, ((T - 1) * 2 * substeps + 1, ...).

    Between samples it follows the smooth curve through them that holds no frequency above half the sampling rate, or a
    straight line, or stays; or samples are means over a period each, which straight lines are to keep.
    """
    from scipy.signal import resample_poly

    fine = 2 * substeps
    places = np.arange((len(signal) - 1) * fine + 1)
    if between == "held":
        return signal[places // fine]
    if between == "band_limited":
        return resample_poly(signal, fine, 1, axis=0, window=("kaiser", 8.0), padtype="line")[: len(places)]
    if between == "averaged" and len(signal) > 2:
        signal = signal.copy()
        signal[1:-1] -= np.diff(signal, 2, axis=0) / BENT
    left = np.minimum(places // fine, len(signal) - 2)
    share = (places / fine - left).reshape(-1, *[1] * (signal.ndim - 1))
    return signal[left] + share * (signal[left + 1] - signal[left])
