"""What sensors make of a motion: noise, counts, and velocities that are filtered derivatives."""

from __future__ import annotations

import numpy as np

from stages.science.plant.chain import Chain
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.interaction import Motion
from stages.science.plant.plant import Encoder, Plant
from stages.science.rig.trial import Recording
from stages.science.signals.filtering import differentiate
from stages.science.signals.trajectories import Array


def record(
    motion: Motion,
    command_kpa: Array,
    exoskeleton: Exoskeleton,
    plant: Plant,
    generator: np.random.Generator,
    start_s: float = 0.0,
) -> Recording:
    """Return the recording of a motion; noise comes before the effects of a sensor, which may round or clip it.

    Parameters
    ----------
    motion, command_kpa : Motion, (T, M) ndarray
        What happened, and what was applied, kPa gauge.
    exoskeleton, plant
        Geometry, load-cell site and velocity filter; sensor constants.
    generator : numpy.random.Generator
        The only source of randomness.
    start_s : float
        When the trial began in the session, s.
    """
    chain = Chain(exoskeleton, plant, start_s)
    models = [plant.model_of(muscle) for muscle in exoskeleton.muscles]
    pressure = chain.sense_pressure(
        motion.pressure_kpa + _white(generator, motion.pressure_kpa, [each.pressure_noise_kpa for each in models])
    )
    pulled = motion.force_n if exoskeleton.load_cell_site == "muscle_tip" else motion.tension_n
    noisy = pulled + _white(generator, pulled, [each.force_noise_n for each in models])
    shown = chain.sense_force(noisy, motion.pressure_kpa, motion.contraction, motion.velocity_per_s)
    angle = read_encoder(motion.joint_angle_rad, plant.encoder, generator)
    rate, window = exoskeleton.sampling_rate_hz, exoskeleton.velocity_filter
    velocity = differentiate(angle, rate, window.window_s, window.order)
    contraction, contraction_velocity = contract(angle, velocity, exoskeleton)
    return Recording(
        time_s=np.arange(len(angle)) / rate,
        pressure_command_kpa=command_kpa,
        pressure_kpa=pressure,
        contraction=contraction,
        contraction_velocity_per_s=contraction_velocity,
        force_n=np.maximum(shown, 0.0),
        joint_angle_rad=angle,
        joint_velocity_rad_per_s=velocity,
    )


def contract(angle_rad: Array, velocity_rad_per_s: Array, exoskeleton: Exoskeleton) -> tuple[Array, Array]:
    """Return contractions (T, M) and their velocities, 1/s, by joint angles (T, J) and the nominal geometry."""
    at_zero = np.array([muscle.contraction_at_angle_0 for muscle in exoskeleton.muscles])
    per_rad = np.array([muscle.contraction_per_rad for muscle in exoskeleton.muscles])
    joint = exoskeleton.joint_of_muscle
    return at_zero + per_rad * angle_rad[:, joint], per_rad * velocity_rad_per_s[:, joint]


def read_encoder(angle_rad: Array, encoder: Encoder, generator: np.random.Generator) -> Array:
    """Return what an encoder shows of true angles: noise, then whole counts."""
    shown = angle_rad + encoder.noise_rad * generator.standard_normal(angle_rad.shape)
    if encoder.resolution_rad == 0.0:
        return shown
    counts: Array = np.round(shown / encoder.resolution_rad)
    return counts * encoder.resolution_rad


def _white(generator: np.random.Generator, like: Array, deviations: list[float]) -> Array:
    noise: Array = generator.standard_normal(like.shape) * np.array(deviations)
    return noise
