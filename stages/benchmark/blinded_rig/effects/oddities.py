"""Outsiders: effects for which nobody keeps a name ready.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: the site's signal, (4, trials, fine samples). Each says by
``outsider_for`` whether it is there to build on or to score with.
"""

import numpy as np
from numba import njit

from stages.benchmark.blinded_rig.effects.relaxation import lag_from
from stages.benchmark.blinded_rig.kernels import fill_first_order
from stages.benchmark.blinded_rig.machine import JOINT_OF_MUSCLE, Array, sheet_column
from stages.benchmark.blinded_rig.signals import Effect, Signals

COOLING_S = 5.0
REST_PER_S, REST_S, TEAR = 0.006, 0.25, 0.004
HOSE_HZ, HOSE_DAMPING = 13.0, 0.08
LINK_HZ, LINK_DAMPING = 4.0, 0.03
LINE_S = 0.12
HEAT_S = 0.35
BREATH_HZ = 0.27
SUPPLIED_WITH = [2, 3, 0, 1]


@njit(cache=True)
def resonate(drive: Array, hertz: float, damping: float, step: float) -> Array:
    """Response of a damped second-order system with unit gain, (muscles, trials, samples), settled at the start."""
    out = np.empty_like(drive)
    natural = 2.0 * np.pi * hertz
    for m in range(drive.shape[0]):
        for k in range(drive.shape[1]):
            place, speed = drive[m, k, 0], 0.0
            for i in range(drive.shape[2]):
                out[m, k, i] = place
                speed += step * natural * (natural * (drive[m, k, i] - place) - 2.0 * damping * speed)
                place += step * speed
    return out


@njit(cache=True)
def stick_after_rest(path: Array, step: float, rest_per_s: float, rest_s: float, tear: float) -> Array:
    """Force in [-1, 1] of a bond that grows in rest, stretches with the path and tears over ``tear``."""
    out = np.empty_like(path)
    for m in range(path.shape[0]):
        for k in range(path.shape[1]):
            bond, anchor, before = 0.0, path[m, k, 0], path[m, k, 0]
            for i in range(path.shape[2]):
                speed = (path[m, k, i] - before) / step
                before = path[m, k, i]
                rest = np.exp(-((speed / rest_per_s) ** 2))
                stretched = (before - anchor) / tear
                bond += step / rest_s * rest * (1.0 - bond)
                bond *= np.exp(-abs(speed) * step / tear * stretched * stretched)
                anchor += (before - anchor) * (1.0 - np.exp(-step / rest_s * (1.0 - 0.9 * bond)))
                out[m, k, i] = bond * np.tanh((before - anchor) / tear)
    return out


def heat(s: Signals) -> Array:
    """Work done lately, (4, trials, fine samples), of the order of 1: it cools over some seconds."""
    power = np.abs(s.tension_n * s.velocity_per_s) / s.full_n / 0.05
    return lag_from(power, COOLING_S, np.zeros(power.shape[:2]), s.step_s) * COOLING_S


def thermal_stiffening(s: Signals, share: Array) -> Array:
    """Warm the bladder by the work done: it stiffens against shortening, and cools over seconds."""
    return s.tension_n - share * s.full_n * heat(s) * s.contraction / 0.1


def rest_sticking(s: Signals, share: Array) -> Array:
    """Let the sleeve stick where it has rested, until it tears off."""
    return s.tension_n - share * s.full_n * stick_after_rest(s.contraction, s.step_s, REST_PER_S, REST_S, TEAR)


def hose_resonance(s: Signals, share: Array) -> Array:
    """Let the air in the hose swing against the valve."""
    return s.pressure_kpa + share * (resonate(s.pressure_kpa, HOSE_HZ, HOSE_DAMPING, s.step_s) - s.pressure_kpa)


def torque_crosstalk(s: Signals, share: Array) -> Array:
    """Twist the load cell with the torque of the other joint."""
    lever = sheet_column("sign") * sheet_column("moment_arm_m")
    pull = lever[:, None, None] * s.tension_n
    per_joint = np.stack([pull[joint == JOINT_OF_MUSCLE].sum(axis=0) for joint in range(len(s.joint_rad))])
    return s.sensed_n + s.hand * share * s.full_n * per_joint[1 - JOINT_OF_MUSCLE] / 100.0


