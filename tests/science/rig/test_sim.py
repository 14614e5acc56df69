import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from pipeline.table import Table
from stages.science.rig.contract import RECORDING_COLUMNS, tidy
from stages.science.rig.sim import SimulatedRig
from stages.science.rig.trial import Trial
from stages.science.signals.trajectories import pressure_profiles
from tests.science.plant.machines import configured, other_machine, other_rig
from tests.science.rig.watching import execute

LOW, HIGH = [20, 50, 20, 50], [200, 600, 150, 600]


def draw_command(seed, rig, low=LOW, high=HIGH):
    source = np.random.default_rng(seed)
    times = {"hold_s": (0.3, 1.2), "transition_s": (0.2, 0.8)}
    return pressure_profiles(source, low, high, rig.samples, rig.sampling_rate_hz, step_share=0.25, **times)


def as_bytes(recording):
    return b"".join(each.tobytes() for each in vars(recording).values())


def free(rig, seed):
    return execute(rig, Trial("free", "experimenter", draw_command(seed, rig)), seed)


@pytest.mark.parametrize("plant", ["nominal", "rich"])
@pytest.mark.parametrize("machine", [[2, 2], [2, 1, 2]])
@pytest.mark.parametrize("kind", ["free", "tracked", "passive"])
def test_every_kind_gives_the_same_bytes_for_the_same_generator(plant, machine, kind):
    rig = configured(plant) if machine == [2, 2] else other_rig(other_machine(machine, 100.0, 2.5), plant)
    reference = 0.5 + np.linspace(0, 0.4, rig.samples)[:, None] * np.ones(len(rig.joints))
    command = draw_command(4, rig, np.resize(LOW, len(rig.muscles)), np.resize(HIGH, len(rig.muscles)))
    who = {"free": "experimenter", "tracked": "p1", "passive": "nobody"}[kind]
    trial = Trial(kind, who, command, reference if kind == "tracked" else None)
    one, again, other = (execute(rig, trial, seed) for seed in (1, 1, 2))
    assert as_bytes(one) == as_bytes(again) != as_bytes(other)
    assert one.force_n.shape == (rig.exoskeleton.trial_s * rig.sampling_rate_hz, sum(machine))
    assert one.time_s[-1] == pytest.approx(rig.exoskeleton.trial_s - 1.0 / rig.sampling_rate_hz)
    Table("recorded", "A sample", RECORDING_COLUMNS).check(pd.DataFrame(tidy(one, rig)), "here")


@pytest.mark.parametrize("plant", ["nominal", "rich"])
def test_free_movements_are_natural(plant):
    rig = configured(plant)
    recordings = [free(rig, seed) for seed in range(12)]
    angle, velocity, force = (
        np.concatenate([getattr(each, name) for each in recordings])
        for name in ("joint_angle_rad", "joint_velocity_rad_per_s", "force_n")
    )
    lower, upper = np.array([(row.lower_rad, row.upper_rad) for row in rig.exoskeleton.joints]).T
    assert ((angle < lower) | (angle > upper)).mean() < 0.02
    assert (angle > lower - 0.1).all()
    assert (angle < upper + 0.1).all()
    assert (np.ptp(angle, axis=0) > 0.7 * (upper - lower)).all()
    assert (np.percentile(np.abs(velocity), 95, axis=0) < 1.5).all()
    assert np.abs(velocity).max() < 6.0
    assert ((force < 1.0).mean(axis=0) < 0.2).all()


def test_sensors_sample_before_the_command_acts():
    rig = configured()
    command = np.full((rig.samples, 4), 100.0)
    command[400:] = 110.0
    pressure = np.stack([execute(rig, Trial("passive", "nobody", command), seed).pressure_kpa for seed in range(30)])
    mean, noise = pressure.mean(axis=0), 0.4 / np.sqrt(30)
    assert np.abs(mean[:401] - 100.0).max() < 6 * noise
    tau = np.array([rig.plant.find_model(row.name, row.type).valve_tau_s for row in rig.exoskeleton.muscles])
    assert mean[401] == pytest.approx(100.0 + 10.0 * (1 - np.exp(-0.004 / tau)), abs=5 * noise)
    assert pressure[0, :400].std(axis=0) == pytest.approx(0.4, rel=0.15)


