"""A mass that is driven: on a spring with a damper, or free; the plant of records from machines that move.

Inputs on a fine grid flow in, with constants and the terms that named effects add; the output at the sampling instants
flows out. Lengths are told in a scale of the output and time in a pace, for a spring one radian of the natural motion,
so that one effect has the same bounds on every machine: with x the output over its scale, without its offset, w its
velocity in scales per pace, and f the drive, x' = w and w' = f - hold x - damping w + terms, where a spring holds 1.
All terms are always compiled; those at zero are absent.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from stages.signals.trajectories import Array

Between = Literal["band_limited", "linear", "held", "averaged"]
SITE = "motion"
BENT = 12.0
"""Straight lines through points of a bent curve lie beside it by its second difference over this, on average."""
FURTHEST = 1e3
"""Scales beyond which the motion is cut: a soft spring may let go, and a fit has to go on with finite numbers."""


class MotionTerms(NamedTuple):
    """What effects add, over the force that brings one scale in a squared pace; without a value given, nothing."""

    cubic: float = 0.0
    quadratic: float = 0.0
    coulomb: float = 0.0
    sliding: float = 1.0
    stiction: float = 0.0
    yielding: float = 1.0
    drag: float = 0.0
    damping: float = 0.0
    hysteretic: float = 0.0
    turning: float = 1.0
    delay: float = 0.0
    drive_cut: float = 0.0
    sensor_cut: float = 0.0
    sensor_offset: float = 0.0


@njit(cache=True, error_model="numpy")
def _drive_at(drive: Array, place: float) -> float:
    last = drive.shape[0] - 1
    if place <= 0.0:
        return drive[0]
    if place >= last:
        return drive[last]
    left = int(place)
    share = place - left
    return drive[left] if share == 0.0 else drive[left] + share * (drive[left + 1] - drive[left])


@njit(cache=True, error_model="numpy")
def _cut(value: float, share: float) -> float:
    return value if share <= 0.0 else min(max(value, -1.0 / share), 1.0 / share)


@njit(cache=True, error_model="numpy")
def _pull(x: float, w: float, z: float, hold: float, damping: float, sliding: float, terms: MotionTerms) -> float:
    spring = x * (hold + x * (terms.quadratic + terms.cubic * x)) + terms.hysteretic * z
    force = spring + w * (damping + terms.damping)
    if terms.coulomb != 0.0:
        force += terms.coulomb * math.tanh(w / sliding)
    return force + terms.drag * w * abs(w)


@njit(cache=True, error_model="numpy", nogil=True)
def _integrate(
    drive: Array, hold: Array, start: Array, damping: float, late: float, terms: MotionTerms, pace: float, substeps: int
) -> Array:
    fine = 2 * substeps
    samples = (drive.shape[0] - 1) // fine + 1
    motion = np.empty((samples, drive.shape[1]))
    h = pace / substeps
    late = (terms.delay * 2.0 * math.pi / pace + late) * fine
    varies = hold.shape[0] > 1
    sliding = max(terms.sliding, 0.5 * terms.coulomb * h)  # a step cannot turn more sharply
    for k in range(drive.shape[1]):
        x, w, z, s = start[0, k], start[1, k], 0.0, 0.0
        motion[0, k] = _cut(x, terms.sensor_cut)
        for i in range((samples - 1) * substeps):
            sum_x, sum_w, sum_z = 0.0, 0.0, 0.0
            dx, dw, dz = 0.0, 0.0, 0.0
            before = x
            for stage in range(4):
                reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                at = 2 * i + (stage + 1) // 2
                f = drive[at, k] if late == 0.0 else _drive_at(drive[:, k], at - late)
                x_now, w_now, z_now = x + reach * dx, w + reach * dw, z + reach * dz
                dx = w_now
                stiff = hold[at, k] if varies else hold[0, 0]
                dw = (
                    _cut(f, terms.drive_cut)
                    - _pull(x_now, w_now, z_now, stiff, damping, sliding, terms)
                    - terms.stiction * s
                )
                dz = w_now / terms.turning * (1.0 - (z_now * z_now if w_now * z_now > 0.0 else 0.0))
                sum_x += weight * dx
                sum_w += weight * dw
                sum_z += weight * dz
            x = min(max(x + h / 6.0 * sum_x, -FURTHEST), FURTHEST)
            w = min(max(w + h / 6.0 * sum_w, -FURTHEST), FURTHEST)
            z = min(max(z + h / 6.0 * sum_z, -1.0), 1.0)
            s = min(max(s + (x - before) / terms.yielding, -1.0), 1.0)
            if (i + 1) % substeps == 0:
                motion[(i + 1) // substeps, k] = _cut(x, terms.sensor_cut)
    return motion


def integrate(
    drive: Array,
    hold: Array,
    start: Array,
    damping: float,
    terms: MotionTerms,
    pace: float,
    substeps: int,
    late: float = 0.0,
) -> Array:
    """Return a motion at the sampling instants, (T, K), in scales; a sensor's offset is in it.

    Parameters
    ----------
    drive : ((T - 1) * 2 * substeps + 1, K) ndarray
        Acceleration that the inputs bring, scales per squared pace.
    hold : (1, 1) or ((T - 1) * 2 * substeps + 1, K) ndarray
        Of the spring, per squared pace.
    start : (2, K) ndarray
        Place and velocity, scales and scales per pace.
    damping : float
        Per pace.
    terms : MotionTerms
        Of all effects together.
    pace : float
        Time between samples over the pace.
    substeps : int
        Steps of the classical Runge-Kutta rule per sample; with a fifth of a pace each, its error is some 1e-5.
    late : float
        By which the drive acts, samples; may be negative.
    """
    moved: Array = _integrate(np.ascontiguousarray(drive), hold, start, damping, late, terms, pace, substeps)
    return moved + terms.sensor_offset


def refine(signal: Array, substeps: int, between: Between) -> Array:
    """Return an input at the instants that the integrator looks at, twice a substep.

    Parameters
    ----------
    signal : (T, ...) ndarray
        At the sampling instants.
    substeps : int
        Integration steps per sample.
    between : {"band_limited", "linear", "held", "averaged"}
        What the input does between samples: follows the smooth curve through them that holds no frequency above half
        the sampling rate, or a straight line, or stays; or samples are means over a period each, which straight lines
        are to keep.

    Returns
    -------
    ((T - 1) * 2 * substeps + 1, ...) ndarray
        The first and the last are the signal's own.
    """
    from scipy.signal import resample_poly

    fine = 2 * substeps
    places = np.arange((len(signal) - 1) * fine + 1)
    if between == "held":
        return signal[places // fine]
    if between == "band_limited":
        smooth: Array = resample_poly(signal, fine, 1, axis=0, window=("kaiser", 8.0), padtype="line")
        return smooth[: len(places)]
    if between == "averaged" and len(signal) > 2:
        signal = signal.copy()
        signal[1:-1] -= np.diff(signal, 2, axis=0) / BENT
    left = np.minimum(places // fine, len(signal) - 2)
    share = (places / fine - left).reshape(-1, *[1] * (signal.ndim - 1))
    return signal[left] + share * (signal[left + 1] - signal[left])
