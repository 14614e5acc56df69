import numpy as np
import pytest

from stages.science.signals.trajectories import connect_points, minimum_jerk, reach_postures


def test_minimum_jerk_starts_and_ends_at_rest():
    share = np.linspace(0.0, 1.0, 100001)
    way = minimum_jerk(share)
    velocity = np.gradient(way, share)
    acceleration = np.gradient(velocity, share)
    assert way[0] == 0.0
    assert way[-1] == pytest.approx(1.0)
    assert np.abs(velocity[[0, -1]]).max() < 1e-4
    assert np.abs(acceleration[[1, -2]]).max() < 1e-2
    assert velocity.max() == pytest.approx(1.875, rel=1e-6)


def test_minimum_jerk_has_less_jerk_than_a_baseline_with_the_same_ends():
    share = np.linspace(0.0, 1.0, 2001)
    baseline = share**4 * (35 - 84 * share + 70 * share**2 - 20 * share**3)

    def jerk(way):
        return np.mean(np.diff(way, 3)[5:-5] ** 2)

    assert jerk(minimum_jerk(share)) < jerk(baseline)


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
