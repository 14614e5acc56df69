import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stages.science.plant.joint import Driven, JointConstants, collect_joints, drive_joints, integrate_joints
from stages.science.plant.muscle import MuscleConstants, compute_tension
from stages.science.plant.participant import Intention, Person, embody
from stages.science.plant.plant import collect_constants
from tests.science.plant.machines import configured, with_effects

NOBODY = Person(0.0, 0.0, 0.0, 0.0)
PENDULUM = JointConstants(0.4, 12.0, 0.0, 0.0, -3.0, 3.0, 1000.0, 5.0, 0.0, 1.0)


def hold(joint, start, samples=1000, person=NOBODY, intended=0.0, push=0.0):
    """Motion of a joint without muscles which a person may hold."""
    none, still = np.zeros((samples, 0)), np.zeros((samples, 1))
    intention = Intention(still + intended, still, still + push)
    nothing = MuscleConstants(*[np.zeros(0)] * len(MuscleConstants._fields))
    driven = [Driven(joint, nothing, person, 0.004, 2)]
    motion = integrate_joints(none, none, none, intention, np.array([start]), [], driven)
    return motion[0][:, 0], motion[1][:, 0]


def test_end_stops_hold():
    stopped = PENDULUM._replace(lower_rad=-0.2, upper_rad=1.2)
    angle, velocity = hold(stopped, 1.0, samples=3000)
    assert -0.45 < angle.min() < -0.2
    energy = 0.5 * stopped.inertia_kg_m2 * velocity**2 - stopped.gravity_torque_nm * np.cos(angle)
    assert energy[-1] < energy[0]


@pytest.mark.parametrize(
    "effects", [[], [{"name": "coulomb_friction", "joints": ["EFE"], "torque_nm": 1.0, "sliding_rad_per_s": 0.2}]]
)
def test_motion_agrees_with_an_adaptive_solver(generator, effects):
    rig = configured()
    machine, plant = rig.exoskeleton, with_effects(rig.plant, *effects)
    muscles, joints = collect_constants(machine, plant), collect_joints(machine, plant)
    person = embody(rig.participants["p1"], machine)
    time = np.arange(250) * 0.004
    wave = 0.6 + 0.4 * np.sin(2 * np.pi * np.array([0.7, 0.9]) * time[:, None] + np.array([0.0, 1.0]))
    intention = Intention(wave, np.gradient(wave, 0.004, axis=0), 0.3 * np.sin(40 * time)[:, None] * np.ones(2))
    pressure = np.array([80.0, 300.0, 60.0, 250.0]) * (1 + 0.3 * np.sin(3 * time[:, None] + np.arange(4)))
    deviation = 20.0 * np.cos(5 * time[:, None] + np.arange(4))
    drag = 40.0 * (1.0 + np.sin(2 * time[:, None] + np.arange(4)))
    start = wave[0] + 0.05
    index = machine.joint_of_muscle

    def at(signal, t):
        return np.array([np.interp(t, time, column) for column in signal.T])

    def torques(t, angle, velocity):
        contraction = muscles.contraction_at_angle_0 + muscles.contraction_per_rad * angle[index]
        rate = muscles.contraction_per_rad * velocity[index]
        pull = compute_tension(at(pressure, t)[None], contraction[None], rate[None], muscles)[0]
        pull = pull + at(deviation, t) - at(drag, t) * rate
        by_muscles = np.bincount(index, weights=muscles.torque_arm_m * pull, minlength=2)
        by_limb = [
            -j.gravity_torque_nm * np.sin(q - j.gravity_zero_rad)
            - j.viscous_nm_s_per_rad * w
            - j.coulomb_nm * np.tanh(w / j.coulomb_rad_per_s)
            for j, q, w in zip(joints, angle, velocity, strict=True)
        ]
        return by_muscles + by_limb

    def rates(t, state):
        angle, velocity, held = state[:2], state[2:4], state[4:]
        stiffness, damping, compensation, _ = np.array(person).T
        effort = stiffness * (at(intention.angle_rad, t) - angle)
        given = effort + damping * (at(intention.velocity_rad_per_s, t) - velocity) + held
        torque = torques(t, angle, velocity) + given + at(intention.push_nm, t)
        return np.concatenate([velocity, torque / [j.inertia_kg_m2 for j in joints], effort * compensation])

    begin = np.concatenate([start, np.zeros(2), -torques(0.0, start, np.zeros(2))])
    truth = solve_ivp(rates, (0, time[-1]), begin, t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.004).y
    driven = drive_joints(machine, plant, muscles, person, 0.004)
    angle, velocity = integrate_joints(pressure, deviation, drag, intention, start, index, driven)
    assert angle == pytest.approx(truth[:2].T, abs=2e-6)
    assert velocity == pytest.approx(truth[2:4].T, abs=2e-5)


@pytest.mark.parametrize(("strength", "height"), [(80.0, np.pi / 2), (20.0, np.arcsin(20.0 / 50.0))])
def test_a_person_is_no_stronger_than_they_are(strength, height):
    joint = PENDULUM._replace(gravity_torque_nm=50.0, viscous_nm_s_per_rad=8.0)
    angle, _ = hold(joint, np.pi / 2, 2000, Person(60.0, 10.0, 3.0, strength), intended=np.pi / 2)
    assert angle[-1] == pytest.approx(height, abs=1e-6 if strength > 50.0 else 1e-3)


def test_an_overcome_person_does_not_wind_up():
    joint = PENDULUM._replace(gravity_torque_nm=0.0, lower_rad=-1.0)
    push = np.where(np.arange(2000)[:, None] < 1000, -60.0, 0.0)
    angle, _ = hold(joint, 0.0, 2000, Person(60.0, 7.0, 3.0, 40.0), push=push)
    assert angle[999] < -0.95
    assert angle[1000:].max() < 0.5
    assert np.abs(angle[1400:]).max() < 0.02
