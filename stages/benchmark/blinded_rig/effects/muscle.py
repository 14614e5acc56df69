"""Hidden effects of the muscle itself: pressure acting, contraction, tension.

Flows in: ``Signals``, sizes (4, 1, 1), mostly shares of full force. Flows out: the site's signal, (4, trials, fine
samples); a muscle that shortens against an effect loses tension.
"""

import numpy as np
from scipy.special import expit

from stages.benchmark.blinded_rig.kernels import bouc_wen, fill_first_order
from stages.benchmark.blinded_rig.machine import Array, arm_over_length
from stages.benchmark.blinded_rig.signals import Effect, Signals

YIELD_CONTRACTION = np.array([0.011, 0.0095, 0.0105, 0.009])
BRANCHES = ((0.12, 0.25), (0.6, 0.45), (2.5, 0.3))
SOFT_SHARE = 0.12


def hysteresis(s: Signals, share: Array) -> Array:
    """Bouc-Wen memory of the contraction, stronger under pressure."""
    memory = bouc_wen(s.velocity_per_s, YIELD_CONTRACTION, 1.5, s.step_s)
    return s.tension_n - share * s.full_n * (0.3 + 0.7 * np.maximum(s.acting_kpa, 0.0) / 300.0) * memory


def creep(s: Signals, share: Array) -> Array:
    """Three Maxwell branches along the contraction: a stretch is resisted at first, then yields."""
    lost = sum(
        weight * (s.contraction - fill_first_order(s.contraction, np.full(4, tau), s.step_s))
        for tau, weight in BRANCHES
    )
    return s.tension_n - share * s.full_n * (0.5 + 0.5 * s.acting_kpa / 300.0) * lost / 0.05


def stretch_in_series(s: Signals, share: Array) -> Array:
    """Let the muscle shorten further by a tendon with a toe region; solved implicitly by Newton's method."""
    joint_side, force = s.contraction, np.maximum(s.machine.static_force(s.acting_kpa, s.contraction), 0.0)
    for _ in range(6):
        stretched = joint_side + share * tendon_strain(force / s.full_n)
        miss = s.machine.static_force(s.acting_kpa, stretched) - force
        ahead = s.machine.static_force(s.acting_kpa, stretched + 1e-5)
        slope = (ahead - miss - force) / 1e-5 * share * tendon_compliance(force / s.full_n) / s.full_n - 1.0
        force = np.maximum(force - miss / slope, 0.0)
    return joint_side + share * tendon_strain(force / s.full_n)


def tendon_strain(load: Array) -> Array:
    """Strain over its largest: a toe that straightens by a load of some .05, then linear."""
    return 0.75 * load + 0.25 * (1.0 - np.exp(-load / 0.06))


def tendon_compliance(load: Array) -> Array:
    """Return the derivative of ``tendon_strain``."""
    return 0.75 + 0.25 / 0.06 * np.exp(-load / 0.06)


def take_up(s: Signals, threshold_kpa: Array) -> Array:
    """Let the sleeve take up the first pressure, softly."""
    soft = np.maximum(SOFT_SHARE * threshold_kpa, 1e-6)
    return soft * np.logaddexp(0.0, (s.acting_kpa - threshold_kpa) / soft)


def gate(s: Signals, threshold_kpa: Array) -> Array:
    """No pull below a pressure; above it, all of it."""
    soft = np.maximum(SOFT_SHARE * threshold_kpa, 1e-6)
    return s.acting_kpa * expit((s.acting_kpa - threshold_kpa) / soft)


def harden(s: Signals, share: Array) -> Array:
    """Add a passive spring that hardens as sinh away from the middle of the range."""
    return s.tension_n - share * s.full_n * np.sinh((s.contraction - 0.1) / 0.025)


def stiffen_at_end(s: Signals, share: Array) -> Array:
    """Exponential loss of tension near the end of the stroke."""
    return s.tension_n - share * s.full_n * np.exp((s.contraction - 0.16) / 0.012)


def cam(s: Signals, share: Array) -> Array:
    """Vary the moment arm with the angle as an eccentric pulley does: r (1 + share cos(3 angle + 0.6))."""
    swing = np.sin(3.0 * s.travel_rad + 0.6) / 3.0
    return s.contraction + arm_over_length()[:, None, None] * s.hand * share * (swing - np.sin(0.6) / 3.0)


def soften_with_work(s: Signals, share: Array) -> Array:
    """Soften the rubber with the work done since the trial began."""
    power = np.abs(s.tension_n * s.velocity_per_s) / s.full_n * (s.time_s >= 0.0)
    return s.tension_n * np.exp(-share * np.cumsum(power, axis=-1) * s.step_s / 0.03)


def catch(s: Signals, share: Array) -> Array:
    """Catch the sleeve in a window of contraction while it shortens under pressure."""
    window = np.exp(-(((s.contraction - 0.105) / 0.007) ** 2))
    shortening = 0.5 + 0.5 * np.tanh(s.velocity_per_s / 0.01)
    pressed = 0.5 + 0.5 * np.tanh((s.acting_kpa - 220.0) / 20.0)
    return s.tension_n - share * s.full_n * window * shortening * pressed


def bulge(s: Signals, share: Array) -> Array:
    """Bend the pull with pressure, as a bladder that bulges between the strands."""
    return s.tension_n * (1.0 + s.hand * share * ((s.acting_kpa - 280.0) / 200.0) ** 2)


def slacken(s: Signals, slack: Array) -> Array:
    """Hang a slack cable until the muscle has shortened by ``slack``; a muscle that cannot passes no tension."""
    soft = 0.002 * s.full_n
    looser = s.machine.static_force(s.acting_kpa, s.contraction + slack)
    loose = s.tension_n + looser - s.machine.static_force(s.acting_kpa, s.contraction)
    return soft * np.logaddexp(0.0, loose / soft)


EFFECTS = (
    Effect("hysteresis", "hysteresis", "muscle", "force_n", "share", 0.3, hysteresis),
    Effect("creep", "creep", "muscle", "force_n", "share", 0.6, creep),
    Effect("series_elasticity", "series_elasticity", "geometry", "force_n", "strain", 0.1, stretch_in_series),
    Effect("threshold_pressure", "threshold_pressure", "acting_pressure", "force_n", "kpa", 150.0, take_up),
    Effect("pressure_dead_band", "pressure_dead_band", "acting_pressure", "force_n", "kpa", 150.0, gate),
    Effect("cubic_stiffness", "cubic_stiffness", "muscle", "force_n", "share", 0.1, harden),
    Effect("end_stiffening", "end_stiffening", "muscle", "force_n", "share", 0.6, stiffen_at_end),
    Effect("moment_arm_variation", "moment_arm_variation", "geometry", "force_n", "share", 0.4, cam),
    Effect("work_softening", "work_softening", "muscle", "force_n", "share", 0.6, soften_with_work, outsider=True),
    Effect("catch", "catch", "muscle", "force_n", "share", 0.5, catch, outsider=True),
    Effect("bulge", "bulge", "muscle", "force_n", "share", 0.5, bulge, outsider=True),
    Effect("cable_slack", "cable_slack", "cable", "force_n", "contraction", 0.15, slacken),
)
