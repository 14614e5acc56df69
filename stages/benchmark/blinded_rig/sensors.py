"""Sensors: filters ahead of the converter, noise, wander, jitter and the encoder.

Flows in: generators and true signals at the fine step. Flows out: the noise of a session (drawn once, so that the same
noise lies on data with and without an effect) and readings at the sampling rate. Arrays are (4, trials, samples).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfiltic, savgol_filter

from stages.benchmark.blinded_rig.machine import Array

COUNTS_PER_TURN = 16384
ENCODER_SPEED_NOISE_RAD_PER_S = 0.02
WHITE_KPA, COLOURED_KPA, SESSION_KPA, OFFSET_KPA, GAIN = 0.75, 0.4, 0.15, 0.15, 0.0007
WHITE_SHARE, COLOURED_SHARE, SESSION_SHARE, OFFSET_SHARE = 0.0008, 0.0005, 0.0002, 0.0002
WANDER_S = (0.5, 1.5)
SESSION_S = (30.0, 80.0)


@dataclass(frozen=True)
class Noise:
    """Noise of a session: ``added`` (4, trials, samples) in the channel's unit, ``gain`` (4, trials, 1) around 1."""

    pressure_added_kpa: Array
    pressure_gain: Array
    force_added_share: Array
    force_gain: Array
    speed_rad_per_s: Array
    count_rad: float

    def silenced(self) -> "Noise":
        """Return the same shapes without any noise, and an encoder that does not count."""
        quiet = {name: np.full_like(value, "gain" in name) for name, value in vars(self).items() if name != "count_rad"}
        return Noise(**quiet, count_rad=0.0)


def draw_noise(rng: np.random.Generator, start_s: Array, samples: int, step_s: float) -> Noise:
    """Noise of both channels; the force's in shares of full force."""
    shape = (4, start_s.size, samples)
    return Noise(
        added(rng, shape, start_s, step_s, (WHITE_KPA, COLOURED_KPA, SESSION_KPA, OFFSET_KPA)),
        1.0 + GAIN * rng.standard_normal((*shape[:2], 1)),
        added(rng, shape, start_s, step_s, (WHITE_SHARE, COLOURED_SHARE, SESSION_SHARE, OFFSET_SHARE)),
        1.0 + GAIN * rng.standard_normal((*shape[:2], 1)),
        ENCODER_SPEED_NOISE_RAD_PER_S * rng.standard_normal((2, *shape[1:])),
        2.0 * np.pi / COUNTS_PER_TURN,
    )


def added(
    rng: np.random.Generator,
    shape: tuple[int, int, int],
    start_s: Array,
    step_s: float,
    sizes: tuple[float, float, float, float],
) -> Array:
    """White noise + wander within the trial + wander along the session + jitter from trial to trial."""
    white, wander, session, offset = sizes
    total = white * rng.standard_normal(shape) + offset * rng.standard_normal((*shape[:2], 1))
    total += wander * ornstein_uhlenbeck(rng, shape, step_s, rng.uniform(*WANDER_S, (4, 1, 1)))
    clock = np.sort(np.concatenate([start_s, start_s + shape[2] * step_s]))
    for muscle in range(shape[0]):
        path = session_wander(rng, clock, rng.uniform(*SESSION_S))
        within = start_s[:, None] + step_s * np.arange(shape[2])
        total[muscle] += session * np.interp(within, clock, path)
    return total


def ornstein_uhlenbeck(rng: np.random.Generator, shape: tuple[int, int, int], step_s: float, tau_s: Array) -> Array:
    """Stationary OU noise of unit variance, (4, trials, samples); one time constant (4, 1, 1) per muscle, s."""
    noise = rng.standard_normal(shape)
    decay = np.exp(-step_s / tau_s)
    noise[..., 1:] *= np.sqrt(1.0 - decay**2)
    return np.stack(
        [lfilter([1.0], [1.0, -rate], rows, axis=-1) for rate, rows in zip(decay.ravel(), noise, strict=True)]
    )


def session_wander(rng: np.random.Generator, clock_s: Array, tau_s: float) -> Array:
    """OU path of unit variance at the sorted times ``clock_s``."""
    path, draws = np.empty(clock_s.size), rng.standard_normal(clock_s.size)
    path[0] = draws[0]
    for k, gap in enumerate(np.diff(clock_s), start=1):
        decay = np.exp(-gap / tau_s)
        path[k] = decay * path[k - 1] + np.sqrt(1.0 - decay**2) * draws[k]
    return path


def low_pass(signal: Array, corner_hz: Array, step_s: float) -> Array:
    """Second-order filter of each muscle's sensor, (4, trials, samples); an infinite corner passes all."""
    return np.stack([second_order(rows, hz, step_s) for rows, hz in zip(signal, corner_hz, strict=True)])


def second_order(rows: Array, corner_hz: float, step_s: float) -> Array:
    """Butterworth-damped second-order filter, settled on each row's first sample."""
    if not np.isfinite(corner_hz):
        return rows
    top, bottom = discretise(corner_hz, step_s)
    settled = lfiltic(top, bottom, np.ones(2), np.ones(2))
    return lfilter(top, bottom, rows, axis=-1, zi=settled * rows[:, :1])[0]


@lru_cache(maxsize=64)
def discretise(corner_hz: float, step_s: float) -> tuple[Array, Array]:
    """Numerator and denominator at a step, the input taken as straight between samples."""
    natural = 2.0 * np.pi * corner_hz
    denominator = np.array([1.0, np.sqrt(2.0) * natural, natural**2])
    top, bottom, _ = cont2discrete((np.array([natural**2]), denominator), step_s, method="foh")
    return top.ravel(), bottom


def read_encoder(angle_rad: Array, step_s: float, noise: Noise) -> tuple[Array, Array]:
    """Angle in whole counts, rad, and its smoothed derivative, rad/s, (2, trials, samples)."""
    counted = np.round(angle_rad / noise.count_rad) * noise.count_rad if noise.count_rad else angle_rad
    return counted, savgol_filter(counted, 9, 2, deriv=1, delta=step_s, axis=-1) + noise.speed_rad_per_s
