"""The automatic protocol: slow, within limits, wide, new in each experiment, and one muscle loads the other."""

from itertools import combinations, product

import numpy as np
import pytest
from scipy.stats import qmc

from stages.science.rig.contract import tidy
from stages.science.rig.excitation import Range
from stages.science.rig.passive_trials import Sweeps
from stages.science.rig.reference import replayed_trial
from stages.science.rig.trial import Trial
from tests.science.plant.machines import configured, other_machine
from tests.studies import assert_refused, read_stages, run_stage

STAGES = ["bank", "protocol"]
RANGES = {"pam1": (20.0, 200.0), "pam2": (50.0, 600.0), "pam3": (20.0, 150.0), "pam4": (50.0, 600.0)}
AGONISTS = ["pam1", "pam3"]
LOW, HIGH = np.array(list(RANGES.values())).T


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Three experiments of ten trials, as the stage tells them."""
    study, stages = read_stages(STAGES, "+protocol=default", "protocol.experiments=3", "protocol.trials=10")
    return run_stage(study, stages["protocol"], tmp_path_factory.mktemp("protocol"), {})["protocol_commands"]


@pytest.fixture(scope="module")
def commands(rows):
    """The same as an array (experiment, trial, sample, muscle)."""
    return arrange(rows)


@pytest.fixture(scope="module")
def shares(commands):
    """The same over the ranges of muscles."""
    return (commands - LOW) / (HIGH - LOW)


def arrange(rows):
    counts = rows.groupby(["experiment", "trial", "muscle"])["time_s"].agg(["size", "min", "max"])
    assert (counts == [1000, 0.0, 3.996]).all(axis=None)
    wide = rows.pivot(index=["experiment", "trial", "time_s"], columns="muscle", values="pressure_command_kpa")
    return wide[list(RANGES)].to_numpy().reshape(rows["experiment"].nunique(), -1, 1000, len(RANGES))


def make_sweeps(**changes):
    ranges = {name: Range(low=low, high=high) for name, (low, high) in RANGES.items()}
    return Sweeps(**({"range_kpa": ranges, "sweeps": 2, "levels": 2, "transition_share": 1.0} | changes))


def test_follows_the_design_in_trials_and_experiments():
    study, stages = read_stages(STAGES, "+protocol=default", "active_loop.trials=5", "subsampling.experiments=2")
    found = study.config(stages["protocol"]).protocol
    assert (found.trials, found.experiments) == (5, 2)


def test_stays_within_the_ranges_and_reaches_their_ends_in_every_sweep(shares):
    assert shares.shape == (3, 10, 1000, 4)
    assert shares.min() >= 0.0
    assert shares.max() <= 1.0
    for m, name in enumerate(RANGES):
        swept = shares[:, 0 if name in AGONISTS else 1 :: 2, :, m]
        np.testing.assert_allclose(swept.min(axis=2), 0.0, atol=0.01)
        np.testing.assert_allclose(swept.max(axis=2), 1.0, atol=0.01)


def test_levels_of_the_resisting_muscle_lie_one_in_each_part_of_its_range(shares):
    for m, name in enumerate(RANGES):
        resisting = shares[:, 1 if name in AGONISTS else 0 :: 2, :, m]
        levels = resisting[:, :, [0, -1]].reshape(3, 10)
        np.testing.assert_array_equal(np.sort(np.floor(levels * 10), axis=1), [range(10)] * 3)
        np.testing.assert_allclose(resisting[:, :, [240, 760]], resisting[:, :, [0, -1]], atol=1e-12)


def test_pairs_of_pressures_fill_their_square(shares):
    square = np.stack(np.meshgrid(*[np.linspace(0.05, 0.95, 10)] * 2), axis=-1).reshape(-1, 2)
    for share, first in product(shares, (0, 2)):
        pairs = share[:, ::10, first : first + 2].reshape(-1, 2)
        apart = np.sqrt(((square[:, None] - pairs[None]) ** 2).sum(axis=-1)).min(axis=1)
        assert apart.max() < 0.2
        assert apart.mean() < 0.05
        assert qmc.discrepancy(pairs) < 0.02


def test_is_slow(shares):
    rate = np.abs(np.diff(shares, axis=2)).max() * 250.0
    assert rate <= 15 / 8 / 2.0 + 1e-6  # minimum jerk over the whole range in two seconds


@pytest.mark.parametrize("sweeps", [1, 2, 3, 5])
@pytest.mark.parametrize(("levels", "share"), [(1, 1.0), (2, 0.1), (3, 1.0), (7, 0.5)])
def test_nothing_is_quicker_than_it_says_nor_much_slower(sweeps, levels, share, generator):
    chosen = make_sweeps(sweeps=sweeps, levels=levels, transition_share=share)
    exoskeleton = configured().exoskeleton
    rate = np.abs(np.diff(chosen.draw(exoskeleton, 400, generator), axis=1)).max(axis=(0, 1)) * 250.0
    bound = [chosen.largest_rate_kpa_per_s(name, exoskeleton) for name in RANGES]
    assert (rate <= np.array(bound) * (1 + 1e-9)).all()
    assert (rate > 0.85 * np.array(bound)).all()


def test_experiments_differ_and_seeds_differ(commands, tmp_path):
    for one, other in combinations(commands, 2):
        assert (np.abs(one - other).max(axis=1) > 1.0)[0::2, [1, 3]].all()
    for number, (seed, same) in enumerate([(0, True), (7, False)]):
        line = ("+protocol=default", "protocol.experiments=1", "protocol.trials=10", f"seed={seed}")
        study, stages = read_stages(STAGES, *line)
        again = run_stage(study, stages["protocol"], tmp_path / str(number), {})["protocol_commands"]
        assert np.array_equal(arrange(again)[0], commands[0]) == same


def test_sweeps_go_both_ways_and_begin_at_either_end(commands):
    rising = np.diff(commands[0, 0::2, :, 0], axis=1) > 0
    np.testing.assert_allclose(rising.mean(axis=1), 0.5, atol=0.01)
    np.testing.assert_array_equal(rising[:, 0], [True, False, True, False, True])


def execute(command):
    """Play commands (T, M) on the textbook plant while nobody moves."""
    with configured("nominal") as rig:
        return rig.execute(Trial("passive", "nobody", command), np.random.default_rng(5)).without_lead_in()


def test_muscles_of_a_joint_balance_each_other_and_gravity(commands):
    exoskeleton = configured().exoskeleton
    for trial in commands[1, :4]:
        told = execute(trial)
        angle, velocity = told.joint_angle_rad, told.joint_velocity_rad_per_s
        acceleration = np.gradient(velocity, 1 / 250.0, axis=0)
        for j, joint in enumerate(exoskeleton.joints):
            arms = [each.torque_arm_m for each in exoskeleton.muscles if each.joint == joint.name]
            pulled = told.force_n[:, 2 * j : 2 * j + 2] @ arms
            weight = joint.gravity_torque_nm * np.sin(angle[:, j] - joint.gravity_zero_rad)
            net = joint.inertia_kg_m2 * acceleration[:, j] + joint.viscous_nm_s_per_rad * velocity[:, j]
            free = (angle[:, j] > joint.lower_rad) & (angle[:, j] < joint.upper_rad)
            free[:20] = free[-20:] = False
            assert free.mean() > 0.8
            assert np.sqrt(np.mean((pulled - weight - net)[free] ** 2)) < 0.3
            assert np.abs(pulled).max() > 3.0
            assert (told.force_n >= 0).all()
            assert angle[:, j].min() > joint.lower_rad - 0.01
            assert angle[:, j].max() < joint.upper_rad + 0.01


@pytest.mark.parametrize("muscle", list(RANGES))
def test_the_other_muscle_provides_the_force(muscle):
    at, found = list(RANGES).index(muscle), []  # its force, and how long it is, at one pressure
    for share in (0.1, 0.4, 0.7, 1.0):
        command = np.tile(0.5 * (LOW + HIGH), (1000, 1))
        command[:, at ^ 1] = (LOW + share * (HIGH - LOW))[at ^ 1]  # of the other muscle
        told = execute(command)
        found.append([told.force_n[-200:, at].mean(), -told.contraction[-200:, at].mean()])
    assert (np.diff(found, axis=0) > [5.0, 0.005]).all()


def find_dynamic_shares(commands):
    """Return what depends on velocity and on acceleration over what the agonist pulls, root mean squares, per joint."""
    exoskeleton = configured().exoskeleton
    told = [execute(trial) for trial in commands]
    shares = []
    for m, j in ((0, 0), (2, 1)):
        force = np.concatenate([each.force_n[20:-20, m] for each in told])
        damping = 90.0 * np.concatenate([each.contraction_velocity_per_s[20:-20, m] for each in told])
        swing = [np.gradient(each.joint_velocity_rad_per_s[:, j], 1 / 250.0)[20:-20] for each in told]
        inertial = exoskeleton.joints[j].inertia_kg_m2 * np.concatenate(swing) / exoskeleton.muscles[m].moment_arm_m
        shares += [np.sqrt(np.mean(part**2) / np.mean(force**2)) for part in (damping, inertial)]
    return np.array(shares)


def test_motion_is_quasi_static_and_would_not_be_in_quicker_sweeps(commands, generator):
    assert find_dynamic_shares(commands[2]).max() < 0.1
    quick = make_sweeps(sweeps=10, levels=10, transition_share=0.5)
    assert find_dynamic_shares(quick.draw(configured().exoskeleton, 4, generator)).max() > 0.2


def test_serves_another_machine(generator):
    machine = other_machine([2, 3], 100.0, 2.0)
    ranges = {name: Range(low=10.0, high=100.0) for name in machine.muscle_names}
    sweeps = make_sweeps(range_kpa=ranges)
    sweeps.check_against(machine, "protocol")
    command = sweeps.draw(machine, 3, generator)
    assert command.shape == (3, 200, 5)
    roles = [muscle.role for muscle in machine.muscles]
    assert roles.count("agonist") == 3
    together = [m for m, role in enumerate(roles) if role == "agonist"]
    assert np.ptp(command[0][:, together], axis=1).max() == 0
    assert np.ptp(command[1][:, together], axis=1).min() > 0


def test_a_joint_that_no_second_muscle_loads_is_refused():
    machine = other_machine([2, 1], 100.0, 2.0)
    ranges = {name: Range(low=10.0, high=100.0) for name in machine.muscle_names}
    with pytest.raises(
        ValueError, match=r"^there: expected muscles that pull against .* no antagonist on joint joint1"
    ):
        make_sweeps(range_kpa=ranges).check_against(machine, "there")


def test_a_trial_is_that_of_its_rows_and_the_rig_applies_it_as_it_is(rows, commands):
    rig = configured()
    its = rows[(rows["experiment"] == 2) & (rows["trial"] == 4)]
    trial = replayed_trial(its.sample(frac=1.0, random_state=3), rig, "nobody", "label")
    assert (trial.kind, trial.participant, trial.reference_rad, trial.label) == ("passive", "nobody", None, "label")
    np.testing.assert_array_equal(trial.pressure_command_kpa, commands[1, 3])
    with rig:
        told = tidy(rig.execute(trial, np.random.default_rng(0)).without_lead_in(), rig)
    np.testing.assert_array_equal(told["pressure_command_kpa"], its["pressure_command_kpa"])
    with pytest.raises(ValueError, match=r"expected samples of every muscle .* got none of \['pam2'\]"):
        replayed_trial(its[its["muscle"] != "pam2"], rig, "nobody", "label")


RANGE_KPA = "pam2: {low: 50.0,high: 600.0},pam3: {low: 20.0,high: 150.0},pam4: {low: 50.0,high: 600.0}"


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("protocol.trials=0", "protocol.trials: input should be greater than 0, got 0"),
        ("protocol.experiments=100000", "protocol.experiments: expected at most 4166 of 3 trials, as 50000000 rows"),
        ("protocol.sweeps=501", "protocol.sweeps: expected at most 500 in a trial of 1000 samples, so that each has"),
        ("protocol.levels=1001", "protocol.levels: expected at most one for each of a trial's 1000 samples, got 1001"),
        (
            "protocol.transition_share=0.0",
            "protocol: expected changes within the 4000.0 kPa/s of rig.limits.MAS-40.slew_kpa_per_s, got up to inf "
            "kPa/s for pam1; lower protocol.sweeps or raise protocol.transition_share",
        ),
        ("protocol.sweeps=100", "protocol: expected changes within the 4000.0 kPa/s of rig.limits.MAS-40.slew"),
        (
            "protocol.range_kpa={" + RANGE_KPA + "}",
            "protocol.range_kpa: expected a range for every muscle, none for pam1",
        ),
        (
            "protocol.range_kpa={pam1: {low: 20.0,high: 300.0}," + RANGE_KPA + "}",
            "protocol.range_kpa.pam1.high: expected at most the 250.0 kPa of rig.limits.MAS-40.high_kpa, got 300.0",
        ),
    ],
)
def test_refuses(override, told):
    assert_refused(STAGES, told, "+protocol=default", override)
