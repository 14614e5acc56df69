"""Play, slack and friction between muscle and joint, and a cam in place of a round pulley.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: contraction of the muscle, or tension, N, (4, trials, fine samples).
"""

import numpy as np
from numba import njit
from scipy.special import expit

from stages.benchmark.blinded_rig.effects.relaxation import drawn_per_trial
from stages.benchmark.blinded_rig.kernels import lugre_state
from stages.benchmark.blinded_rig.machine import Array, arm_over_length
from stages.benchmark.blinded_rig.signals import Effect, Signals

LOOSE_SHARE, LOOSE_WIDTH = 0.18, 0.03
OPENS_S, CLOSES_S = 0.20, 0.05
LOBES = 6.0
BRISTLE = np.array([0.0012, 0.0010, 0.0011, 0.0009])
BRISTLE_S = 0.003


@njit(cache=True)
def play(path: Array, half_width: Array, start: Array) -> Array:
    """Play operator of (muscles, trials, samples); ``start`` (muscles, trials) places it in its gap, in [-1, 1]."""
    out = np.empty_like(path)
    for m in range(path.shape[0]):
        for k in range(path.shape[1]):
            state = path[m, k, 0] + half_width[m] * start[m, k]
            for i in range(path.shape[2]):
                state = min(max(state, path[m, k, i] - half_width[m]), path[m, k, i] + half_width[m])
                out[m, k, i] = state
    return out


@njit(cache=True)
def open_and_close(wanted: Array, opens_s: float, closes_s: float, step: float) -> Array:
    """Lag of (muscles, trials, samples) with one time constant while rising and one while falling."""
    out = np.empty_like(wanted)
    rising, falling = 1.0 - np.exp(-step / opens_s), 1.0 - np.exp(-step / closes_s)
    for m in range(wanted.shape[0]):
        for k in range(wanted.shape[1]):
            state = wanted[m, k, 0]
            for i in range(wanted.shape[2]):
                out[m, k, i] = state
                gap = wanted[m, k, i] - state
                state += (rising if gap > 0.0 else falling) * gap
    return out


def backlash(s: Signals, width: Array) -> Array:
    """Leave a gap of ``width`` in contraction between the pulley and its key."""
    return play(s.contraction, 0.5 * width.ravel(), drawn_per_trial(s, 11))


def slack_opening(s: Signals, slack: Array) -> Array:
    """Loosen the cable while the muscle hardly pulls; the muscle takes it up again when it does."""
    load = s.machine.static_force(s.acting_kpa, s.contraction) / s.full_n
    opened = open_and_close(expit((LOOSE_SHARE - load) / LOOSE_WIDTH), OPENS_S, CLOSES_S, s.step_s)
    return s.contraction + slack * opened


def cam_arm(s: Signals, share: Array) -> Array:
    """Run the cable over a cam of six uneven lobes: r (1 + share (cos(6 angle + .3) + .3 cos(12 angle + 1)))."""

    def travel(angle: Array) -> Array:
        return np.sin(LOBES * angle + 0.3) / LOBES + 0.3 * np.sin(2.0 * LOBES * angle + 1.0) / (2.0 * LOBES)

    swing = travel(s.travel_rad) - travel(np.zeros(1))
    return s.contraction + arm_over_length()[:, None, None] * s.hand * share * swing


def pressed_friction(s: Signals, share: Array) -> Array:
    """Dry friction of the sleeve's strands, whose normal force is the pressure's; ``share`` is at 300 kPa."""
    state = lugre_state(s.velocity_per_s, BRISTLE, 0.1, 0.015, s.step_s)
    return s.tension_n - share * s.full_n * np.maximum(s.acting_kpa, 0.0) / 300.0 * state


def bristle_friction(s: Signals, share: Array) -> Array:
    """LuGre friction with damped bristles, sticking at 1.8 times its sliding level, under the cable's load."""
    state = lugre_state(s.velocity_per_s, BRISTLE, 0.8, 0.03, s.step_s)
    damped = state + BRISTLE_S * np.gradient(state, s.step_s, axis=-1)
    return s.tension_n - share * s.full_n * (0.6 + 0.4 * s.tension_n / s.full_n) * damped


EFFECTS = (
    Effect("backlash", "backlash", "geometry", "force_n", "contraction", 0.12, backlash, only_form=True),
    Effect("slack_opening", "cable_slack", "geometry", "force_n", "contraction", 0.15, slack_opening),
    Effect("cam_arm", "moment_arm_variation", "geometry", "force_n", "share", 0.8, cam_arm),
    Effect("pressed_friction", "coulomb_friction", "muscle", "force_n", "share", 0.3, pressed_friction),
    Effect("bristle_friction", "stribeck_friction", "cable", "force_n", "share", 0.3, bristle_friction),
)
