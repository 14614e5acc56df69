"""Motion of the joints: limb, muscles, gravity, friction, end stops and the person, in one compiled integrator.

Pressures and intentions over time flow in; joint angles and velocities come out, by the classical Runge-Kutta rule with
a fixed number of steps per sample. Every term is always there and zero where absent, so that no combination of effects
compiles anew. Joints touch each other through the person alone.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from stages.science.plant.effect import JointEffect
from stages.science.plant.exoskeleton import Exoskeleton, Joint
from stages.science.plant.muscle import MuscleConstants, pull
from stages.science.plant.participant import Intention, Person
from stages.science.plant.plant import Plant
from stages.science.signals.trajectories import Array

STABLE = 2.78
"""Largest product of step and rate at which the classical Runge-Kutta rule does not diverge, on the real axis."""


class JointConstants(NamedTuple):
    """Constants of one joint."""

    inertia_kg_m2: float
    gravity_torque_nm: float
    gravity_zero_rad: float
    viscous_nm_s_per_rad: float
    lower_rad: float
    upper_rad: float
    stop_nm_per_rad: float
    stop_nm_s_per_rad: float
    coulomb_nm: float
    coulomb_rad_per_s: float


class Driven(NamedTuple):
    """One joint, its muscles, who moves it, and how finely it is integrated."""

    joint: JointConstants
    muscles: MuscleConstants
    person: Person
    step_s: float
    substeps: int


def quickest_rate(joint: Joint, person: Person) -> float:
    """Return a bound on the rate of a joint's free motion against its end stop, held by a person, 1/s.

    It is the sum of damping over inertia and of the root of stiffness over inertia, which bounds both roots of the
    characteristic equation. Muscles and friction, which saturate, are left out.
    """
    stiffness = joint.stop_nm_per_rad + person.stiffness_nm_per_rad
    damping = joint.viscous_nm_s_per_rad + joint.stop_nm_s_per_rad + person.damping_nm_s_per_rad
    return damping / joint.inertia_kg_m2 + math.sqrt(stiffness / joint.inertia_kg_m2)


def collect_joints(exoskeleton: Exoskeleton, plant: Plant) -> list[JointConstants]:
    """Return the joints' constants, with what the plant's joint effects add to them."""
    absent = {"coulomb_nm": 0.0, "coulomb_rad_per_s": 1.0}
    own = [name for name in JointConstants._fields if name not in absent]
    rows = {row.name: {name: float(getattr(row, name)) for name in own} | absent for row in exoskeleton.joints}
    for entry in plant.effects:
        if isinstance(entry.effect, JointEffect):
            for name in entry.joints or exoskeleton.joint_names:
                rows[name] |= entry.effect.terms(entry.parameters)
    return [JointConstants(**row) for row in rows.values()]


@njit(cache=True, error_model="numpy")
def _sum_passive_torque(angle: float, velocity: float, joint: JointConstants) -> float:
    """Return the torque of gravity, friction and end stops, N m."""
    torque = -joint.gravity_torque_nm * math.sin(angle - joint.gravity_zero_rad) - joint.viscous_nm_s_per_rad * velocity
    if joint.coulomb_nm > 0.0:
        torque -= joint.coulomb_nm * math.tanh(velocity / joint.coulomb_rad_per_s)
    over = max(angle - joint.upper_rad, 0.0) + min(angle - joint.lower_rad, 0.0)
    if over != 0.0:
        torque -= joint.stop_nm_per_rad * over + joint.stop_nm_s_per_rad * velocity
    return torque


@njit(cache=True, error_model="numpy")
def _sum_muscle_torque(angle: float, velocity: float, inputs: Array, s: int, muscles: MuscleConstants) -> float:
    """Return the torque of a joint's muscles, N m, under row `s` of `inputs` (S, 3, m): pressure, deviation, drag."""
    torque = 0.0
    for m in range(inputs.shape[2]):
        rate = muscles.contraction_per_rad[m] * velocity
        contraction = muscles.contraction_at_angle_0[m] + muscles.contraction_per_rad[m] * angle
        tension = pull(inputs[s, 0, m], contraction, rate, muscles, m)
        torque += muscles.torque_arm_m[m] * (
            tension + inputs[s, 1, m] - inputs[s, 2, m] * muscles.contraction_per_rad[m] * velocity
        )
    return torque


@njit(cache=True, error_model="numpy")
def balance(start: float, drive: Array, driven: Driven) -> float:
    """Return the torque, N m, that a person holds at rest under the first row of `drive` (S, 3, m)."""
    joint, muscles, person, _, _ = driven
    if person.compensation_per_s == 0.0:
        return 0.0
    load = _sum_muscle_torque(start, 0.0, drive, 0, muscles) + _sum_passive_torque(start, 0.0, joint)
    return min(max(-load, -person.strength_nm), person.strength_nm)


