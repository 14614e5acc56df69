import numpy as np
import pytest

from stages.science.signals.pressures import pressure_profiles

TIMES = {"hold_s": (0.3, 1.0), "transition_s": (0.2, 0.6)}


def test_profiles_fill_their_range(generator):
    drawn = [
        pressure_profiles(generator, [20, 50], [200, 600], 1000, 250.0, step_share=0.3, **TIMES) for _ in range(50)
    ]
    profiles = np.concatenate(drawn)
    assert (profiles.min(axis=0) < [30, 75]).all()
    assert (profiles.max(axis=0) > [190, 575]).all()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_share_of_steps_is_kept(generator, share):
    profile = pressure_profiles(generator, 100, 700, 250 * 400, 250.0, step_share=share, **TIMES)[:, 0]
    steps = (np.abs(np.diff(profile)) > 20.0).sum()
    moving = np.abs(np.diff(profile)) > 0.0
    changes = (np.diff(moving.astype(int)) == 1).sum() + moving[0]
    assert steps / changes == pytest.approx(share, abs=0.08)


def test_ramps_are_smooth(generator):
    profile = pressure_profiles(generator, 0, 100, 2000, 250.0, step_share=0.0, **TIMES)
    assert np.abs(np.diff(profile, axis=0)).max() * 250 <= 1.875 * 100 / 0.2 * 1.001


def test_muscles_have_schedules_of_their_own(generator):
    profiles = pressure_profiles(generator, [0, 0], [100, 100], 2000, 250.0, step_share=0.0, **TIMES)
    still = np.diff(profiles, axis=0) == 0.0
    assert (still[:, 0] != still[:, 1]).mean() > 0.1
