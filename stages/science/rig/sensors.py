"""What sensors make of a motion: noise, counts, and velocities that are filtered derivatives."""

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
    """Return the recording of a motion under commands as applied (T, M), kPa gauge, of a trial begun in a session, s.

    Noise comes before the effects of a sensor, which may round or clip it.
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
    return Recording(
        time_s=np.arange(len(angle)) / exoskeleton.sampling_rate_hz,
        pressure_command_kpa=command_kpa,
        pressure_kpa=pressure,
        force_n=np.maximum(shown, 0.0),
        **derive_from_encoder(angle, exoskeleton),
    )


def derive_from_encoder(angle_rad: Array, exoskeleton: Exoskeleton) -> dict[str, Array]:
    """Return joint angles (T, J) and what follows from them, filtered velocities too, as columns of a `Recording`."""
    window = exoskeleton.velocity_filter
    velocity = differentiate(angle_rad, exoskeleton.sampling_rate_hz, window.window_s, window.order)
    return {
        "joint_angle_rad": angle_rad,
        "joint_velocity_rad_per_s": velocity,
        **contract(angle_rad, velocity, exoskeleton),
    }


def contract(angle_rad: Array, velocity_rad_per_s: Array, exoskeleton: Exoskeleton) -> dict[str, Array]:
    """Return contractions (T, M) and their velocities, 1/s, by joint angles (T, J) and the nominal geometry."""
    at_zero = np.array([muscle.contraction_at_angle_0 for muscle in exoskeleton.muscles])
    per_rad = np.array([muscle.contraction_per_rad for muscle in exoskeleton.muscles])
    joint = exoskeleton.joint_of_muscle
    return {
        "contraction": at_zero + per_rad * angle_rad[:, joint],
        "contraction_velocity_per_s": per_rad * velocity_rad_per_s[:, joint],
    }


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
