"""Concentration of choices against exact enumeration."""

from itertools import combinations, product

import numpy as np
import pytest

from stages.science.statistics.concentration import Choices, judge_concentration

OPTIONS = 5


def choices(chosen, excluded=(), again=False, options=OPTIONS):
    return Choices(np.array(chosen), np.setdiff1d(np.arange(options), excluded), again)


def enumerate_dispersions(experiments, again=False):
    """Return the dispersion of every equally likely outcome of choosing at random."""
    every = [
        list(product(each.available, repeat=each.chosen.size))
        if again
        else list(combinations(each.available, each.chosen.size))
        for each in experiments
    ]
    counts = np.array([np.bincount(np.concatenate(outcome), minlength=OPTIONS) for outcome in product(*every)])
    expected = counts.mean(axis=0)
    return ((counts - expected) ** 2 / np.where(expected, expected, 1)).sum(axis=1), expected


@pytest.mark.parametrize("again", [False, True])
def test_agrees_with_the_enumeration_of_all_outcomes(again, generator):
    excluded = [()] * 3 if again else [(0,), (4,), (0, 1)]
    chosen = [(1, 2), (1, 2), (2, 3)]
    experiments = [choices(*each, again) for each in zip(chosen, excluded, strict=True)]
    every, expected = enumerate_dispersions(experiments, again)
    counts = np.bincount(np.concatenate(chosen), minlength=OPTIONS)
    dispersion = ((counts - expected) ** 2 / expected).sum()
    told = judge_concentration(experiments, OPTIONS, 40_000, generator)
    p = (every >= dispersion - 1e-9).mean()
    assert told.n == 3
    assert told.dispersion == pytest.approx(dispersion, rel=1e-12)
    assert told.p == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 40_000))
    assert 0.05 < p < 0.95
    assert told.expected == pytest.approx(every.mean(), rel=0.02)
    assert told.effect == pytest.approx(dispersion / every.mean(), rel=0.02)
    for end, share in ((told.low, 0.025), (told.high, 0.975)):
        assert (every < end - 1e-9).mean() <= share + 0.005
        assert (every <= end + 1e-9).mean() >= share - 0.005


def test_experiments_that_choose_alike_have_the_smallest_p(generator):
    excluded = [generator.choice(30, 2, replace=False) for _ in range(12)]
    liked = [generator.choice(np.setdiff1d(np.arange(8), each), 5, replace=False) for each in excluded]
    experiments = [choices(*each, options=30) for each in zip(liked, excluded, strict=True)]
    alike = judge_concentration(experiments, 30, 400, generator)
    assert (alike.p, alike.dispersion > alike.high) == (1 / 401, True)


def test_one_experiment_is_as_concentrated_as_any(generator):
    told = judge_concentration([choices([1, 3], (0,))], OPTIONS, 100, generator)
    assert told.p == 1.0
    assert told.effect == pytest.approx(1.0)


def test_choosing_all_that_is_there_says_nothing(generator):
    told = judge_concentration([choices([1, 2, 3, 4], (0,))] * 2, OPTIONS, 100, generator)
    assert (told.dispersion, told.expected, told.p) == (0.0, 0.0, 1.0)
    assert np.isnan(told.effect)


def test_blocks_change_nothing_but_the_order_of_draws(generator, monkeypatch):
    experiments = [choices([1, 2], (0,)), choices([1, 2], (4,)), choices([1, 3], (2,))]
    whole = judge_concentration(experiments, OPTIONS, 20_000, generator)
    monkeypatch.setattr("stages.science.statistics.concentration.LARGEST_BLOCK", 3000)
    blocks = judge_concentration(experiments, OPTIONS, 20_000, generator)
    assert blocks.dispersion == whole.dispersion
    assert blocks.p == pytest.approx(whole.p, abs=0.02)
    assert blocks.expected == pytest.approx(whole.expected, rel=0.02)
