"""A trial as physics has it: pressures act on the limb, the person answers, and both decide the motion.

Commands and an intention flow in; pressures, motion and tensions without sensor noise come out. Effects on tension
depend on motion and change it: they are fed back by a fixed number of passes, from motion to deviation from the static
law to motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stages.science.plant.chain import Chain
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.joint import drive_joints, integrate_joints
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

    Commanded pressures are (T, M), kPa gauge, as applied; the joints rest at `start_rad`, (J,), at the first sample,
    each moved by what a person, or nobody, intends there.
    """
    chain = Chain(exoskeleton, plant)
    driven = drive_joints(exoskeleton, plant, chain.constants, person, chain.step_s)
    of_muscle = exoskeleton.joint_of_muscle
    pressure = chain.pressurise(command_kpa)
    deviation = drag = np.zeros_like(pressure)
    for _ in range(1 + plant.relaxation_passes * chain.bends_force):
        angle, velocity = integrate_joints(pressure, deviation, drag, intention, start_rad, of_muscle, driven)
        motion, deviation, drag = follow(chain, of_muscle, pressure, angle, velocity)
    return motion


def follow(
    chain: Chain, of_muscle: ArrayLike, pressure_kpa: Array, angle_rad: Array, velocity_rad_per_s: Array, since: int = 0
) -> tuple[Motion, Array, Array]:
    """Return a trial's motion at pressures (T, M) and joint angles (T, J), and what effects do to its tension.

    Tensions, and what effects add to the tension at the joint, are those from a sample on, (T - since, M): the rest, N,
    less the drag, N s, times contraction velocity.

    The drag is the chord of the deviation over velocity. Friction fed back as a given force swings from pass to pass,
    because at rest it outweighs every other damping; fed back as drag it does not (the iteration of Kachanov for
    monotone materials).
    """
    constants, of_muscle = chain.constants, np.asarray(of_muscle)
    contraction = constants.contraction_at_angle_0 + constants.contraction_per_rad * angle_rad[:, of_muscle]
    rate = constants.contraction_per_rad * velocity_rad_per_s[:, of_muscle]
    if not chain.bends_force:
        force, tension = (each[since:] for each in chain.pull(pressure_kpa, contraction, rate))
        nothing = np.zeros_like(tension)
        motion = Motion(pressure_kpa, contraction, rate, force, tension, angle_rad, velocity_rad_per_s)
        return motion, nothing, nothing
    moving = np.copysign(np.maximum(np.abs(rate), SLOWEST_PER_S), rate)
    rates = np.concatenate([rate, moving, np.zeros_like(moving)], axis=1)
    motions, path = (np.tile(pressure_kpa, 3), np.tile(contraction, 3), rates), chain.repeat(3)
    force, tension = (each[since:] for each in path.pull(*motions))
    added, moved, still = np.split(tension - path.pull_nominally(*(each[since:] for each in motions)), 3, axis=1)
    drag, own = np.maximum((still - moved) / moving[since:], 0.0), slice(len(of_muscle))
    motion = Motion(pressure_kpa, contraction, rate, force[:, own], tension[:, own], angle_rad, velocity_rad_per_s)
    return motion, added + drag * rate[since:], drag