def test_participants_differ_in_how_they_track():
    rig = configured()
    references = [free(rig, seed) for seed in range(8)]

    def track(who):
        recordings = [
            execute(rig, Trial("tracked", who, each.pressure_command_kpa, each.joint_angle_rad), 50 + n)
            for n, each in enumerate(references)
        ]
        reached, asked = (np.stack([each.joint_angle_rad for each in its]) for its in (recordings, references))
        miss = [
            np.sqrt(np.mean((reached[:, 120:] - asked[:, 120 - lag : 1000 - lag]) ** 2)) for lag in range(0, 120, 4)
        ]
        return miss[0], 0.016 * int(np.argmin(miss))

    (first_miss, first_lag), (second_miss, second_lag) = track("p1"), track("p2")
    assert 0.05 < first_miss < second_miss < 0.3
    assert 0.1 < first_lag < second_lag < 0.4


def test_a_passive_limb_is_moved_by_pressure_alone():
    rig = configured()
    rest = np.full((rig.samples, 4), 1.0) * [60.0, 200.0, 60.0, 200.0]
    push = rest.copy()
    push[500:, 0] = 160.0
    still, moved = (execute(rig, Trial("passive", "nobody", each)).joint_angle_rad for each in (rest, push))
    assert np.ptp(still[500:], axis=0).max() < 0.05
    assert moved[-1, 0] - still[-1, 0] > 0.1
    assert abs(moved[-1, 1] - still[-1, 1]) < 0.01


def test_contraction_and_velocity_come_from_the_encoder():
    rig = configured()
    recording = free(rig, 6)
    machine = rig.exoskeleton
    for m, row in enumerate(machine.muscles):
        angle = recording.joint_angle_rad[:, machine.joint_names.index(row.joint)]
        expected = row.contraction_at_angle_0 + row.sign * row.moment_arm_m / row.rest_length_m * angle
        assert recording.contraction[:, m] == pytest.approx(expected)
    counts = recording.joint_angle_rad / rig.plant.encoder.resolution_rad
    assert np.abs(counts - np.round(counts)).max() < 1e-6
    change = np.trapezoid(recording.contraction_velocity_per_s, dx=0.004, axis=0)
    assert change == pytest.approx(recording.contraction[-1] - recording.contraction[0], abs=2e-3)


def test_the_load_cell_sees_the_end_of_the_cable_where_it_sits():
    tip = configured("rich")
    values = tip.model_dump()
    values["exoskeleton"]["load_cell_site"] = "joint_end"
    joint = SimulatedRig.model_validate(values)
    trial = Trial("free", "experimenter", draw_command(2, tip))
    at_tip, at_joint = (execute(rig, trial, 9) for rig in (tip, joint))
    assert np.array_equal(at_tip.joint_angle_rad, at_joint.joint_angle_rad)
    moving = (np.abs(at_tip.contraction_velocity_per_s[:, 0]) > 0.05) & (at_tip.force_n[:, 0] > 100.0)
    ratio = np.log(at_joint.force_n[moving, 0] / at_tip.force_n[moving, 0])
    assert ratio == pytest.approx(-0.12 * np.sign(at_tip.contraction_velocity_per_s[moving, 0]), abs=0.05)


def test_the_rich_plant_is_further_from_the_textbook_than_noise():
    rig = configured("rich")
    bent = free(rig, 5).force_n
    calm = rig.model_copy(update={"plant": rig.plant.model_copy(update={"effects": []})})
    plain = free(calm, 5).force_n
    assert np.sqrt(np.mean((bent - plain) ** 2, axis=0)).min() > 5 * 0.3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v.update(gravity=9.8), "gravity"),
        (lambda v: v["participants"].update(nobody=v["experimenter"]), "the name 'nobody' is reserved"),
        (lambda v: v["limits"].pop("MAS-10"), "limits: none for type MAS-10"),
        (lambda v: v["movement"].update(shortest_move_s=3.0), "expected shortest_move_s <= longest_move_s"),
        (lambda v: v["experimenter"].update(gain="high"), "gain"),
        (
            lambda v: v["plant"]["effects"].append({"name": "creep", "muscles": ["pam9"], "share": 0.1, "tau_s": 1.0}),
            "no muscle 'pam9'",
        ),
    ],
)
def test_a_wrong_section_is_refused(change, message):
    values = configured().model_dump()
    change(values)
    with pytest.raises(ValidationError, match=message):
        SimulatedRig.model_validate(values)
