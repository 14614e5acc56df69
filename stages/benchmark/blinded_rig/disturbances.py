"""Disturbances of a foreign session: jitter, pink noise, hum on the wires; ripple of the supply.

Flows in: a session's noise, its surroundings and a generator. Flows out: the noise with the disturbances on it, and the
ripple, kPa, (trials, fine samples), that every valve passes on alike.
"""

from dataclasses import replace

import numpy as np

from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.sensors import Noise
from stages.benchmark.blinded_rig.surroundings import Surroundings

MAINS_HZ = 50.0
THIRD_HARMONIC = 0.3
HUM_KPA_PER_SHARE = 500.0


def disturb(noise: Noise, around: Surroundings, rng: np.random.Generator, start_s: Array, step_s: float) -> Noise:
    """Return the noise with the disturbances added, (4, trials, samples), or (4, trials, 1) for what jitters."""
    shape = noise.force_added_share.shape
    jitter, offset = rng.standard_normal((2, *shape[:2], 1))
    within = start_s[:, None] + step_s * np.arange(shape[2])
    buzz = hum(rng, within)
    force = around.offset_jitter * offset + around.pink_force * pink(rng, shape) + around.mains_hum * buzz
    pressure = around.pink_pressure * pink(rng, shape) + HUM_KPA_PER_SHARE * around.mains_hum * buzz[::-1]
    return replace(
        noise,
        force_gain=noise.force_gain * (1.0 + around.gain_jitter * np.clip(jitter, -2.5, 2.5)),
        force_added_share=noise.force_added_share + force,
        pressure_added_kpa=noise.pressure_added_kpa + pressure,
    )


def pink(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """1/f noise of unit RMS, (..., samples): power falls as one over frequency down to one period per row."""
    samples = shape[-1]
    ranks = np.arange(1, samples // 2 + 1)
    parts = rng.standard_normal((2, *shape[:-1], ranks.size)) / np.sqrt(ranks)
    spectrum = np.zeros((*shape[:-1], samples // 2 + 1), dtype=complex)
    spectrum[..., 1:] = parts[0] + 1j * parts[1]
    # each of the frequencies below half the rate counts twice in a real signal's power, with 2 / samples**2
    return np.fft.irfft(spectrum, samples, axis=-1) * samples / (2.0 * np.sqrt(np.sum(1.0 / ranks)))


def hum(rng: np.random.Generator, time_s: Array) -> Array:
    """Mains and its third harmonic, unit RMS, (4, trials, samples); one phase per wire, one clock for all."""
    mains_hz = MAINS_HZ + rng.uniform(-0.05, 0.05)
    turns = mains_hz * time_s + rng.uniform(0.0, 1.0, (4, 1, 1))
    wave = np.sin(2.0 * np.pi * turns) + THIRD_HARMONIC * np.sin(6.0 * np.pi * turns)
    return wave * np.sqrt(2.0 / (1.0 + THIRD_HARMONIC**2))


def ripple(rng: np.random.Generator, around: Surroundings, start_s: Array, time_s: Array) -> Array:
    """Ripple of the supply, kPa, (trials, fine samples): a compressor's beat, its second harmonic, a slow swell."""
    clock_s = start_s[:, None] + time_s
    phase = 2.0 * np.pi * around.ripple_hz * clock_s + 0.6 * np.sin(2.0 * np.pi * 0.11 * clock_s)
    first, second, third = rng.uniform(0.0, 2.0 * np.pi, 3)
    wave = np.sin(phase + first) + 0.35 * np.sin(2.0 * phase + second)
    swell = 1.0 + 0.3 * np.sin(2.0 * np.pi * 0.23 * clock_s + third)
    return around.supply_ripple * wave * swell * np.sqrt(2.0 / (1.0 + 0.35**2) / (1.0 + 0.5 * 0.3**2))
