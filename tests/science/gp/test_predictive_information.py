"""What measurements tell of measurements at a task, against Gaussian conditionals by whole matrices."""

import numpy as np
import pytest

from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.marginal import condition
from stages.science.gp.predictive_information import PREDICTIVE_INFORMATION, TaskInformation
from stages.science.gp.task_utilities import TASK_UTILITIES, task_utility
from tests.science.gp.data import kernel, make_data, make_prior

PICKS = 5


@pytest.fixture
def theta(generator):
    return make_prior().draw(1, generator)[0]


@pytest.fixture
def data(generator):
    return make_data(generator, 9)


@pytest.fixture
def model(data, theta):
    return condition(*data, theta, make_prior())


@pytest.fixture
def task(generator):
    return generator.uniform(-1.5, 1.5, (25, 3))


@pytest.fixture
def trial(generator):
    return np.cumsum(0.4 * generator.standard_normal((30, 3)), axis=0)


def tell(inputs, theta, task, rows):
    """Return the mean of I(y(rows); y(z)) over a task: from joint determinants, p of y(rows), y(z) given the data."""
    noise = np.exp(2 * theta[4])
    told = []
    for z in task:
        points = np.vstack([rows, z])
        across = kernel(points, inputs, theta)
        among = kernel(inputs, inputs, theta) + noise * np.eye(len(inputs))
        joint = kernel(points, points, theta) - across @ np.linalg.solve(among, across.T) + noise * np.eye(len(points))
        parts = np.linalg.slogdet(joint[:-1, :-1])[1] + np.log(joint[-1, -1])
        told.append(0.5 * (parts - np.linalg.slogdet(joint)[1]))
    return np.mean(told)


def test_each_pick_tells_most_given_those_before_and_the_gain_is_their_information(data, theta, model, task, trial):
    picks, told = TaskInformation(model, task).pick(trial, PICKS)
    known = []
    for pick in picks:
        each = [-np.inf if row in known else tell(data[0], theta, task, trial[[*known, row]]) for row in range(30)]
        assert each[pick] == pytest.approx(max(each), rel=1e-9)
        known.append(pick)
    assert len(set(picks)) == PICKS
    assert told == pytest.approx(tell(data[0], theta, task, trial[picks]), rel=1e-9)


def test_a_displaced_pick_is_what_later_ones_are_given(data, theta, model, task, trial):
    picks, told = TaskInformation(model, task).pick(trial, 3, lambda row, taken: (row + 7) % len(trial))
    assert told == pytest.approx(tell(data[0], theta, task, trial[picks]), rel=1e-9)


def test_a_measurement_at_a_single_input_of_the_task_has_a_closed_form(model, task):
    v, noise = model.predict(task[:1])[1][0], model.noise_variance
    told = TaskInformation(model, task[:1]).pick(task[:1], 1)[1]
    assert told == pytest.approx(-0.5 * np.log1p(-((v / (v + noise)) ** 2)), rel=1e-9)


def test_outputs_their_unit_the_order_of_rows_and_copies_of_the_task_tell_nothing(data, theta, model, task, trial):
    picks, told = TaskInformation(model, task).pick(trial, PICKS)
    scaled = theta + np.array([0.0, 0.0, 0.0, np.log(7.0), np.log(7.0)])
    for changed in (
        condition(data[0], np.zeros(9), theta, make_prior()),
        condition(data[0], 7.0 * data[1], scaled, make_prior()),
    ):
        again = TaskInformation(changed, task).pick(trial, PICKS)
        assert list(again[0]) == list(picks)
        assert again[1] == pytest.approx(told, rel=1e-9)
    backward = TaskInformation(model, np.vstack([task[::-1], task])).pick(trial[::-1], PICKS)
    assert list(len(trial) - 1 - backward[0]) == list(picks)
    assert backward[1] == pytest.approx(told, rel=1e-9)


def test_it_weighs_what_is_nearly_known_as_the_mean_variance_does_not():
    x = np.array([[0.0, 0.0, 0.0]])
    model = condition(x, np.zeros(1), np.array([0.0, 0.0, 0.0, 0.0, -2.0]), make_prior())
    task = np.vstack([np.repeat(x, 9, axis=0), [[6.0, 0.0, 0.0]]])
    trial = np.array([[0.0, 0.0, 0.0], [7.2, 0.0, 0.0]])
    chosen = {name: each(model, task).pick(trial, 1)[0][0] for name, each in TASK_UTILITIES.items()}
    assert chosen == {"integrated_variance": 1, "predictive_information": 0}


def test_nearly_noise_free_measurements_stay_finite(data, theta, task):
    sure = condition(*data, np.array([*theta[:4], -20.0]), make_prior())
    picks, told = TaskInformation(sure, task).pick(np.vstack([data[0], task]), 20)
    assert np.isfinite(told)
    assert told > 0.0
    assert set(picks) & set(range(9, 34))


def test_a_trajectory_scores_what_its_picks_tell_added_over_muscles(model, task, generator):
    other = condition(*make_data(generator, 12), make_prior().mean, make_prior())
    banks = [generator.standard_normal((4, 20, 3)) for _ in range(2)]
    expected = sum(
        np.array([TaskInformation(each, task).pick(inputs, 3)[1] for inputs in bank])
        for each, bank in zip((model, other), banks, strict=True)
    )
    scores = task_utility([model, other], [task, task], banks, 3, PREDICTIVE_INFORMATION)
    np.testing.assert_allclose(scores, expected, rtol=1e-9)
    assert np.ptp(scores) > 0.01 * scores.max()


def test_the_loop_chooses_and_takes_samples_by_it(generator, task):
    settings = {"reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 64.0}
    design = Design(PREDICTIVE_INFORMATION, **settings, subsample_utility=PREDICTIVE_INFORMATION, points_per_trial=2,
                    joint_every=2, starts=1)  # fmt: skip
    bank, (x, y) = generator.standard_normal((4, 20, 3)), make_data(generator, 6)
    known = Interaction.begin(design, [bank], [make_prior()], [x], [y], [], [generator], [task])
    model, choice = known.models[0], known.ask(generator)
    told = [tell(x, known.thetas[0], task, each[::2][TaskInformation(model, task).pick(each[::2], 2)[0]])
            for each in bank]  # fmt: skip
    np.testing.assert_allclose(choice.scores, told, rtol=1e-9)
    _, (picks,) = known.tell(choice.trajectory, [bank[1]], [bank[1].sum(axis=1)], [generator])
    assert list(picks) == list(TaskInformation(model, task).pick(bank[1], 2)[0])
