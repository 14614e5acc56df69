"""Hysteresis of the contraction in three other forms: Prandtl-Ishlinskii, Duhem and Preisach.

Flows in: ``Signals``, sizes (4, 1, 1), shares of full force. Flows out: tension, N, (4, trials, fine samples). Every
memory is (4, trials, fine samples), of the order of 1, and independent of the rate.
"""

import numpy as np
from numba import njit

from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

STOPS = np.array([0.0015, 0.004, 0.01, 0.025])
STOP_WEIGHTS = np.array([0.3, 0.3, 0.25, 0.15])
FORGETTING_UP, FORGETTING_DOWN = 90.0, 60.0
MIDDLE, SPREAD = 0.105, 0.05
RELAYS = np.linspace(-0.03, 0.24, 109)


@njit(cache=True)
def stop_memory(path: Array, widths: Array, weights: Array) -> Array:
    """Return a sum of stop operators, each in [-1, 1] (Prandtl-Ishlinskii; Kuhnen, K. (2003), Eur. J. Control 9)."""
    out = np.empty_like(path)
    for m in range(path.shape[0]):
        for k in range(path.shape[1]):
            states = np.zeros(widths.size)
            before = path[m, k, 0]
            for i in range(path.shape[2]):
                move = path[m, k, i] - before
                before = path[m, k, i]
                total = 0.0
                for j in range(widths.size):
                    states[j] = min(max(states[j] + move / widths[j], -1.0), 1.0)
                    total += weights[j] * states[j]
                out[m, k, i] = total
    return out


@njit(cache=True)
def duhem_memory(path: Array, up: float, down: float, middle: float, spread: float) -> Array:
    """Duhem model whose slope depends on place and way (Coleman, B. D. & Hodgdon, M. L. (1986), Int. J. Eng. Sci. 24).

    dz = -a |du| z + g(u) du, with ``up`` and ``down`` for a and a bell for g.
    """
    out = np.empty_like(path)
    for m in range(path.shape[0]):
        for k in range(path.shape[1]):
            z, before = 0.0, path[m, k, 0]
            for i in range(path.shape[2]):
                move = path[m, k, i] - before
                before = path[m, k, i]
                rate = up if move > 0.0 else down
                steep = rate * (0.35 + 0.8 * np.exp(-(((before - middle) / spread) ** 2)))
                kept = np.exp(-rate * abs(move))
                z = z * kept + np.sign(move) * steep / rate * (1.0 - kept)
                out[m, k, i] = z
    return out


@njit(cache=True)
def preisach_memory(path: Array, levels: Array, weights: Array) -> Array:
    """Preisach plane of relays (Mayergoyz, I. D. (1991), Mathematical Models of Hysteresis), in [-1, 1].

    A relay of ``weights[a, b]`` goes up where the path climbs past level a and down where it falls below level b <= a.
    At first, those that lie below the path's first value are up.
    """
    out = np.empty_like(path)
    count = levels.size
    spacing = levels[1] - levels[0]
    for m in range(path.shape[0]):
        for k in range(path.shape[1]):
            place = min(max(int(np.floor((path[m, k, 0] - levels[0]) / spacing)), -1), count - 1)
            up = np.zeros((count, count))
            total = 0.0
            for a in range(count):
                for b in range(a + 1):
                    up[a, b] = 1.0 if a + b <= 2 * place else -1.0
                    total += weights[a, b] * up[a, b]
            for i in range(path.shape[2]):
                now = min(max(int(np.floor((path[m, k, i] - levels[0]) / spacing)), -1), count - 1)
                while place < now:
                    place += 1
                    for b in range(place + 1):
                        total += weights[place, b] * (1.0 - up[place, b])
                        up[place, b] = 1.0
                while place > now:
                    for a in range(place, count):
                        total -= weights[a, place] * (1.0 + up[a, place])
                        up[a, place] = -1.0
                    place -= 1
                out[m, k, i] = total
    return out


def relay_weights(levels: Array) -> Array:
    """Weights (levels, levels) that sum to 1: relays of small width and in the middle weigh most."""
    above, below = levels[:, None], levels[None, :]
    width, centre = above - below, 0.5 * (above + below)
    bell = np.exp(-width / 0.02 - 0.5 * ((centre - 0.10) / 0.06) ** 2)
    weights = np.where(width >= 0.0, bell, 0.0)
    return weights / weights.sum()


def without_memory(path: Array, levels: Array, weights: Array) -> Array:
    """Return what the same relays would show without width, of the path's shape: the mean of their branches."""
    centre = 0.5 * (levels[:, None] + levels[None, :])
    single = [float(np.sum(weights * np.sign(level - centre))) for level in levels]
    return np.interp(path, levels, single)


def pressed(s: Signals) -> Array:
    """Share of a memory that pressure presses into the sleeve."""
    return 0.35 + 0.65 * np.maximum(s.acting_kpa, 0.0) / 300.0


def prandtl_ishlinskii(s: Signals, share: Array) -> Array:
    """Elastoplastic strands that slip one after the other."""
    return s.tension_n - share * s.full_n * pressed(s) * stop_memory(s.contraction, STOPS, STOP_WEIGHTS)


def duhem(s: Signals, share: Array) -> Array:
    """Memory that is stronger in mid-stroke and forgets sooner while shortening."""
    memory = duhem_memory(s.contraction, FORGETTING_UP, FORGETTING_DOWN, MIDDLE, SPREAD)
    return s.tension_n - share * s.full_n * pressed(s) * memory


def preisach(s: Signals, share: Array) -> Array:
    """Relays without number, with congruent minor loops: how far they lag behind the curve without memory."""
    weights = relay_weights(RELAYS)
    memory = without_memory(s.contraction, RELAYS, weights) - preisach_memory(s.contraction, RELAYS, weights)
    return s.tension_n - share * s.full_n * pressed(s) * 8.0 * memory


EFFECTS = (
    Effect("prandtl_ishlinskii", "hysteresis", "muscle", "force_n", "share", 0.3, prandtl_ishlinskii),
    Effect("duhem", "hysteresis", "muscle", "force_n", "share", 0.3, duhem),
    Effect("preisach", "hysteresis", "muscle", "force_n", "share", 0.3, preisach),
)
