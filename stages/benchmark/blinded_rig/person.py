"""The person who drives the joints: imposed kinematics.

Flows in: generators and the time base. Flows out: joint angles (2, trials, samples), rad: reaches with rests, holds,
slow reversals and rhythm, tracked imperfectly and with a little tremor.
"""

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from stages.benchmark.blinded_rig.machine import Array

LOW_RAD = 0.09
HIGH_RAD = (1.22, 1.08)
TREMOR_HZ = (7.0, 11.0)


def move_joints(rng: np.random.Generator, trials: int, time_s: Array) -> Array:
    """Angles (2, trials, samples) over ``time_s`` (uniform), rad."""
    makers = (reaches, reaches, slow_reversal, rhythm, hold_and_go)
    angles = np.empty((2, trials, time_s.size))
    for joint, high in enumerate(HIGH_RAD):
        order = rng.permutation(np.arange(trials) % len(makers))
        for trial in range(trials):
            wanted = makers[order[trial]](rng, time_s, LOW_RAD, high)
            angles[joint, trial] = track(rng, wanted, time_s[1] - time_s[0])
    return angles


def reach(time_s: Array, start_s: float, lasting_s: float) -> Array:
    """From 0 to 1 with least jerk (Flash & Hogan 1985)."""
    share = np.clip((time_s - start_s) / lasting_s, 0.0, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def reaches(rng: np.random.Generator, time_s: Array, low: float, high: float) -> Array:
    """Several reaches to random targets, resting between them."""
    angle = np.full(time_s.size, rng.uniform(low, high))
    now, at = time_s[0] + rng.uniform(0.0, 0.5), angle[0]
    while now < time_s[-1]:
        lasting, target = rng.uniform(0.45, 1.3), rng.uniform(low, high)
        angle += (target - at) * reach(time_s, now, lasting)
        now, at = now + lasting + rng.exponential(0.25), target
    return angle


def slow_reversal(rng: np.random.Generator, time_s: Array, low: float, high: float) -> Array:
    """Slowly there and back, a second smaller movement on top."""
    span = high - low
    phase, second = rng.uniform(0.0, 2.0 * np.pi, 2)
    slow = 0.36 * np.sin(2.0 * np.pi * rng.uniform(0.18, 0.35) * time_s + phase)
    return 0.5 * (low + high) + span * (slow + 0.1 * np.sin(2.0 * np.pi * rng.uniform(0.5, 0.9) * time_s + second))


def rhythm(rng: np.random.Generator, time_s: Array, low: float, high: float) -> Array:
    """To and fro at a steady rate whose amplitude swells."""
    swell = rng.uniform(0.15, 0.45) + rng.uniform(-0.1, 0.1) * np.sin(2.0 * np.pi * 0.25 * time_s)
    beat = np.sin(2.0 * np.pi * rng.uniform(0.45, 0.95) * time_s + rng.uniform(0.0, 2.0 * np.pi))
    return rng.uniform(0.45, 0.55) * (low + high) + np.clip(swell, 0.05, 0.45) * (high - low) * 0.85 * beat


def hold_and_go(rng: np.random.Generator, time_s: Array, low: float, high: float) -> Array:
    """Return a long hold, one reach, a long hold."""
    start, target = rng.uniform(low, high, 2)
    return start + (target - start) * reach(time_s, rng.uniform(1.0, 2.2), rng.uniform(0.5, 1.2))


def track(rng: np.random.Generator, wanted_rad: Array, step_s: float) -> Array:
    """Follow a wanted path (samples,) as a person does: smoothed, late, wandering, trembling."""
    natural = 2.0 * np.pi * rng.uniform(2.2, 3.2)
    decay = np.exp(-natural * step_s)
    late = lfilter([(1.0 - decay) ** 2], [1.0, -2.0 * decay, decay**2], wanted_rad - wanted_rad[0]) + wanted_rad[0]
    wander = 0.012 * coloured(rng, wanted_rad.size, step_s, (0.1, 1.2))
    return late + wander + rng.uniform(0.0004, 0.0012) * coloured(rng, wanted_rad.size, step_s, TREMOR_HZ)


def coloured(rng: np.random.Generator, samples: int, step_s: float, band_hz: tuple[float, float]) -> Array:
    """Noise of a band, (samples,), of unit standard deviation."""
    stages = butter(2, band_hz, btype="band", fs=1.0 / step_s, output="sos")
    noise = sosfiltfilt(stages, rng.standard_normal(samples), padtype="constant")
    return noise / noise.std()
