"""The best trajectory of a bank with scores of a few, against the scores of all."""

import numpy as np
import pytest

from stages.science.gp import leaders
from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.leaders import Bound, score_leaders
from stages.science.gp.marginal import MarginalGP, condition
from stages.science.gp.scoring import trajectory_utility
from tests.science.gp.data import make_data, make_prior


def make_models(generator, points=50, log_noise=-2.0, mean="zero"):
    prior = make_prior(mean=mean, log_noise=log_noise, variance=0.2)
    return [
        condition(*make_data(generator, points, noise=np.exp(log_noise)), theta, prior, mean)
        for theta in prior.draw(2, generator)
    ]


def make_bank(generator, trajectories=12, samples=60):
    """Two muscles' inputs along movements that start and go where they like."""
    starts = generator.uniform(-1.0, 1.0, (2, trajectories, 1, 3))
    return list(starts + np.cumsum(0.05 * generator.standard_normal((2, trajectories, samples, 3)), axis=2))


def score(models, bank, available=None):
    """Return the scores of leaders, checked against those of all, and these."""
    available = np.arange(len(bank[0])) if available is None else available
    told, every = score_leaders(models, bank, available, 64.0), np.full(len(bank[0]), -np.inf)
    every[available] = trajectory_utility(models, bank, "y_y")[available]
    assert told.argmax() == every.argmax()
    known = np.isfinite(told)
    np.testing.assert_allclose(told[known], every[known], rtol=1e-9)
    return told, every


@pytest.mark.parametrize("log_noise", [-1.0, -2.0, -4.0, -6.0])
@pytest.mark.parametrize("points", [40, 55, 90])
def test_no_sample_tells_more_than_its_bound(points, log_noise, generator):
    for model in make_models(generator, points, log_noise):
        samples = generator.uniform(-2.5, 2.5, (500, 1, 3))
        bounds = Bound(model).of_trajectories(samples, 64.0)
        scores = model.utility(samples[:, 0], "y_y")
        assert (bounds > scores).all()
        assert np.median(bounds / scores) < 1.1
        np.testing.assert_allclose(Bound(model).of_trajectories(samples, 0.1), bounds, rtol=1e-5)


@pytest.mark.parametrize("rest", [0.001, 0.1, 0.4])
def test_bounds_hold_however_few_eigenvectors_are_kept(rest, generator, monkeypatch):
    for name, value in {"REST": rest, "CHANGE": np.inf, "SHARE": 1.0}.items():
        monkeypatch.setattr(leaders, f"LARGEST_{name}", value)
    for own in make_models(generator, 70, -1.0):
        for model in (own, MarginalGP(own.posterior, own.theta, 1e-12 * np.eye(5))):
            samples = generator.uniform(-2.5, 2.5, (2000, 1, 3))
            assert (Bound(model).of_trajectories(samples, 64.0) > model.utility(samples[:, 0], "y_y")).all()


@pytest.mark.parametrize("seed", range(12))
def test_the_best_is_the_same_and_most_are_excluded(seed):
    generator = np.random.default_rng(seed)
    models, bank = make_models(generator, 60), make_bank(generator)
    told, every = score(models, bank)
    assert np.isfinite(told).sum() <= 6
    left = np.setdiff1d(np.arange(12), [int(every.argmax()), 3])
    assert np.isinf(score(models, bank, left)[0][[int(every.argmax()), 3]]).all()


def test_of_nearly_equal_trajectories_the_same_one_is_best(generator):
    models, bank = make_models(generator), make_bank(generator)
    best = int(trajectory_utility(models, bank, "y_y").argmax())
    for shift in (0.0, 1e-15, 1e-12, 1e-7):
        for others in (0, 11, np.arange(12)):
            near = [each.copy() for each in bank]
            for each in near:
                each[others] = each[best] + shift * generator.standard_normal()
            score(models, near)


@pytest.mark.parametrize("case", ["one", "two", "constant", "quiet", "twice", "far", "apart"])
def test_hard_models_choose_the_same(case, generator, monkeypatch):
    monkeypatch.setattr(leaders, "LEAST_POINTS", 1)
    bank = make_bank(generator)
    if case == "twice":
        x, y = make_data(generator, 45)
        theta = np.array([0.0, 0.0, 0.0, 0.0, -20.0])
        models = [condition(np.vstack([x, x]), np.append(y, y), theta, make_prior())] * 2
        assert models[0].jitter
    else:
        points = {"one": 1, "two": 2}.get(case, 45)
        models = make_models(generator, points, {"quiet": -9.0}.get(case, -2.0), {"constant": case}.get(case, "zero"))
    bank = [each * {"far": 1e3, "apart": 5.0}.get(case, 1.0) for each in bank]
    score(models, bank)


def test_asking_for_the_best_alone_is_asking(generator):
    design = Design(
        utility="y_y",
        reduce="sum",
        reuse_trajectories=False,
        mean="zero",
        memory_mb=64.0,
        subsample_utility="y_y",
        points_per_trial=2,
        joint_every=2,
        starts=1,
    )
    bank, prior = make_bank(generator), make_prior()
    data = zip(*(make_data(generator, 50) for _ in bank), strict=True)
    known = Interaction.begin(design, bank, [prior] * 2, *map(list, data), [4], [generator, generator])
    every, few = (known.ask(generator, but=[5], score_all=each) for each in (True, False))
    assert few.trajectory == every.trajectory
    assert np.isfinite(few.scores).sum() < np.isfinite(every.scores).sum() == 10