def flexible_link(s: Signals, give: Array) -> Array:
    """Let the joint's link bend under the muscle's pull and swing on."""
    load = np.maximum(s.machine.static_force(s.acting_kpa, s.contraction), 0.0) / s.full_n
    return s.contraction + give * (resonate(load, LINK_HZ, LINK_DAMPING, s.step_s) - load)


def common_line(s: Signals, share: Array) -> Array:
    """Share a supply line with a muscle of the other joint: its changes arrive late and smeared."""
    other = s.pressure_kpa[SUPPLIED_WITH]
    return s.pressure_kpa + share * (fill_first_order(other, np.full(4, LINE_S), s.step_s) - other)


def fold_ripple(s: Signals, share: Array) -> Array:
    """Unfold a creased bladder: the pull ripples along the stroke, and pressure moves the creases."""
    phase = 2.0 * np.pi * s.contraction / 0.028 + s.acting_kpa / 70.0
    return s.tension_n * (1.0 + share * np.sin(phase))


def gas_heating(s: Signals, share: Array) -> Array:
    """Heat the sensor's membrane with the air that is compressed; the error follows the square of the filling."""
    filling = np.gradient(s.pressure_kpa, s.step_s, axis=-1)
    warmth = fill_first_order(filling * np.abs(filling) / 2000.0, np.full(4, HEAT_S), s.step_s)
    return s.sensed_kpa + share * warmth


def cell_inertia(s: Signals, share: Array) -> Array:
    """Hang the load cell on the moving cable: it weighs with the joint's speed squared and its acceleration."""
    speed = np.gradient(s.travel_rad, s.step_s, axis=-1)
    smooth = fill_first_order(speed, np.full(4, 0.02), s.step_s)
    acceleration = (speed - smooth) / 0.02
    return s.sensed_n + s.hand * share * s.full_n * (0.25 * speed**2 + acceleration / 12.0)


def breathing(s: Signals, share: Array) -> Array:
    """Tighten the person's strap with each breath, the more the further the joint is bent."""
    turns = BREATH_HZ * s.session_s + 0.15 * np.sin(2.0 * np.pi * 0.031 * s.session_s)
    breath = np.maximum(np.sin(2.0 * np.pi * turns), 0.0) ** 2
    return s.sensed_n + share * s.full_n * breath * (0.4 + s.travel_rad)


def peak_softening(s: Signals, share: Array) -> Array:
    """Soften the rubber below the longest stretch of the trial so far (Mullins 1969)."""
    shortest = np.minimum.accumulate(s.contraction, axis=-1)
    return s.tension_n * (1.0 - share * np.tanh((s.contraction - shortest) / 0.05))


EFFECTS = (
    Effect("thermal_stiffening", "thermal_stiffening", "muscle", "force_n", "share", 0.5, thermal_stiffening,
           outsider=True),
    Effect("rest_sticking", "rest_sticking", "muscle", "force_n", "share", 0.6, rest_sticking, outsider=True),
    Effect("hose_resonance", "hose_resonance", "pressure", "pressure_kpa", "share", 1.0, hose_resonance, outsider=True),
    Effect("torque_crosstalk", "torque_crosstalk", "force_wire", "force_n", "share", 0.4, torque_crosstalk,
           outsider=True),
    Effect("flexible_link", "flexible_link", "geometry", "force_n", "contraction", 0.8, flexible_link,
           outsider=True, outsider_for="scoring"),
    Effect("common_line", "common_line", "pressure", "pressure_kpa", "share", 0.8, common_line,
           outsider=True, outsider_for="scoring"),
    Effect("fold_ripple", "fold_ripple", "muscle", "force_n", "share", 0.5, fold_ripple,
           outsider=True, outsider_for="scoring"),
    Effect("gas_heating", "gas_heating", "pressure_wire", "pressure_kpa", "share", 0.5, gas_heating,
           outsider=True, outsider_for="scoring"),
    Effect("cell_inertia", "cell_inertia", "force_wire", "force_n", "share", 0.4, cell_inertia,
           outsider=True, outsider_for="scoring"),
    Effect("breathing", "breathing", "force_wire", "force_n", "share", 0.3, breathing,
           outsider=True, outsider_for="scoring"),
    Effect("peak_softening", "peak_softening", "muscle", "force_n", "share", 0.8, peak_softening,
           outsider=True, outsider_for="scoring"),
)  # fmt: skip
