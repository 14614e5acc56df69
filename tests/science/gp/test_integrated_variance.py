"""What measurements take from the mean variance over a task, against models that are given them."""

from dataclasses import replace

import numpy as np
import pytest

from stages.science.gp.integrated_variance import INTEGRATED_VARIANCE, TaskVariance
from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.knowledge import Choice
from stages.science.gp.marginal import condition
from stages.science.gp.task_utilities import task_utility
from tests.science.gp.data import make_data, make_prior


@pytest.fixture
def model(generator):
    prior = make_prior()
    return condition(*make_data(generator, 9), prior.draw(1, generator)[0], prior)


@pytest.fixture
def task(generator):
    return generator.uniform(-1.5, 1.5, (40, 3))


@pytest.fixture
def trial(generator):
    return np.cumsum(0.4 * generator.standard_normal((30, 3)), axis=0)


def mean_variance(model, task, *rows):
    """Mean of V over a task once a model is given rows, whose outputs do not matter."""
    grown = model.grow(np.array(rows), np.zeros(len(rows))) if rows else model
    return grown.predict(task)[1].mean()


def test_each_pick_is_the_one_after_which_a_grown_model_is_surest(model, task, trial):
    picks, taken = TaskVariance(model, task).pick(trial, 5)
    known = []
    for pick in picks:
        left = [mean_variance(model, task, *known, row) for row in trial]
        left = [np.inf if any(row is each for each in known) else value for row, value in zip(trial, left, strict=True)]
        assert left[pick] == pytest.approx(min(left), rel=1e-9)
        known.append(trial[pick])
    assert len(set(picks)) == 5
    assert taken == pytest.approx(mean_variance(model, task) - mean_variance(model, task, *known), rel=1e-9)


def test_a_displaced_pick_is_what_later_ones_are_given(model, task, trial):
    picks, taken = TaskVariance(model, task).pick(trial, 3, lambda row, taken: (row + 7) % len(trial))
    whole = mean_variance(model, task) - mean_variance(model, task, *trial[picks])
    assert taken == pytest.approx(whole, rel=1e-9)


def test_a_trajectory_scores_what_its_picks_take_added_over_muscles(model, task, generator):
    other = condition(*make_data(generator, 12), make_prior().mean, make_prior())
    banks = [generator.standard_normal((4, 20, 3)) for _ in range(2)]
    expected = sum(
        np.array([TaskVariance(each, task).pick(inputs, 3)[1] for inputs in bank])
        for each, bank in zip((model, other), banks, strict=True)
    )
    scores = task_utility([model, other], [task, task], banks, 3, INTEGRATED_VARIANCE)
    np.testing.assert_allclose(scores, expected, rtol=1e-9)
    assert np.ptp(scores) > 0.01 * scores.max()


