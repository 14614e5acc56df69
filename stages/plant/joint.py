"""Motion of the joints: limb, muscles, gravity, friction, end stops and the person, in one compiled integrator.

Pressures and intentions over time flow in; joint angles and velocities come out, by the classical Runge-Kutta rule with
a fixed number of steps per sample. Every term is always there and zero where absent, so that no combination of effects
compiles anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stages.plant.effect import JointEffect
from stages.plant.exoskeleton import Exoskeleton
from stages.plant.muscle import MuscleConstants, pull
from stages.plant.participant import Intention, Person
from stages.plant.plant import Plant
from stages.signals.trajectories import Array


class JointConstants(NamedTuple):
    """Constants of the joints, (J,) arrays, and which muscles sit on which, (M,) array of int."""

    inertia_kg_m2: Array
    gravity_torque_nm: Array
    gravity_zero_rad: Array
    viscous_nm_s_per_rad: Array
    lower_rad: Array
    upper_rad: Array
    stop_nm_per_rad: Array
    stop_nm_s_per_rad: Array
    coulomb_nm: Array
    coulomb_rad_per_s: Array
    muscle_joint: Array


def collect_joints(exoskeleton: Exoskeleton, plant: Plant) -> JointConstants:
    """Return the joints' constants, with what the plant's joint effects add to them."""
    fields = [name for name in JointConstants._fields if not name.startswith("coulomb") and name != "muscle_joint"]
    columns = {name: np.array([getattr(joint, name) for joint in exoskeleton.joints], dtype=float) for name in fields}
    columns["coulomb_nm"] = np.zeros(len(exoskeleton.joints))
    columns["coulomb_rad_per_s"] = np.ones(len(exoskeleton.joints))
    for entry in plant.effects:
        if isinstance(entry.effect, JointEffect):
            chosen = exoskeleton.joint_names if entry.joints is None else entry.joints
            mask = np.array([name in chosen for name in exoskeleton.joint_names])
            for term, value in entry.effect.terms(entry.parameters).items():
                columns[term][mask] = value
    return JointConstants(**columns, muscle_joint=np.array(exoskeleton.joint_of_muscle))


@njit(cache=True, error_model="numpy", inline="always")
def _passive_torque(j, angle, velocity, joints):
    torque = -joints.gravity_torque_nm[j] * np.sin(angle - joints.gravity_zero_rad[j])
    torque -= joints.viscous_nm_s_per_rad[j] * velocity
    if joints.coulomb_nm[j] > 0.0:
        torque -= joints.coulomb_nm[j] * np.tanh(velocity / joints.coulomb_rad_per_s[j])
    over = max(angle - joints.upper_rad[j], 0.0) + min(angle - joints.lower_rad[j], 0.0)
    if over != 0.0:
        torque -= joints.stop_nm_per_rad[j] * over + joints.stop_nm_s_per_rad[j] * velocity
    return torque


@njit(cache=True, error_model="numpy", inline="always")
def _muscle_torque(j, angle, velocity, pressure, deviation, joints, muscles):
    torque = 0.0
    for m in range(pressure.shape[0]):
        if joints.muscle_joint[m] == j:
            tension = pull(
                pressure[m],
                muscles.contraction_at_angle_0[m] + muscles.contraction_per_rad[m] * angle,
                muscles.contraction_per_rad[m] * velocity,
                muscles.area_n_per_kpa[m],
                muscles.braid_a[m],
                muscles.braid_b[m],
                muscles.contraction_factor[m],
                muscles.passive_linear_n[m],
                muscles.passive_quadratic_n[m],
                muscles.damping_n_s[m],
            )
            torque += muscles.torque_arm_m[m] * (tension + deviation[m])
    return torque


@njit(cache=True, error_model="numpy", inline="always")
def _rates(j, angle, velocity, held, pressure, deviation, target, target_velocity, push, joints, muscles, person):
    effort = person.stiffness_nm_per_rad[j] * (target - angle)
    wanted = effort + person.damping_nm_s_per_rad[j] * (target_velocity - velocity) + held
    limit = person.strength_nm[j]
    given = min(max(wanted, -limit), limit)
    held_rate = effort * person.compensation_per_s[j] if given == wanted else 0.0
    torque = _muscle_torque(j, angle, velocity, pressure, deviation, joints, muscles)
    torque += _passive_torque(j, angle, velocity, joints) + given + push
    return torque / joints.inertia_kg_m2[j], held_rate


@njit(cache=True, error_model="numpy")
def _integrate(pressure, deviation, target, target_velocity, push, start, joints, muscles, person, step_s, substeps):
    samples, count = target.shape
    angle, velocity = np.empty((samples, count)), np.empty((samples, count))
    h = step_s / substeps
    p, d = np.empty((3, pressure.shape[1])), np.empty((3, pressure.shape[1]))
    for j in range(count):
        q, w = start[j], 0.0
        held = 0.0
        if person.compensation_per_s[j] > 0.0:
            load = _muscle_torque(j, q, w, pressure[0], deviation[0], joints, muscles) + _passive_torque(
                j, q, w, joints
            )
            held = min(max(-load, -person.strength_nm[j]), person.strength_nm[j])
        angle[0, j], velocity[0, j] = q, w
        for k in range(samples - 1):
            for i in range(substeps):
                for s in range(3):
                    share = (i + 0.5 * s) / substeps
                    for m in range(pressure.shape[1]):
                        p[s, m] = pressure[k, m] + share * (pressure[k + 1, m] - pressure[k, m])
                        d[s, m] = deviation[k, m] + share * (deviation[k + 1, m] - deviation[k, m])
                dq1, dw1, dh1 = 0.0, 0.0, 0.0
                sum_q, sum_w, sum_h = 0.0, 0.0, 0.0
                for stage in range(4):
                    reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                    weight = 1.0 if stage == 0 or stage == 3 else 2.0
                    s = (stage + 1) // 2
                    share = (i + 0.5 * s) / substeps
                    aim = target[k, j] + share * (target[k + 1, j] - target[k, j])
                    aim_rate = target_velocity[k, j] + share * (target_velocity[k + 1, j] - target_velocity[k, j])
                    nudge = push[k, j] + share * (push[k + 1, j] - push[k, j])
                    w_now = w + reach * dw1
                    dw, dh = _rates(
                        j,
                        q + reach * dq1,
                        w_now,
                        held + reach * dh1,
                        p[s],
                        d[s],
                        aim,
                        aim_rate,
                        nudge,
                        joints,
                        muscles,
                        person,
                    )
                    dq1, dw1, dh1 = w_now, dw, dh
                    sum_q += weight * dq1
                    sum_w += weight * dw1
                    sum_h += weight * dh1
                q += h / 6.0 * sum_q
                w += h / 6.0 * sum_w
                held += h / 6.0 * sum_h
            angle[k + 1, j], velocity[k + 1, j] = q, w
    return angle, velocity


def integrate_joints(
    pressure_kpa: Array,
    deviation_n: Array,
    intention: Intention,
    start_rad: Array,
    joints: JointConstants,
    muscles: MuscleConstants,
    person: Person,
    step_s: float,
    substeps: int,
) -> tuple[Array, Array]:
    """Return the motion of the joints from rest.

    Parameters
    ----------
    pressure_kpa : (T, M) ndarray
        Pressure at the sampling instants, kPa gauge; linear between them, as are all inputs.
    deviation_n : (T, M) ndarray
        Tension at the joint beyond the static law, N.
    intention : Intention
        What the person does.
    start_rad : (J,) ndarray
        Angles at the first sample.
    joints : JointConstants
        From `collect_joints`.
    muscles : MuscleConstants
        Of the M muscles.
    person : Person
        Constants of the person; with one who compensates loads, the start is in balance.
    step_s : float
        Time between samples, s.
    substeps : int
        Integration steps per sample.

    Returns
    -------
    tuple of (T, J) ndarray
        Angle, rad, and velocity, rad/s.
    """
    inputs = [np.ascontiguousarray(each, dtype=float) for each in (pressure_kpa, deviation_n, *intention, start_rad)]
    return _integrate(*inputs, joints, muscles, person, step_s, substeps)
