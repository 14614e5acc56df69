"""A trial as physics has it: pressures act on the limb, the person answers, and both decide the motion.

Commands and an intention flow in; pressures, motion and tensions without sensor noise come out. Effects on tension
depend on motion and change it: they are fed back by a fixed number of passes, from motion to deviation from the static
law to motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.plant.chain import Chain
from stages.plant.exoskeleton import Exoskeleton
from stages.plant.joint import collect_joints, integrate_joints
from stages.plant.participant import Intention, Person
from stages.plant.plant import Plant
from stages.signals.trajectories import Array


@dataclass(frozen=True)
class Motion:
    """What happened, before any sensor saw it; (T, M) per muscle and (T, J) per joint."""

    pressure_kpa: Array
    contraction: Array
    velocity_per_s: Array
    force_n: Array
    tension_n: Array
    joint_angle_rad: Array
    joint_velocity_rad_per_s: Array


def interact(
    exoskeleton: Exoskeleton, plant: Plant, command_kpa: Array, intention: Intention, person: Person, start_rad: Array
) -> Motion:
    """Simulate one trial.

    Parameters
    ----------
    exoskeleton : Exoskeleton
        The machine's rows.
    plant : Plant
        Constants and effects.
    command_kpa : (T, M) ndarray
        Commanded pressure, kPa gauge, as applied.
    intention : Intention
        What the person does.
    person : Person
        Constants of the person, or of nobody.
    start_rad : (J,) ndarray
        Angles at the first sample, at rest.

    Returns
    -------
    Motion
        Tensions follow from the motion returned, by the whole chain.
    """
    chain = Chain(exoskeleton, plant)
    joints = collect_joints(exoskeleton, plant)
    step_s = 1.0 / exoskeleton.sampling_rate_hz
    substeps = max(int(np.ceil(step_s / plant.integration_step_s - 1e-9)), 1)
    pressure = chain.pressurise(command_kpa)
    deviation = np.zeros_like(pressure)
    for _ in range(1 + plant.relaxation_passes * chain.bends_force):
        angle, velocity = integrate_joints(
            pressure, deviation, intention, start_rad, joints, chain.constants, person, step_s, substeps
        )
        contraction = (
            chain.constants.contraction_at_angle_0 + chain.constants.contraction_per_rad * angle[:, joints.muscle_joint]
        )
        rate = chain.constants.contraction_per_rad * velocity[:, joints.muscle_joint]
        force, tension = chain.pull(pressure, contraction, rate)
        deviation = tension - chain.pull_nominally(pressure, contraction, rate)
    return Motion(pressure, contraction, rate, force, tension, angle, velocity)