def test_the_loop_chooses_the_trajectory_and_takes_the_samples_that_serve_the_task(generator):
    settings = {"reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 64.0}
    design = Design(INTEGRATED_VARIANCE, **settings, subsample_utility=INTEGRATED_VARIANCE, points_per_trial=2,
                    joint_every=1, starts=1)  # fmt: skip
    near, far = np.zeros((20, 3)), np.full((20, 3), 6.0)
    near, far = (each + 0.5 * generator.standard_normal((20, 3)) for each in (near, far))
    bank = [np.stack([far, near])]
    x, y = make_data(generator, 5)
    begun = Interaction.begin(design, bank, [make_prior()], [x + 3.0], [y], [], [generator], [np.zeros((1, 3))])
    choice = begun.ask(generator)
    assert choice.trajectory == 1
    told, (picks,) = begun.tell(1, [near], [near.sum(axis=1)], [generator])
    assert list(picks) == list(TaskVariance(begun.models[0], np.zeros((1, 3))).pick(near, 2)[0])
    assert told.tasks == begun.tasks
    assert len(told.inputs[0]) == 7


def test_a_task_without_inputs_of_another_shape_or_more_picks_than_samples_are_refused(model, task, trial):
    with pytest.raises(ValueError, match="task: expected at least one input, got none"):
        TaskVariance(model, np.empty((0, 3)))
    with pytest.raises(ValueError, match=r"task: expected shape \(B, 3\)"):
        TaskVariance(model, task[:, :2])
    with pytest.raises(ValueError, match="count: expected between 0 and 30 picks, got 31"):
        TaskVariance(model, task).pick(trial, 31)


def test_what_a_trajectory_would_take_is_foreseen_for_each_muscle(model, task, generator):
    settings = {"reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 64.0}
    design = Design(INTEGRATED_VARIANCE, **settings, subsample_utility=INTEGRATED_VARIANCE, points_per_trial=3,
                    joint_every=2, starts=1)  # fmt: skip
    bank, data = generator.standard_normal((4, 20, 3)), make_data(generator, 6)
    known = Interaction.begin(design, [bank], [make_prior()], [data[0]], [data[1]], [], [generator], [task])
    scores = known.ask(generator).scores
    foreseen = [known.foresee(Choice(trajectory, None)) for trajectory in range(4)]
    few = replace(known, design=replace(design, joint_every=100, points_per_trial=50))
    whole = [TaskVariance(known.models[0], task).pick(each, 20)[1] for each in bank]
    np.testing.assert_allclose(few.ask(generator).scores, whole, rtol=1e-9)
    np.testing.assert_allclose(np.ravel(foreseen), scores, rtol=1e-9)
    with pytest.raises(ValueError, match="trajectory: expected 0 to 3"):
        known.foresee(Choice(4, None))


def test_what_all_samples_of_trajectories_take_together_is_what_a_grown_model_has_less(model, task, generator):
    bank = generator.standard_normal((3, 6, 3))
    expected = [mean_variance(model, task) - mean_variance(model, task, *trial) for trial in bank]
    np.testing.assert_allclose(TaskVariance(model, task).gain(bank), expected, rtol=1e-9)


@pytest.mark.parametrize("utility", [INTEGRATED_VARIANCE, "predictive_information", "y_y"])
def test_the_best_exchange_of_inputs_is_found_among_all_combinations(task, generator, utility):
    settings = {"reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 64.0}
    design = Design(utility, **settings, exchanged=(0, 2), subsample_utility=INTEGRATED_VARIANCE, points_per_trial=3,
                    joint_every=1, starts=1)  # fmt: skip
    banks = [generator.standard_normal((3, 3, 3)) + 2.0 * generator.standard_normal((3, 1, 3)) for _ in range(2)]
    (x, y), (u, v) = make_data(generator, 6), make_data(generator, 7)
    priors = [make_prior(), make_prior()]
    starts = [generator, generator]
    known = Interaction.begin(design, banks, priors, [x, u], [y, v], [1], starts, [task, task])
    choice = known.ask(generator)
    plain = replace(known, design=replace(design, exchanged=(), reuse_trajectories=True))
    best = {}
    for sources in np.ndindex(3, 3):
        exchanged = [bank.copy() for bank in banks]
        for bank, whole, source in zip(exchanged, banks, sources, strict=True):
            bank[..., [0, 2]] = whole[source][:, [0, 2]]
        scores = replace(plain, candidates=tuple(exchanged)).ask(generator).scores
        best |= {(trajectory, *sources): scores[trajectory] for trajectory in (0, 2)}
    assert (choice.trajectory, *choice.sources) == max(best, key=best.get)
    assert choice.scores.max() == pytest.approx(max(best.values()), rel=1e-9)
    assert choice.scores[1] == -np.inf
    if utility == INTEGRATED_VARIANCE:
        assert known.foresee(choice).sum() == pytest.approx(max(best.values()), rel=1e-9)


def test_random_trajectories_are_as_they_are(task, generator):
    settings = {"reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 64.0}
    design = Design("random", **settings, exchanged=(1,), subsample_utility="random", points_per_trial=3,
                    joint_every=1, starts=1)  # fmt: skip
    banks = [generator.standard_normal((5, 4, 3)) for _ in range(2)]
    data = make_data(generator, 6)
    known = Interaction.begin(design, banks, [make_prior()] * 2, [data[0]] * 2, [data[1]] * 2, [0], [generator] * 2)
    drawn = [known.ask(np.random.default_rng(seed)) for seed in range(100)]
    assert {each.trajectory for each in drawn} == {1, 2, 3, 4}
    assert {each.sources for each in drawn} == {()}
