import numpy as np
import pytest

from stages.science.signals.trajectories import connect_points, minimum_jerk, reach_postures


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
