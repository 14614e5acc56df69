"""The delays of people and screens, planted in recordings and found again."""

import numpy as np
import pandas as pd
import pytest

from stages.identification.tracking_delay import Config, TrackingDelay, tracking_delay
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.limits import speed_samples
from stages.science.signals.bending import Bending, describe_changes
from tests.science.plant.machines import configured

RATE_HZ, SAMPLES = 250.0, 1000


def move(time_s, joint):
    return 0.6 + 0.3 * np.sin(2 * np.pi * 0.4 * time_s + joint) + 0.15 * np.sin(2 * np.pi * 0.9 * time_s + 2.0 * joint)


def rows_of(rig, delay_s, display_s):
    time_s, frames = np.arange(SAMPLES) / RATE_HZ, []
    for muscle, joint in zip(rig.muscles, rig.muscle_joints, strict=True):
        angle = move(time_s - delay_s, list(rig.joints).index(joint))
        frame = {"time_s": time_s, "muscle": muscle, "joint_angle_rad": angle, "pressure_command_kpa": 100.0}
        frame["reference_shown_s"] = time_s + display_s
        frames.append(pd.DataFrame(frame))
    return pd.concat(frames, ignore_index=True)


def references_of(rig):
    """References of the movement, and of one that is wider and quicker."""
    rows = rows_of(rig, 0.0, 0.0)
    wider = rows.assign(joint_angle_rad=0.6 + 2.0 * (rows["joint_angle_rad"] - 0.6))
    return pd.concat([rows.assign(trajectory=7), wider.assign(trajectory=8)], ignore_index=True)


def find(rig, initial, designed, **chosen):
    where = {"participant": "ann", "experiment": 1}
    exoskeleton: Exoskeleton = rig.exoskeleton
    return tracking_delay.function(
        cfg=Config(tracking_delay=TrackingDelay(longest_s=1.0), exoskeleton=exoskeleton),
        references=references_of(rig),
        hardware_recordings=initial.assign(**where, position=1, trajectory=7),
        active_recordings=designed.assign(**where, arm="y_y", trial=1),
        trials=pd.DataFrame([{**where, "arm": "y_y", "trial": 1, "trajectory": 7, **chosen}]),
        ctx=None,
    ).set_index(["arm", "trial", "joint"])


def test_what_a_screen_delays_is_told_from_what_a_person_does():
    rig = configured("nominal")
    found = find(rig, rows_of(rig, 0.25, 0.05), rows_of(rig, 0.4, np.nan))
    for joint in rig.joints:
        shown, hidden = found.loc[("initial", 1, joint)], found.loc[("y_y", 1, joint)]
        assert shown["delay_s"] == pytest.approx(0.25, abs=0.002)
        assert shown["display_delay_s"] == pytest.approx(0.05, abs=1e-9)
        assert shown["person_delay_s"] == pytest.approx(0.2, abs=0.002)
        assert hidden["delay_s"] == pytest.approx(0.4, abs=0.002)
        assert np.isnan(hidden["display_delay_s"])
        assert np.isnan(hidden["person_delay_s"])


def test_a_bent_movement_is_followed_as_it_was_shown():
    rig = configured("nominal")
    references = references_of(rig)
    joints = dict(zip(rig.muscles, rig.muscle_joints, strict=True))
    bending = Bending.read(references, joints, SAMPLES, speed_samples(RATE_HZ))
    change = {rig.joints[0]: np.array([-0.3, 0.4, -0.5, 0.6, -0.4])}
    bent = bending.bend(references[references["trajectory"] == 7], change).drop(columns="trajectory")
    late = 75
    angle = bent.groupby("muscle", sort=False)["joint_angle_rad"].transform(lambda its: its.shift(late).bfill())
    followed = bent.assign(joint_angle_rad=angle)
    found = find(rig, rows_of(rig, 0.1, 0.0), followed, bent_by=describe_changes(change))
    assert list(found.loc["y_y", "delay_s"]) == pytest.approx([late / RATE_HZ] * 2, abs=0.004)
    shown = find(rig, rows_of(rig, 0.1, 0.0), followed, bent_by="")
    assert shown.loc[("y_y", 1, rig.joints[0]), "delay_s"] != pytest.approx(late / RATE_HZ, abs=0.02)


def test_who_does_not_follow_has_no_delay():
    rig = configured("nominal")
    still = rows_of(rig, 0.0, 0.05).assign(joint_angle_rad=0.5)
    found = find(rig, still, rows_of(rig, 0.1, 0.0))
    assert found.loc["initial", "delay_s"].isna().all()
    assert found.loc["initial", "person_delay_s"].isna().all()
    assert found.loc["y_y", "delay_s"].notna().all()
