"""Bent movements: as much is added as the bank's bounds leave room for, and what is added is the spline."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from stages.science.signals.bending import Bending, describe_changes, read_changes, round_coefficients

SAMPLES, WINDOW = 200, 3
JOINTS = {"pam1": "SFE", "pam2": "SFE", "pam3": "EFE"}


def make_bank(seed=3):
    """Return references of four movements; joints' angles are those of their first muscle."""
    generator, share, frames = np.random.default_rng(seed), np.linspace(0.0, 1.0, SAMPLES), []
    for trajectory in range(4):
        phases = {joint: generator.uniform(0.0, 6.0) for joint in ("SFE", "EFE")}
        for muscle, joint in JOINTS.items():
            angle = 0.6 + 0.4 * np.sin(6.0 * share + phases[joint])
            steps = np.repeat(generator.uniform(20.0, 300.0, 4), SAMPLES // 4)
            command = np.convolve(np.pad(steps, 10, mode="edge"), np.full(21, 1.0 / 21.0), mode="valid")
            columns = {"trajectory": trajectory, "muscle": muscle, "time_s": 0.01 * np.arange(SAMPLES)}
            frames.append(pd.DataFrame({**columns, "pressure_command_kpa": command, "joint_angle_rad": angle}))
    return pd.concat(frames, ignore_index=True)


BANK = make_bank()
BENDING = Bending.read(BANK, JOINTS, SAMPLES, WINDOW)


def columns_of(rows):
    command, angle = (rows.pivot(columns="muscle", index="time_s", values=name) for name in rows.columns[-2:])
    return command.to_numpy(), angle.to_numpy()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 3), st.integers(4, 9), st.floats(0.0, 3.0), st.integers(0, 10**6))
def test_nothing_is_asked_beyond_what_the_bank_asks(trajectory, coefficients, size, seed):
    generator = np.random.default_rng(seed)
    sizes = {**dict.fromkeys(JOINTS.values(), size), **dict.fromkeys(JOINTS, 300.0 * size)}
    changes = {name: each * generator.standard_normal(coefficients) for name, each in sizes.items()}
    rows = BANK[BANK["trajectory"] == trajectory]
    bent = BENDING.bend(rows, changes)
    pd.testing.assert_frame_equal(bent.iloc[:, :3], rows.iloc[:, :3])
    whole = [columns_of(each) for _, each in BANK.groupby("trajectory")]
    for number, (found, lag) in enumerate(zip(columns_of(bent), (1, WINDOW), strict=True)):
        of_bank = np.stack([each[number] for each in whole])
        assert (found >= of_bank.min(axis=(0, 1)) - 1e-9).all()
        assert (found <= of_bank.max(axis=(0, 1)) + 1e-9).all()
        fastest = np.abs(of_bank[:, lag:] - of_bank[:, :-lag]).max(axis=(0, 1))
        assert (np.abs(found[lag:] - found[:-lag]) <= fastest + 1e-9).all()
    (pam1, pam2, _) = columns_of(bent)[1].T
    np.testing.assert_array_equal(pam1, pam2)


def test_what_there_is_room_for_is_scipys_spline():
    change = np.array([0.01, -0.02, 0.0, 0.02, 0.01, -0.01])
    knots = [0, 0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1, 1]
    spline = BSpline(knots, change, 3)(np.linspace(0.0, 1.0, SAMPLES))
    angle, command = np.full(SAMPLES, 0.6), np.full(SAMPLES, 100.0)
    np.testing.assert_allclose(BENDING.bend_angle("SFE", angle, change), angle + spline, atol=1e-12)
    np.testing.assert_allclose(BENDING.bend_command("pam1", command, 100 * change), command + 100 * spline, atol=1e-9)


def test_a_joint_is_bent_by_as_much_as_there_is_room_for():
    rows = BANK[(BANK["trajectory"] == 1) & (BANK["muscle"] == "pam3")]
    angle, bound = rows["joint_angle_rad"].to_numpy(), BENDING.bounds["EFE"]
    lifted = BENDING.bend_angle("EFE", angle, np.full(5, 9.0))
    assert lifted.max() == pytest.approx(bound.high)
    np.testing.assert_allclose(np.diff(lifted), np.diff(angle), atol=1e-12)


def test_changes_are_told_in_words_and_read_again():
    drawn = np.random.default_rng(1).standard_normal(4)
    changes = {"SFE": round_coefficients(drawn), "pam1": round_coefficients(1e5 * drawn)}
    told = read_changes(describe_changes(changes))
    assert list(told) == list(changes)
    for name, each in changes.items():
        np.testing.assert_array_equal(told[name], each)
        np.testing.assert_allclose(each, drawn * (1e5 if name == "pam1" else 1.0), rtol=1e-5)
    assert read_changes("") == {}
