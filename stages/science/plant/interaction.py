"""A trial as physics has it: pressures act on the limb, the person answers, and both decide the motion.

Commands and an intention flow in; pressures, motion and tensions without sensor noise come out. Effects on tension
depend on motion and change it: they are fed back by a fixed number of passes, from motion to deviation from the static
law to motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.plant.chain import Chain
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.joint import collect_joints, integrate_joints
from stages.science.plant.participant import Intention, Person
from stages.science.plant.plant import Plant
from stages.science.signals.trajectories import Array

SLOWEST_PER_S = 1e-3


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
    exoskeleton: Exoskeleton,
    plant: Plant,
    command_kpa: Array,
    intention: Intention,
    person: Sequence[Person],
    start_rad: Array,
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
    person : sequence of Person
        Constants of the person, or of nobody, at each joint.
    start_rad : (J,) ndarray
        Angles at the first sample, at rest.

    Returns
    -------
    Motion
        Tensions follow from the motion returned, by the whole chain.
    """
    chain = Chain(exoskeleton, plant)
    joints, of_muscle = collect_joints(exoskeleton, plant), exoskeleton.joint_of_muscle
    step_s = 1.0 / exoskeleton.sampling_rate_hz
    substeps = max(int(np.ceil(step_s / plant.integration_step_s - 1e-9)), 1)
    pressure = chain.pressurise(command_kpa)
    deviation = drag = np.zeros_like(pressure)
    for _ in range(1 + plant.relaxation_passes * chain.bends_force):
        angle, velocity = integrate_joints(
            pressure,
            deviation,
            drag,
            intention,
            start_rad,
            joints,
            chain.constants,
            of_muscle,
            person,
            step_s,
            substeps,
        )
        contraction = chain.constants.contraction_at_angle_0 + chain.constants.contraction_per_rad * angle[:, of_muscle]
        rate = chain.constants.contraction_per_rad * velocity[:, of_muscle]
        deviation, drag = split_deviation(chain, pressure, contraction, rate)
    force, tension = chain.pull(pressure, contraction, rate)
    return Motion(pressure, contraction, rate, force, tension, angle, velocity)


def split_deviation(
    chain: Chain, pressure_kpa: Array, contraction: Array, velocity_per_s: Array
) -> tuple[Array, Array]:
    """Split what effects do to the tension into a drag and the rest.

    Returns
    -------
    tuple of (T, M) ndarray
        Rest, N, and drag, N s: the deviation is the rest less drag times contraction velocity.

    Notes
    -----
    The drag is the chord of the deviation over velocity. Friction fed back as a given force swings from pass to pass,
    because at rest it outweighs every other damping; fed back as drag it does not (the iteration of Kachanov for
    monotone materials).
    """
    moving = np.copysign(np.maximum(np.abs(velocity_per_s), SLOWEST_PER_S), velocity_per_s)
    still = np.zeros_like(velocity_per_s)
    deviations = [
        chain.pull(pressure_kpa, contraction, rate)[1] - chain.pull_nominally(pressure_kpa, contraction, rate)
        for rate in (velocity_per_s, moving, still)
    ]
    drag = np.maximum((deviations[2] - deviations[1]) / moving, 0.0)
    return deviations[0] + drag * velocity_per_s, drag
