"""What marginal GPs, exact and sparse, tell of points: textbooks, finite differences and formulas."""

import re
from typing import ClassVar

import numpy as np
import pytest

from stages.science.gp.kernel import MEANS
from stages.science.gp.marginal import condition
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.sparse import SparsePosterior
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_marginal import SparseMarginalGP, condition_sparse
from stages.science.gp.sparse_model import predict_weighted
from stages.science.gp.utilities import UTILITIES
from tests.science.gp.data import Dense, Textbook, assert_sound, differences, make_data, make_prior


class Exact:
    """Models of all data, and the textbook's."""

    near: ClassVar = {"rtol": 1e-9, "atol": 1e-10}
    slack: ClassVar = {"rtol": 1e-6, "atol": 1e-8}
    count, pseudo_count = 15, 0

    def condition(self, x, y, pseudo, theta, mean="zero", covariance=None):
        return condition(x, y, theta, make_prior(mean=mean), mean, covariance)

    def truth(self, x, y, pseudo, theta):
        return Textbook(x, y, theta)


class Sparse:
    """Models of pseudo-inputs, and the same by N x N matrices."""

    near: ClassVar = {"rtol": 1e-7, "atol": 1e-8}
    slack: ClassVar = {"rtol": 1e-5, "atol": 1e-6}
    count, pseudo_count, truth = 60, 8, Dense

    def condition(self, x, y, pseudo, theta, mean="zero", covariance=None):
        return SparseMarginalGP(SparsePosterior(x, y, make_prior(mean=mean), mean), pseudo, theta, covariance)


@pytest.fixture(params=[Exact(), Sparse()], ids=["exact", "sparse"])
def way(request, monkeypatch):
    monkeypatch.setattr("stages.science.gp.sparse.BLOCK", 25)
    return request.param


def draw(way, generator, mean="zero", **sizes):
    """Return data, pseudo-inputs off them, and a theta."""
    x, y = make_data(generator, sizes.get("count", way.count))
    pseudo = generator.uniform(-2.0, 2.0, (sizes.get("pseudo_count", way.pseudo_count), 3))
    return x, y, pseudo, make_prior(mean=mean).draw(1, generator)[0]


def places(x, pseudo, generator):
    """Return points among the data, on them, nearly on one, on pseudo-inputs, and far away."""
    far = [[40.0, -30.0, 60.0], [1e3, 0.0, 0.0], [6.0, 6.0, 6.0], [1e50, -1e50, 1e50]]
    return np.vstack([generator.uniform(-2, 2, (20, 3)), x[:6], x[:3] + 1e-7, pseudo[:5], far])


def assert_agrees(way, problem, points, model, **slack):
    """Check mean, variance and their slopes against whole matrices."""
    x, y, pseudo, theta = problem
    for found, expected in zip(model.predict(points), way.truth(*problem).predict(points), strict=True):
        np.testing.assert_allclose(found, expected, **way.near)
    np.testing.assert_allclose(model.predict_mean(points), model.predict(points)[0], **way.near)
    slopes = differences(lambda at: way.truth(x, y, pseudo, at).predict(points), theta, 1e-5)
    for found, expected in zip(model.sensitivities(points), (slopes[:, 0].T, slopes[:, 1].T), strict=True):
        np.testing.assert_allclose(found, expected, **(slack or way.slack))


@pytest.mark.parametrize("mean", MEANS)
def test_predictions_and_their_slopes_are_those_of_whole_matrices(way, mean, generator):
    for sizes in ({}, {}, {}, {"count": 1, "pseudo_count": 1}):
        problem = draw(way, generator, mean, **sizes)
        points = places(problem[0], problem[2], generator)
        assert_agrees(way, problem, points, way.condition(*problem, mean))


