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
    lead: int = 0,
) -> Recording:
    """Return the recording of a motion under commands as applied (L + T, M), kPa gauge.

    The trial begins after the L samples of its lead-in. Their noise is drawn last, and their velocities are filtered
    apart, so that a trial's numbers do not depend on whether they are there. Noise comes before the effects of a
    sensor, which may round or clip it.
    """
    rate_hz = exoskeleton.sampling_rate_hz
    chain = Chain(exoskeleton, plant, -lead / rate_hz)
    models = [plant.find_model(muscle.name, muscle.type) for muscle in exoskeleton.muscles]
    pressure_noise, force_noise, angle_noise = _draw_noise(generator, command_kpa, motion.joint_angle_rad, lead)
    noise_kpa = pressure_noise * np.array([each.pressure_noise_kpa for each in models])
    pressure = chain.sense_pressure(motion.pressure_kpa + noise_kpa)
    pulled = motion.force_n if exoskeleton.load_cell_site == "muscle_tip" else motion.tension_n
    noisy = pulled + force_noise * np.array([each.force_noise_n for each in models])
    shown = chain.sense_force(noisy, motion.pressure_kpa, motion.contraction, motion.velocity_per_s)
    angle = read_encoder(motion.joint_angle_rad, plant.encoder, angle_noise)
    return Recording(
        time_s=(np.arange(len(angle)) - lead) / rate_hz,
        pressure_command_kpa=command_kpa,
        pressure_kpa=pressure,
        force_n=np.maximum(shown, 0.0),
        **derive_from_encoder(angle, exoskeleton, lead),
    )


def derive_from_encoder(angle_rad: Array, exoskeleton: Exoskeleton, lead: int = 0) -> dict[str, Array]:
    """Return joint angles (L + T, J) and what follows from them, velocities too, as columns of a `Recording`.

    Velocities are filtered in the lead-in L and in the trial apart.
    """
    window = exoskeleton.velocity_filter
    parts = np.split(angle_rad, [lead]) if lead else [angle_rad]
    filtered = [differentiate(each, exoskeleton.sampling_rate_hz, window.window_s, window.order) for each in parts]
    velocity = np.concatenate(filtered)
    angles = {"joint_angle_rad": angle_rad, "joint_velocity_rad_per_s": velocity}
    return angles | contract(angle_rad, velocity, exoskeleton)


def contract(angle_rad: Array, velocity_rad_per_s: Array, exoskeleton: Exoskeleton) -> dict[str, Array]:
    """Return contractions (T, M) and their velocities, 1/s, by joint angles (T, J) and the nominal geometry."""
    at_zero = np.array([muscle.contraction_at_angle_0 for muscle in exoskeleton.muscles])
    per_rad = np.array([muscle.contraction_per_rad for muscle in exoskeleton.muscles])
    joint = exoskeleton.joint_of_muscle
    contraction, rate = at_zero + per_rad * angle_rad[:, joint], per_rad * velocity_rad_per_s[:, joint]
    return {"contraction": contraction, "contraction_velocity_per_s": rate}


def read_encoder(angle_rad: Array, encoder: Encoder, noise: Array) -> Array:
    """Return what an encoder shows of true angles: noise, from standard normal numbers, then whole counts."""
    shown = angle_rad + encoder.noise_rad * noise
    if encoder.resolution_rad == 0.0:
        return shown
    return np.asarray(np.round(shown / encoder.resolution_rad) * encoder.resolution_rad)


def _draw_noise(generator: np.random.Generator, muscles: Array, joints: Array, lead: int) -> list[Array]:
    """Return standard normal numbers for pressures, forces and angles, those of the lead-in drawn last."""
    shapes = [muscles.shape[1], muscles.shape[1], joints.shape[1]]
    trial, filling = ([generator.standard_normal((n, k)) for k in shapes] for n in (len(muscles) - lead, lead))
    return [np.concatenate(pair) for pair in zip(list(filling), list(trial), strict=True)]
