"""A mass on a spring with a damper, driven by a measured input: the plant of records from vibrating machines.

Inputs on a fine grid flow in, with constants and the terms that named effects add; the output at the sampling instants
flows out. Lengths are told in `output_scale` and time in the natural period, so that one effect has the same bounds on
every machine: with x the output over its scale, without its offset, w its velocity over the natural angular frequency,
and f the drive, x' = omega w and w' = omega (f - x - 2 zeta w + terms). All terms are always compiled; those at zero
are absent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from stages.plant.effect import DynamicEffect
from stages.signals.trajectories import Array

Between = Literal["band_limited", "linear", "held"]
FURTHEST = 1e3
"""Scales beyond which the motion is cut: a soft spring may let go, and a fit has to go on with finite numbers."""


class OscillatorConstants(NamedTuple):
    """What the linear model knows; offsets and scales in the units of input and output.

    Parameters
    ----------
    static_gain : float
        Output at rest over input.
    natural_frequency_hz, damping_ratio : float
        Of the undamped motion, and damping over the critical.
    input_offset : float
        What is added to the measured input.
    output_offset : float
        What the sensor adds to the motion.
    output_scale : float
        Motion in which effects tell their sizes; positive.
    """

    static_gain: float
    natural_frequency_hz: float
    damping_ratio: float
    input_offset: float
    output_offset: float
    output_scale: float


class OscillatorTerms(NamedTuple):
    """What effects add, over the spring's force at one scale; without a value given, nothing."""

    cubic: float = 0.0
    quadratic: float = 0.0
    coulomb: float = 0.0
    sliding: float = 1.0
    drag: float = 0.0
    hysteretic: float = 0.0
    turning: float = 1.0
    delay: float = 0.0
    drive_cut: float = 0.0
    sensor_cut: float = 0.0
    sensor_offset: float = 0.0


def collect_terms(effects: Iterable[tuple[DynamicEffect, Mapping[str, float]]]) -> OscillatorTerms:
    """Return the terms of several effects.

    Raises
    ------
    ValueError
        When an effect acts on another kind of machine, or two share a term.
    """
    found: dict[str, float] = {}
    for effect, values in effects:
        if effect.site != "oscillator":
            raise ValueError(f"effect {effect.name} acts at the {effect.site}, not at the oscillator")
        terms = effect.terms(values)
        if set(terms) & set(found):
            raise ValueError(f"effect {effect.name}: another listed effect sets the same term; list one of them")
        found |= terms
    return OscillatorTerms(**found)


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
def _pull(x: float, w: float, z: float, damping_ratio: float, terms: OscillatorTerms) -> float:
    force = x + 2.0 * damping_ratio * w + x * x * (terms.quadratic + terms.cubic * x) + terms.hysteretic * z
    if terms.coulomb != 0.0:
        force += terms.coulomb * math.tanh(w / terms.sliding)
    return force + terms.drag * w * abs(w)


@njit(cache=True, error_model="numpy")
def _integrate(
    drive: Array, start: Array, constants: OscillatorConstants, terms: OscillatorTerms, step_s: float, substeps: int
) -> Array:
    fine = 2 * substeps
    samples = (drive.shape[0] - 1) // fine + 1
    motion = np.empty((samples, drive.shape[1]))
    omega = 2.0 * math.pi * constants.natural_frequency_hz
    h = omega * step_s / substeps
    late = terms.delay / (constants.natural_frequency_hz * step_s) * fine
    for k in range(drive.shape[1]):
        x, w, z = start[0, k], start[1, k], 0.0
        motion[0, k] = x
        for i in range((samples - 1) * substeps):
            sum_x, sum_w, sum_z = 0.0, 0.0, 0.0
            dx, dw, dz = 0.0, 0.0, 0.0
            for stage in range(4):
                reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                at = 2 * i + (stage + 1) // 2
                f = drive[at, k] if late == 0.0 else _drive_at(drive[:, k], at - late)
                x_now, w_now, z_now = x + reach * dx, w + reach * dw, z + reach * dz
                dx = w_now
                dw = _cut(f, terms.drive_cut) - _pull(x_now, w_now, z_now, constants.damping_ratio, terms)
                dz = w_now / terms.turning * (1.0 - (z_now * z_now if w_now * z_now > 0.0 else 0.0))
                sum_x += weight * dx
                sum_w += weight * dw
                sum_z += weight * dz
            x = min(max(x + h / 6.0 * sum_x, -FURTHEST), FURTHEST)
            w = min(max(w + h / 6.0 * sum_w, -FURTHEST), FURTHEST)
            z = min(max(z + h / 6.0 * sum_z, -1.0), 1.0)
            if (i + 1) % substeps == 0:
                motion[(i + 1) // substeps, k] = _cut(x, terms.sensor_cut)
    return motion


def refine(signal: Array, substeps: int, between: Between) -> Array:
    """Return an input at the instants that the integrator looks at, twice a substep.

    Parameters
    ----------
    signal : (T, ...) ndarray
        At the sampling instants.
    substeps : int
        Integration steps per sample.
    between : {"band_limited", "linear", "held"}
        What the input does between samples: follows the smooth curve through them that holds no frequency above half
        the sampling rate, or a straight line, or stays.

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
    left = np.minimum(places // fine, len(signal) - 2)
    share = (places / fine - left).reshape(-1, *[1] * (signal.ndim - 1))
    return signal[left] + share * (signal[left + 1] - signal[left])


def simulate_oscillator(
    fine_input: Array,
    constants: OscillatorConstants,
    terms: OscillatorTerms,
    step_s: float,
    substeps: int,
    start: Array | None = None,
) -> Array:
    """Return the output at the sampling instants.

    Parameters
    ----------
    fine_input : ((T - 1) * 2 * substeps + 1, K) ndarray
        From `refine`, in the input's unit; K records.
    constants : OscillatorConstants
        Of the linear model.
    terms : OscillatorTerms
        From `collect_terms`.
    step_s : float
        Time between samples, s.
    substeps : int
        Steps of the classical Runge-Kutta rule per sample; with a fifth of a radian each, its error is some 1e-5.
    start : (2, K) ndarray, optional
        Motion without offset, in the output's unit, and velocity, in that per second; at rest without.

    Returns
    -------
    (T, K) ndarray
        In the output's unit.
    """
    scale = constants.output_scale
    drive = constants.static_gain / scale * (fine_input + constants.input_offset)
    begin = np.zeros((2, fine_input.shape[1]))
    if start is not None:
        begin[0] = start[0] / scale
        begin[1] = start[1] / (scale * 2.0 * math.pi * constants.natural_frequency_hz)
    motion = _integrate(np.ascontiguousarray(drive), begin, constants, terms, step_s, substeps)
    output: Array = constants.output_offset + scale * (motion + terms.sensor_offset)
    return output