def test_inputs_of_many_lengths_keep_their_digits(way, generator):
    x, y, pseudo, _ = draw(way, generator, count=40, pseudo_count=12)
    stretch = np.array([1e6, 1.0, 1e-3])
    far_apart = x * stretch
    theta = np.array([np.log(2.0), 0.0, np.log(1e-3), 0.0, -2.0])
    if isinstance(way, Sparse):
        pseudo, theta[0] = far_apart[:12] + 0.1 * pseudo * stretch, np.log(2e6)
    points = np.vstack([far_apart[:5], far_apart[5:10] + np.array([0.5, 0.3, 3e-4]), pseudo])
    problem = far_apart, y, pseudo, theta
    assert_agrees(way, problem, points, way.condition(*problem), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("log_length", [0.0, -7.0], ids=["expanded", "direct"])
@pytest.mark.parametrize("count", [1, 5, 17, 63, 130])
@pytest.mark.parametrize("constant", [None, 0, 2])
def test_any_size_and_constant_column_agree_with_the_textbook(log_length, count, constant, generator):
    x, y = make_data(generator, count)
    theta = np.array([log_length, log_length, log_length, 0.3, -2.0])
    x *= np.exp(0.3 * log_length) if log_length else 1.0
    if constant is not None:
        x[:, constant] = 0.7
    points = np.vstack([x[:3], x[: min(count, 40)] + 0.4 * np.exp(log_length), generator.uniform(-1.5, 1.5, (9, 3))])
    problem = x, y, None, theta
    assert_agrees(Exact(), problem, points, Exact().condition(*problem), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("log_noise", [-9.0, -14.0, -20.0, -40.0])
def test_at_noiseless_data_utilities_approach_their_limit(log_noise, generator):
    """There V = sn^2 and nothing of it depends on the lengths, so that y/y is 1/2 log((4/3 + 1) / 2) at most."""
    x, y = make_data(generator, 10)
    covariance = 0.1 * np.eye(5)
    model = condition(x, y, np.array([-0.5, -0.5, -0.5, 0.3, log_noise]), make_prior(), covariance=covariance)
    marginal, plain = model.predict_marginal(x)[1], model.predict(x)[1]
    assert (plain <= 1.01 * np.exp(2 * log_noise) + 1e-14).all()
    assert (marginal <= 4 * plain + 1e-12).all()
    assert_sound(model, np.vstack([x, x + 1e-9, x + 1.0]))
    assert model.utility(x, "y_y").max() <= 0.5 * np.log(4)


@pytest.mark.parametrize("mean", MEANS)
def test_pseudo_inputs_on_all_data_make_the_exact_model(mean, generator):
    for theta in make_prior(mean=mean).draw(5, generator):
        x, y = make_data(generator, 30)
        exact, sparse = (each.condition(x, y, x, theta, mean) for each in (Exact(), Sparse()))
        assert sparse.log_posterior == pytest.approx(exact.log_posterior, abs=1e-6)
        assert sparse.sparse.log_likelihood == pytest.approx(exact.posterior.log_likelihood(theta), abs=1e-6)
        np.testing.assert_allclose(sparse.laplace.covariance, exact.laplace.covariance, rtol=1e-4, atol=1e-7)
        assert sparse.repair == exact.repair
        points = places(x, x, generator)
        for name, rtol in (("predict", 1e-7), ("sensitivities", 1e-7), ("predict_marginal", 1e-5)):
            for ours, theirs in zip(getattr(sparse, name)(points), getattr(exact, name)(points), strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=1e-6)
        for name in UTILITIES:
            np.testing.assert_allclose(sparse.utility(points, name), exact.utility(points, name), atol=1e-5)
        expected = trajectory_utility([exact], [points[None]], "y_y")
        np.testing.assert_allclose(trajectory_utility([sparse], [points[None]], "y_y"), expected, rtol=1e-5)


@pytest.mark.parametrize("mean", MEANS)
def test_laplace_covariance_is_the_inverse_of_the_densitys_curvature(mean, generator):
    prior = make_prior(mean=mean)
    x, y = make_data(generator, 300)
    found = fit_sparse(x, y, 10, prior, mean, generator=generator, starts=1)
    model = condition_sparse(x, y, found.pseudo, found.theta, prior, mean)

    def slope(theta):
        return differences(lambda at: model.posterior.value(found.pseudo, at), theta, 1e-3)

    assert model.repair == ""
    precision = -differences(slope, found.theta, 1e-3)
    np.testing.assert_allclose(model.laplace.covariance @ precision, np.eye(len(precision)), atol=1e-2)
    dense = Dense(x, y, found.pseudo, found.theta).log_likelihood + prior.log_density(found.theta)
    assert model.log_posterior == pytest.approx(dense, rel=1e-8)


@pytest.mark.parametrize("given", [False, True], ids=["laplace", "given"])
@pytest.mark.parametrize("mean", MEANS)
def test_marginal_variance_and_utilities_are_the_formulas(way, mean, given, generator):
    """With the slopes and the Laplace approximation that other tests check, or a covariance that takes its place."""
    problem = draw(way, generator, mean)
    points = places(problem[0], problem[2], generator)
    covariance = np.diag(generator.uniform(0.01, 0.1, problem[3].size)) if given else None
    model = way.condition(*problem, mean, covariance)
    dm, dv = model.sensitivities(points)
    predicted, v = model.predict(points)
    s, noise = covariance if given else model.laplace.covariance, model.noise_variance
    q = np.einsum("bp,pq,bq->b", dm, s, dm) + np.einsum("bp,pq,bq->b", dv, s, dv) / (3 * v)
    dl = (dv + 2 * noise * (np.arange(dv.shape[1]) == 4)) / (v + noise)[:, None]
    fisher = np.einsum("bp,bq->bpq", dm, dm) / (v + noise)[:, None, None] + 0.5 * np.einsum("bp,bq->bpq", dl, dl)
    marginal_mean, marginal = model.predict_marginal(points)
    np.testing.assert_allclose(marginal_mean, predicted, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(marginal, 4 / 3 * v + q, rtol=1e-8)
    expected = {
        "y_y": 0.5 * np.log((marginal + noise) / (v + noise)),
        "f_f": 0.5 * np.log(marginal / v),
        "f_y": 0.5 * np.log(marginal / (v + noise)),
        "y_y_theta": 0.5 * np.log1p(q / (v + noise)),
        "hyperparameter_information": 0.5 * np.log1p(np.trace(s @ fisher, axis1=1, axis2=2)),
        "variance": v,
    }
    assert set(expected) == set(UTILITIES)
    for name, values in expected.items():
        np.testing.assert_allclose(model.utility(points, name), values, rtol=1e-8)
    assert not given or model.repair == ""


def test_growing_is_conditioning_on_all_data_with_theta_and_covariance_held(generator):
    x, y, _, theta = draw(Exact(), generator, "constant")
    more, points = make_data(generator, 4), generator.uniform(-2, 2, (10, 3))
    model = Exact().condition(x, y, None, theta, "constant")
    joined = np.vstack([x, more[0]]), np.append(y, more[1])
    whole = Exact().condition(*joined, None, theta, "constant", model.laplace.covariance)
    for ours, expected in zip(model.grow(*more).predict_marginal(points), whole.predict_marginal(points), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-10)


def test_neither_the_memory_bound_nor_working_memory_changes_utilities(generator):
    x, y, pseudo, theta = draw(Sparse(), generator)
    model, points = Sparse().condition(x, y, pseudo, theta), places(x, pseudo, generator)
    expected = model.utility(points, "y_y")
    for memory_mb in (1e-6, 0.01, 1000.0):
        np.testing.assert_allclose(model.utility(points, "y_y", memory_mb), expected, rtol=1e-10)
    late = SparseMarginalGP(model.posterior, pseudo, theta)
    model.posterior.derivatives(pseudo + 0.3, theta - 0.2)
    for each in (model, late):
        np.testing.assert_array_equal(each.utility(points, "y_y"), expected)


def test_the_mean_needs_pseudo_inputs_weights_and_theta_alone(generator):
    x, y, pseudo, theta = draw(Sparse(), generator, "constant")
    model, points = Sparse().condition(x, y, pseudo, theta, "constant"), places(x, pseudo, generator)
    found = predict_weighted(pseudo, model.sparse.weights, theta, points)
    np.testing.assert_array_equal(found, model.predict_mean(points))
    np.testing.assert_allclose(found, Dense(x, y, pseudo, theta).predict(points)[0], atol=1e-8)


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (np.zeros(3), r"shape \(B, 3\), got \(3,\)"),
        (np.zeros((4, 2)), r"shape \(B, 3\), got \(4, 2\)"),
        (np.array([[0.0, 0, 0], [0, np.nan, 0]]), "finite values.* in row 1"),
        (np.full((1, 3), -np.inf), "finite values.* in row 0"),
    ],
)
def test_points_that_make_no_sense_are_refused_and_none_give_nothing(way, points, told, generator):
    model = way.condition(*draw(way, generator))
    asked = [model.predict, model.predict_mean, model.predict_marginal, lambda points: model.utility(points, "y_y")]
    if isinstance(way, Exact):
        asked.append(model.joint_information)
    for evaluate in asked:
        with pytest.raises(ValueError, match=f"points: expected {told}"):
            evaluate(points)
    assert model.predict(np.zeros((0, 3)))[1].shape == (0,)
    assert model.utility(np.zeros((0, 3)), "y_y").shape == (0,)


def test_what_makes_no_sense_is_refused(way, generator):
    x, y, pseudo, theta = draw(way, generator)
    with pytest.raises(ValueError, match=r"theta: expected 5 entries, got shape \(6,\)"):
        way.condition(x, y, pseudo, np.zeros(6))
    with pytest.raises(ValueError, match=r"covariance: expected shape \(5, 5\), got \(4, 4\)"):
        way.condition(x, y, pseudo, theta, covariance=np.eye(4))
    with pytest.raises(ValueError, match=r"utility: expected one of y_y, f_f, .*, variance, got 'entropy'"):
        way.condition(x, y, pseudo, theta).utility(np.zeros((1, 3)), "entropy")


def test_a_sparse_model_needs_a_hyperprior_and_has_no_log_det(generator):
    problem = draw(Sparse(), generator)
    with pytest.raises(ValueError, match="expected a hyperprior"):
        SparseMarginalGP(SparsePosterior(*problem[:2]), *problem[2:])
    told = "utility: log_det takes exact models, got a SparseMarginalGP, which scores points one by one; use one of y_y"
    with pytest.raises(ValueError, match=re.escape(told)):
        trajectory_utility([Sparse().condition(*problem)], [np.zeros((2, 5, 3))], "log_det")
