"""Hidden effects of the sensors and their wires.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: the sensed force, N, or pressure, kPa, (4, trials, samples), fine or,
at the site ``count``, at the sampling rate with the noise in.
"""

import numpy as np

from stages.benchmark.blinded_rig.kernels import fill_first_order, late_by
from stages.benchmark.blinded_rig.machine import Array
from stages.benchmark.blinded_rig.signals import Effect, Signals

WARM_UP_S = 130.0
MAINS_HZ = 50.0
NEIGHBOUR = [1, 0, 3, 2]


def warmed(s: Signals) -> Array:
    """Share of the warm-up that is over, (trials, fine samples); heat spreads, so its end is slower than its start."""
    since_s = np.maximum(s.session_s, 0.0)
    return since_s / (since_s + WARM_UP_S)


def offset_force(s: Signals, share: Array) -> Array:
    """Shift the load cell's zero."""
    return s.sensed_n + share * s.full_n


def offset_pressure(s: Signals, kpa: Array) -> Array:
    """Shift the pressure sensor's zero."""
    return s.sensed_kpa + kpa


def gain_force(s: Signals, share: Array) -> Array:
    """Change the load cell's gain."""
    return s.sensed_n * (1.0 + s.hand * share)


def gain_pressure(s: Signals, share: Array) -> Array:
    """Change the pressure sensor's gain."""
    return s.sensed_kpa * (1.0 + s.hand * share)


def drift_force(s: Signals, share: Array) -> Array:
    """Move the load cell's zero as its bridge warms up over the session."""
    return s.sensed_n + share * s.full_n * warmed(s)


def drift_pressure(s: Signals, kpa: Array) -> Array:
    """Move the pressure sensor's zero as it warms up over the session."""
    return s.sensed_kpa + kpa * warmed(s)


def force_late(s: Signals, seconds: Array) -> Array:
    """Delay the force channel."""
    return late_by(s.sensed_n, seconds.ravel() / s.step_s)


def count_force(s: Signals, share: Array) -> Array:
    """Round the force to steps of ``share`` of full force, as a converter of few bits."""
    count = np.maximum(share, 1e-12) * s.full_n
    return np.round(s.sensed_n / count) * count


def clip_force(s: Signals, share: Array) -> Array:
    """Saturate the amplifier ``share`` of the range below the largest force."""
    return np.minimum(s.sensed_n, (1.0 - share) * s.sensed_n.max(axis=(1, 2), keepdims=True))


def neighbour_pressure(s: Signals, share: Array) -> Array:
    """Let the pressure of the other muscle on the joint leak into the load cell."""
    return s.sensed_n + s.hand * share * s.full_n * (s.pressure_kpa[NEIGHBOUR] - 250.0) / 250.0


def other_joint(s: Signals, share: Array) -> Array:
    """Bend the load cell's bracket with the other joint's angle."""
    return s.sensed_n + s.hand * share * s.full_n * np.sin(2.0 * s.other_rad)


def hum(s: Signals, share: Array) -> Array:
    """Mains on the force wire."""
    return s.sensed_n + share * s.full_n * np.sin(2.0 * np.pi * MAINS_HZ * s.session_s)


def valve_current(s: Signals, share: Array) -> Array:
    """Couple the valve's drive current, which follows the change of command, into the force wire."""
    current = s.command_kpa - fill_first_order(s.command_kpa, np.full(4, 0.02), s.step_s)
    return s.sensed_n + share * s.full_n * current / 100.0


EFFECTS = (
    Effect("sensor_offset", "sensor_offset", "force_wire", "force_n", "share", 0.05, offset_force, only_form=True),
    Effect(
        "sensor_offset_pressure", "sensor_offset", "pressure_wire", "pressure_kpa", "kpa", 40.0, offset_pressure, True
    ),
    Effect("sensor_gain", "sensor_gain", "force_wire", "force_n", "share", 0.3, gain_force, only_form=True),
    Effect("sensor_gain_pressure", "sensor_gain", "pressure_wire", "pressure_kpa", "share", 0.3, gain_pressure, True),
    Effect("sensor_drift", "sensor_drift", "force_wire", "force_n", "share", 0.1, drift_force),
    Effect("sensor_drift_pressure", "sensor_drift", "pressure_wire", "pressure_kpa", "kpa", 40.0, drift_pressure),
    Effect(
        "channel_misalignment", "channel_misalignment", "force_wire", "force_n", "s", 0.1, force_late, only_form=True
    ),
    Effect("quantisation", "quantisation", "count", "force_n", "share", 0.1, count_force, only_form=True),
    Effect("saturation", "saturation", "count", "force_n", "share", 0.6, clip_force, only_form=True),
    Effect(
        "neighbour_pressure",
        "neighbour_pressure",
        "force_wire",
        "force_n",
        "share",
        0.2,
        neighbour_pressure,
        outsider=True,
    ),
    Effect("other_joint", "other_joint", "force_wire", "force_n", "share", 0.2, other_joint, outsider=True),
    Effect("mains_hum", "mains_hum", "force_wire", "force_n", "share", 0.1, hum, outsider=True),
    Effect("valve_current", "valve_current", "force_wire", "force_n", "share", 0.3, valve_current, outsider=True),
)
