import numpy as np
import pytest

from stages.science.signals.pressures import pressure_profiles
from stages.science.signals.trajectories import connect_points, minimum_jerk, reach_postures

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


def test_minimum_jerk_is_the_polynomial_of_flash_and_hogan_held_at_its_ends():
    share = np.linspace(-0.5, 1.5, 201)
    inside = np.clip(share, 0.0, 1.0)
    assert minimum_jerk(share) == pytest.approx(10 * inside**3 - 15 * inside**4 + 6 * inside**5, abs=1e-12)


def test_points_are_passed_at_their_times():
    points = np.array([[0.0], [2.0], [-1.0]])
    way = connect_points(points, np.array([1.0, 3.0]), np.array([1.0, 0.0]), np.arange(0.0, 5.0, 0.5))
    assert way[:, 0] == pytest.approx([0, 0, 0, 1, 2, 2, -1, -1, -1, -1])


def test_reaches_move_no_faster_than_the_shortest_move_and_differ():
    def draw(seed):
        source = np.random.default_rng(seed)
        return reach_postures(source, [0.1, -0.5], [1.0, 0.5], 1000, 250.0, (0.6, 1.4), (0.0, 0.5))

    way = draw(1)
    assert np.ptp(way, axis=0).min() > 0.1
    assert np.abs(np.diff(way, axis=0)).max() * 250 <= 1.875 * 1.0 / 0.6
    assert way.tobytes() != draw(2).tobytes()
