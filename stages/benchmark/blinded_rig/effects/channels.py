"""Channels that come late or coarsely, and a muscle that ignores low pressure.

Flows in: ``Signals``, sizes (4, 1, 1). Flows out: the site's signal, (4, trials, samples); for the encoder the joint
angles, rad, (2, trials, fine samples).
"""

import numpy as np

from stages.benchmark.blinded_rig.kernels import late_by
from stages.benchmark.blinded_rig.machine import JOINT_OF_MUSCLE, Array
from stages.benchmark.blinded_rig.signals import Effect, Signals


def force_late(s: Signals, seconds: Array) -> Array:
    """Late as an averaging filter is: the mean over the last ``2 seconds``."""
    steps = np.maximum(2.0 * seconds / s.step_s, 1e-9)
    mean = s.sensed_n.mean(axis=-1, keepdims=True)
    total = np.cumsum(s.sensed_n - mean, axis=-1)
    return mean + (total - late_by(total, steps.ravel())) / steps


def pressure_late(s: Signals, seconds: Array) -> Array:
    """Late as a bus is that passes pressures on."""
    return late_by(s.sensed_kpa, seconds.ravel() / s.step_s)


def angle_late(s: Signals, seconds: Array) -> Array:
    """Late encoder: the joint's two muscles share it, and the larger of their sizes counts."""
    per_joint = np.array([seconds.ravel()[joint == JOINT_OF_MUSCLE].max() for joint in range(len(s.joint_rad))])
    return late_by(s.joint_rad, per_joint / s.step_s)


def coarse_force(s: Signals, share: Array) -> Array:
    """Cut the force down to whole steps of ``share`` of full force."""
    count = np.maximum(share, 1e-12) * s.full_n
    return np.floor(s.sensed_n / count) * count


def coarse_pressure(s: Signals, kpa: Array) -> Array:
    """Round the pressure to whole steps."""
    count = np.maximum(kpa, 1e-9)
    return np.round(s.sensed_kpa / count) * count


def dead_band(s: Signals, kpa: Array) -> Array:
    """No pull up to a pressure; from 1.6 times it on, all of it; straight in between."""
    opened = (s.acting_kpa - kpa) / np.maximum(0.6 * kpa, 1e-9)
    return s.acting_kpa * np.clip(opened, 0.0, 1.0)


EFFECTS = (
    Effect("force_late", "channel_misalignment", "force_wire", "force_n", "s", 0.12, force_late),
    Effect("pressure_late", "channel_misalignment", "pressure_wire", "pressure_kpa", "s", 0.15, pressure_late, True),
    Effect("angle_late", "channel_misalignment", "angle_wire", "force_n", "s", 0.25, angle_late, True, joint_wide=True),
    Effect("coarse_force", "quantisation", "count", "force_n", "share", 0.2, coarse_force, only_form=True),
    Effect("coarse_pressure", "quantisation", "pressure_count", "pressure_kpa", "kpa", 150.0, coarse_pressure, True),
    Effect("dead_band", "pressure_dead_band", "acting_pressure", "force_n", "kpa", 150.0, dead_band),
)
