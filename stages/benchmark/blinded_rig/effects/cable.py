"""Hidden effects of the cable between muscle and joint: friction beyond the muscle's tip.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: tension at the joint's end, N, (4, trials, fine samples). A load cell
at the muscle's tip sees none of it. Cables that slide towards the muscle (shortening) deliver less tension.
"""

import numpy as np

from stages.benchmark.blinded_rig.kernels import lugre_state
from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

SLIDING_PER_S = np.array([0.004, 0.003, 0.0035, 0.0045])[:, None, None]
PRESLIDING = np.array([0.0010, 0.0008, 0.0009, 0.0011])
STRIBECK_PER_S = 0.02


def coulomb(s: Signals, share: Array) -> Array:
    """Constant friction, arctangent around rest."""
    return s.tension_n - share * s.full_n * 2.0 / np.pi * np.arctan(s.velocity_per_s / SLIDING_PER_S)


def stribeck(s: Signals, share: Array) -> Array:
    """LuGre friction whose static level is twice the sliding one."""
    return s.tension_n - share * s.full_n * lugre_state(s.velocity_per_s, PRESLIDING, 1.0, STRIBECK_PER_S, s.step_s)


def capstan(s: Signals, wrap: Array) -> Array:
    """Friction in proportion to tension: exp(-wrap) while sliding, with presliding at reversals."""
    return s.tension_n * np.exp(-wrap * lugre_state(s.velocity_per_s, PRESLIDING, 0.0, STRIBECK_PER_S, s.step_s))


def viscous(s: Signals, share: Array) -> Array:
    """Add a thinning film, which shears the more easily the faster it moves; ``share`` is at .1 per second."""
    speed = s.velocity_per_s / 0.1
    return s.tension_n - share * s.full_n * 1.5 * speed / np.sqrt(1.0 + 1.25 * speed**2)


def eccentric(s: Signals, share: Array) -> Array:
    """Add an eccentric pulley: tension ripples with the joint's angle."""
    return s.tension_n * (1.0 + share * np.cos(11.0 * s.travel_rad + 0.4))


EFFECTS = (
    Effect("coulomb_friction", "coulomb_friction", "cable", "force_n", "share", 0.2, coulomb),
    Effect("stribeck_friction", "stribeck_friction", "cable", "force_n", "share", 0.2, stribeck),
    Effect("capstan_friction", "capstan_friction", "cable", "force_n", "wrap", 0.6, capstan),
    Effect("viscous_friction", "viscous_friction", "cable", "force_n", "share", 0.2, viscous),
    Effect("eccentric_pulley", "eccentric_pulley", "cable", "force_n", "share", 0.3, eccentric, outsider=True),
)
