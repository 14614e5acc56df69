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
    """Simulate one trial; tensions follow from the motion returned, by the whole chain.

    Parameters
    ----------
    exoskeleton, plant
        The machine's rows; constants and effects.
    command_kpa : (T, M) ndarray
        Commanded pressure, kPa gauge, as applied.
    intention, person
        What the person does; constants of the person, or of nobody, at each joint.
    start_rad : (J,) ndarray
        Angles at the first sample, at rest.
    """
    chain = Chain(exoskeleton, plant)
    joints, of_muscle = collect_joints(exoskeleton, plant), exoskeleton.joint_of_muscle
    step_s = 1.0 / exoskeleton.sampling_rate_hz
    substeps = max(int(np.ceil(step_s / plant.integration_step_s - 1e-9)), 1)
    pressure = chain.pressurise(command_kpa)
    deviation = drag = np.zeros_like(pressure)
    for _ in range(1 + plant.relaxation_passes * chain.bends_force):
        inputs = (pressure, deviation, drag, intention, start_rad)
        angle, velocity = integrate_joints(*inputs, joints, chain.constants, of_muscle, person, step_s, substeps)
        contraction = chain.constants.contraction_at_angle_0 + chain.constants.contraction_per_rad * angle[:, of_muscle]
        rate = chain.constants.contraction_per_rad * velocity[:, of_muscle]
        force, tension, deviation, drag = pull_and_split(chain, pressure, contraction, rate)
    return Motion(pressure, contraction, rate, force, tension, angle, velocity)


def pull_and_split(
    chain: Chain, pressure_kpa: Array, contraction: Array, velocity_per_s: Array, since: int = 0
) -> tuple[Array, Array, Array, Array]:
    """Return the tension, and what effects do to it as a drag and the rest, from a sample of a trial (T, M) on.

    Returns
    -------
    tuple of (T - since, M) ndarray
        Tension at the muscle's tip and at the joint's end, N; rest, N, and drag, N s: what effects add to the tension
        at the joint is the rest less drag times contraction velocity.

    Notes
    -----
    The drag is the chord of the deviation over velocity. Friction fed back as a given force swings from pass to pass,
    because at rest it outweighs every other damping; fed back as drag it does not (the iteration of Kachanov for
    monotone materials).
    """
    moving = np.copysign(np.maximum(np.abs(velocity_per_s), SLOWEST_PER_S), velocity_per_s)
    rates = np.stack([velocity_per_s, moving, np.zeros_like(moving)], axis=1)
    pressures, contractions = (np.repeat(each[:, None], 3, axis=1) for each in (pressure_kpa, contraction))
    force, tension = (each[since:] for each in chain.pull(pressures, contractions, rates))
    added = tension - chain.pull_nominally(*(each[since:] for each in (pressures, contractions, rates)))
    drag = np.maximum((added[:, 2] - added[:, 1]) / moving[since:], 0.0)
    return force[:, 0], tension[:, 0], added[:, 0] + drag * velocity_per_s[since:], drag
