import numpy as np
import pytest

from stages.science.plant import filters, joint, muscle
from stages.science.plant.chain import Chain
from stages.science.plant.interaction import interact
from stages.science.plant.participant import Intention, embody, intend
from stages.science.signals import operators
from stages.science.signals.trajectories import pressure_profiles
from tests.science.plant.machines import configured, other_machine, with_effects


def draw_intention(who, machine):
    time = np.arange(1000)[:, None] / 250
    reference = 0.6 + 0.4 * np.sin(2 * np.pi * 0.5 * time + np.arange(len(machine.joints)))
    return intend(who, machine, reference, np.random.default_rng(3))


def move(plant, passes=None):
    rig = configured()
    who, machine = rig.participants["p1"], rig.exoskeleton
    times = {"hold_s": (0.3, 1.0), "transition_s": (0.2, 0.6), "step_share": 0.3}
    command = pressure_profiles(np.random.default_rng(3), [20, 50] * 2, [200, 600, 150, 600], 1000, 250.0, **times)
    intention = draw_intention(who, machine)
    plant = plant.model_copy(update={"relaxation_passes": passes or plant.relaxation_passes})
    return interact(machine, plant, command, intention, embody(who, machine), intention.angle_rad[0])


def test_the_passes_converge_and_the_textbook_needs_one():
    plant = configured("rich").plant
    settled = move(plant, 40).joint_angle_rad
    far = [np.abs(move(plant, passes).joint_angle_rad - settled).max() for passes in (1, 2, 4, 6, 10)]
    assert (np.diff(far) < 0).all()
    assert far[-2] < 1e-3
    assert far[-1] < 0.05 * far[0]
    assert np.abs(move(plant, 60).joint_angle_rad - settled).max() < 1e-9
    one, many = (move(configured().plant, passes).joint_angle_rad for passes in (1, 9))
    assert np.array_equal(one, many)


def test_settled_motion_is_that_of_the_tension_it_brings_by_the_whole_chain():
    rig = configured("rich")
    who, machine = rig.participants["p1"], rig.exoskeleton
    settled = move(rig.plant, 40)
    chain, intention = Chain(machine, rig.plant), draw_intention(who, machine)
    force, tension = chain.pull(settled.pressure_kpa, settled.contraction, settled.velocity_per_s)
    assert np.array_equal(force, settled.force_n)
    assert np.array_equal(tension, settled.tension_n)
    given = settled.tension_n - chain.pull_nominally(settled.pressure_kpa, settled.contraction, settled.velocity_per_s)
    inputs = (settled.pressure_kpa, given, np.zeros_like(given), intention, intention.angle_rad[0])
    driven = joint.drive_joints(machine, rig.plant, chain.constants, embody(who, machine), 0.004)
    angle, _ = joint.integrate_joints(*inputs, machine.joint_of_muscle, driven)
    assert np.abs(given).max() > 50.0
    assert angle == pytest.approx(settled.joint_angle_rad, abs=1e-3)


def test_intention_is_delayed_scaled_and_shaky():
    rig = configured()
    who = rig.participants["p2"].model_copy(update={"noise_rad": 0.0})
    time = np.arange(1000) / 250
    reference = np.repeat((0.6 + 0.5 * np.sin(2 * np.pi * 0.5 * time))[:, None], 2, axis=1)
    intention = intend(who, rig.exoskeleton, reference, np.random.default_rng(1))
    joints = rig.exoskeleton.joints
    middle, inertia = np.array([(0.5 * (row.lower_rad + row.upper_rad), row.inertia_kg_m2) for row in joints]).T
    late = round(who.delay_s * 250)
    expected = middle + who.gain * (reference[:-late] - middle)
    assert intention.angle_rad[late:] == pytest.approx(expected, abs=1e-9)
    assert intention.angle_rad[: late + 1] == pytest.approx(np.repeat(intention.angle_rad[:1], late + 1, axis=0))
    shakes = np.stack([intend(who, rig.exoskeleton, reference, np.random.default_rng(n)).push_nm for n in range(20)])
    assert shakes.std(axis=(0, 1)) == pytest.approx(who.tremor_rad_per_s2 * inertia, rel=0.1)


@pytest.mark.parametrize("muscles_of_joint", [[2], [2, 1, 2]])
def test_other_machines_are_rows(muscles_of_joint):
    machine = other_machine(muscles_of_joint, rate=100.0, trial_s=3.0)
    rich = configured("rich").plant
    plant = with_effects(rich, *(each for each in rich.model_dump()["effects"] if not each.get("muscles")))
    count = sum(muscles_of_joint)
    command = np.where(np.arange(300)[:, None] < 100, 120.0, 180.0) * np.ones(count)
    person = embody(configured().participants["p1"], machine)
    steady = Intention(*(np.full((300, len(muscles_of_joint)), value) for value in (0.5, 0.0, 0.0)))
    finer = plant.model_copy(update={"integration_step_s": 2e-4})
    motion, fine = (interact(machine, each, command, steady, person, steady.angle_rad[0]) for each in (plant, finer))
    assert motion.force_n.shape == (300, count)
    assert np.isfinite(motion.force_n).all()
    assert np.ptp(motion.joint_angle_rad, axis=0).min() > 1e-3
    assert fine.joint_angle_rad == pytest.approx(motion.joint_angle_rad, abs=2e-4)


def test_changing_effects_compiles_nothing():
    kernels = [muscle._pull_columns, filters._lag_columns, joint._integrate, operators.follow_stops]
    rich = configured("rich").plant
    move(rich)
    before = [len(kernel.signatures) for kernel in kernels]
    hits = [sum(kernel.stats.cache_misses.values()) for kernel in kernels]
    listed = rich.model_dump()["effects"]
    for chosen in ([], listed[:1], listed[2:4], listed[::-1], listed[4:], [{"name": "none", "muscles": ["pam1"]}]):
        move(with_effects(rich, *chosen))
    assert [len(kernel.signatures) for kernel in kernels] == before == [1, 1, 1, 1]
    assert [sum(kernel.stats.cache_misses.values()) for kernel in kernels] == hits
