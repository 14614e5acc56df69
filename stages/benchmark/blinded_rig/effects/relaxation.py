"""Creep as a relaxation of the force itself.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: tension, N, (4, trials, fine samples). How far a muscle had relaxed
when a trial begins is not known: each trial starts from a state of its own.
"""

from zlib import crc32

import numpy as np
from numba import njit

from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

TIMES_S = (0.15, 0.9, 6.0, 40.0)
WEIGHTS = (0.2, 0.3, 0.3, 0.2)
UNKNOWN_SHARE = 0.25


@njit(cache=True)
def lag_from(target: Array, tau: float, start: Array, step: float) -> Array:
    """First-order lag of (muscles, trials, samples) from the states ``start`` (muscles, trials)."""
    out = np.empty_like(target)
    share = 1.0 - np.exp(-step / tau)
    for m in range(target.shape[0]):
        for k in range(target.shape[1]):
            state = start[m, k]
            for i in range(target.shape[2]):
                out[m, k, i] = state
                state += share * (target[m, k, i] - state)
    return out


def drawn_per_trial(s: Signals, salt: int) -> Array:
    """Values in [-1, 1] that the session's clock decides, (4, trials)."""
    rng = np.random.default_rng([crc32(s.start_s.tobytes()), salt])
    return rng.uniform(-1.0, 1.0, (4, s.start_s.size))


def relax(s: Signals, share: Array) -> Array:
    """Let a part of every change of tension fade over four time constants."""
    fading = np.zeros_like(s.tension_n)
    for index, (tau, weight) in enumerate(zip(TIMES_S, WEIGHTS, strict=True)):
        start = s.tension_n[..., 0] + UNKNOWN_SHARE * s.full_n[..., 0] * drawn_per_trial(s, index)
        fading += weight * (s.tension_n - lag_from(s.tension_n, tau, start, s.step_s))
    return s.tension_n + share * fading


EFFECTS = (Effect("relaxation", "creep", "muscle", "force_n", "share", 1.0, relax),)