@njit(cache=True, error_model="numpy")
def advance(
    state: tuple[float, float, float], drive: Array, aims: Array, k: int, driven: Driven, inputs: Array
) -> tuple[float, float, float]:
    """Return the state, angle, velocity and held torque, one sample after sample `k`.

    `drive` is (S, 3, m) with pressure, deviation and drag, `aims` (S, 3) with intended angle, velocity and push;
    `inputs` (3, 3, m) is overwritten.
    """
    joint, muscles, person, step_s, substeps = driven
    q, w, held = state
    h = step_s / substeps
    for i in range(substeps):
        for s in range(3):
            share = (i + 0.5 * s) / substeps
            for n in range(3):
                for m in range(inputs.shape[2]):
                    inputs[s, n, m] = drive[k, n, m] + share * (drive[k + 1, n, m] - drive[k, n, m])
        dq, dw, dh = 0.0, 0.0, 0.0
        sum_q, sum_w, sum_h = 0.0, 0.0, 0.0
        for stage in range(4):
            reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            weight = 1.0 if stage == 0 or stage == 3 else 2.0
            s = (stage + 1) // 2
            share = (i + 0.5 * s) / substeps
            aim = aims[k, 0] + share * (aims[k + 1, 0] - aims[k, 0])
            aim_rate = aims[k, 1] + share * (aims[k + 1, 1] - aims[k, 1])
            push = aims[k, 2] + share * (aims[k + 1, 2] - aims[k, 2])
            angle, velocity, holds = q + reach * dq, w + reach * dw, held + reach * dh
            effort = person.stiffness_nm_per_rad * (aim - angle)
            wanted = effort + person.damping_nm_s_per_rad * (aim_rate - velocity) + holds
            given = min(max(wanted, -person.strength_nm), person.strength_nm)
            torque = _sum_muscle_torque(angle, velocity, inputs, s, muscles)
            torque += _sum_passive_torque(angle, velocity, joint)
            dq = velocity
            dw = (torque + given + push) / joint.inertia_kg_m2
            dh = effort * person.compensation_per_s if given == wanted else 0.0
            sum_q += weight * dq
            sum_w += weight * dw
            sum_h += weight * dh
        q += h / 6.0 * sum_q
        w += h / 6.0 * sum_w
        held += h / 6.0 * sum_h
    return q, w, held


@njit(cache=True, error_model="numpy")
def _integrate(drive: Array, aims: Array, start: float, driven: Driven) -> tuple[Array, Array]:
    angle, velocity = np.empty(len(aims)), np.empty(len(aims))
    inputs = np.empty((3, 3, drive.shape[2]))
    state = (start, 0.0, balance(start, drive, driven))
    angle[0], velocity[0] = start, 0.0
    for k in range(len(aims) - 1):
        state = advance(state, drive, aims, k, driven, inputs)
        angle[k + 1], velocity[k + 1] = state[0], state[1]
    return angle, velocity


def drive_joints(
    exoskeleton: Exoskeleton, plant: Plant, muscles: MuscleConstants, person: Sequence[Person], step_s: float
) -> list[Driven]:
    """Return each joint with its muscles, of the constants of all, and with the person who moves it."""
    of_muscle, joints = np.array(exoskeleton.joint_of_muscle), collect_joints(exoskeleton, plant)
    own = (MuscleConstants(*(each[of_muscle == j] for each in muscles)) for j in range(len(joints)))
    substeps = plant.count_substeps(step_s)
    return [Driven(*each, step_s, substeps) for each in zip(joints, own, person, strict=True)]


def integrate_joints(
    pressure_kpa: Array,
    deviation_n: Array,
    drag_n_s: Array,
    intention: Intention,
    start_rad: Array,
    joint_of_muscle: Sequence[int],
    driven: Sequence[Driven],
) -> tuple[Array, Array]:
    """Return angle, rad, and velocity, rad/s, of the joints from rest, (T, J) each.

    Of pressures, kPa gauge, and tensions at the joint beyond the static law, N, less a drag, N s, times contraction
    velocity, (T, M) each. All inputs are linear between the sampling instants. The joints start at `start_rad`, (J,),
    in balance where a person compensates loads.
    """
    drive, aims = np.stack([pressure_kpa, deviation_n, drag_n_s], axis=1), np.stack(intention, axis=1)
    of_muscle = np.array(joint_of_muscle)
    angle, velocity = np.empty_like(intention.angle_rad), np.empty_like(intention.angle_rad)
    for j, each in enumerate(driven):
        its_drive, its_aims = np.ascontiguousarray(drive[:, :, of_muscle == j]), np.ascontiguousarray(aims[:, :, j])
        angle[:, j], velocity[:, j] = _integrate(its_drive, its_aims, float(start_rad[j]), each)
    return angle, velocity
