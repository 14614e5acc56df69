import numpy as np
import pytest

import stages.science.gp.sparse
from stages.science.gp.cross import DirectCross
from stages.science.gp.factor import FactorisationError
from stages.science.gp.kernel import MEANS
from stages.science.gp.marginal import fit
from stages.science.gp.sparse import SparsePosterior
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_model import SparseGP
from tests.science.gp.data import Dense, differences, make_data, make_prior


def draw(generator, mean, count=40, pseudo_count=6):
    """Return data, pseudo-inputs off them and a theta."""
    x, y = make_data(generator, count)
    pseudo = generator.uniform(-2.0, 2.0, (pseudo_count, 3))
    return x, y, pseudo, make_prior(mean=mean).draw(1, generator)[0]


@pytest.mark.parametrize("with_prior", [True, False])
@pytest.mark.parametrize("mean", MEANS)
def test_gradient_is_the_slope_of_the_value_and_blocks_of_data_add_up(mean, with_prior, generator, monkeypatch):
    monkeypatch.setattr(stages.science.gp.sparse, "BLOCK", 16)
    for _ in range(6):
        x, y, pseudo, theta = draw(generator, mean)
        posterior = SparsePosterior(x, y, make_prior(mean=mean) if with_prior else None, mean)
        found = posterior.derivatives(pseudo, theta)
        assert found.value == posterior.value(pseudo, theta)
        density = posterior.prior.log_density(theta) if with_prior else 0.0
        assert found.value - Dense(x, y, pseudo, theta).log_likelihood == pytest.approx(density, abs=1e-8)
        by_theta = differences(lambda at, p=posterior, z=pseudo: p.value(z, at), theta, 1e-5)
        by_pseudo = differences(
            lambda at, p=posterior, s=pseudo.shape, t=theta: p.value(at.reshape(s), t), pseudo.ravel(), 1e-5
        )
        for ours, theirs in ((found.theta, by_theta), (found.pseudo.ravel(), by_pseudo)):
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5 * np.abs(theirs).max())


def test_data_many_lengths_apart_keep_their_digits(generator):
    x, y, pseudo, _ = draw(generator, "zero", pseudo_count=20)
    x[:20] = pseudo + 1e-6 * generator.standard_normal((20, 3))
    stretch = np.array([1e6, 1.0, 1e-3])
    theta = np.array([np.log(2.0), 0.0, np.log(1e-3), 0.0, -2.0])
    dense = Dense(x * stretch, y, pseudo * stretch, theta)
    posterior = SparsePosterior(x * stretch, y)
    assert isinstance(posterior.condition(pseudo * stretch, theta).cross, DirectCross)
    sparse = SparseGP(posterior, pseudo * stretch, theta)
    assert sparse.log_likelihood == pytest.approx(dense.log_likelihood, abs=1e-7)
    found = posterior.derivatives(pseudo * stretch, theta).theta
    slopes = differences(lambda at: posterior.value(pseudo * stretch, at), theta, 1e-5)
    np.testing.assert_allclose(found, slopes, rtol=1e-5, atol=1e-5 * np.abs(slopes).max())


@pytest.mark.parametrize(("seed", "with_prior"), [(0, True), (1, False)])
def test_a_climb_with_one_more_pseudo_input_never_ends_below_its_start(seed, with_prior):
    generator = np.random.default_rng(seed)
    x, y = make_data(generator, 100)
    prior = make_prior() if with_prior else None
    posterior = SparsePosterior(x, y, prior)
    few = fit_sparse(x, y, 4, prior, generator=generator, starts=1)
    for row in range(2):
        start = np.vstack([few.pseudo, x[row]]), few.theta
        more = fit_sparse(x, y, 5, prior, generator=generator, starts=0, warm_starts=[start])
        assert more.log_posterior > posterior.value(*start)
        held = fit_sparse(x, y, 5, prior, generator=generator, starts=0, warm_starts=[start], hold_pseudo=True)
        np.testing.assert_array_equal(held.pseudo, start[0])
        assert held.log_posterior >= posterior.value(*start)
        still = fit_sparse(x, y, 5, prior, generator=generator, starts=0, warm_starts=[start], iterations=0)
        np.testing.assert_array_equal(still.pseudo, start[0])
        np.testing.assert_array_equal(still.theta, start[1])
        assert more.log_posterior >= held.log_posterior - 1e-6


@pytest.mark.parametrize("mean", MEANS)
def test_a_fit_ends_where_the_likelihood_is_flat(mean, generator):
    x, y = make_data(generator, 150)
    prior = make_prior(mean=mean)
    found = fit_sparse(x, y, 6, prior, mean, generator=generator, starts=1, iterations=2000)
    slopes = SparsePosterior(x, y, prior, mean).derivatives(found.pseudo, found.theta)
    assert slopes.value == found.log_posterior
    assert np.abs(slopes.theta).max() < 0.3
    assert np.abs(slopes.pseudo).max() < 1.0
    start = SparsePosterior(x, y, prior, mean).derivatives(x[:6], prior.mean)
    assert np.abs(start.theta).max() > 30.0


@pytest.mark.parametrize(("seed", "with_prior"), [(0, True), (1, False)])
def test_a_fit_beats_the_exact_gp_of_as_many_rows(seed, with_prior):
    generator = np.random.default_rng(seed)
    x, y = make_data(generator, 600)
    at, truth = make_data(generator, 500, noise=0.0)
    exact = fit(x[:15], y[:15], make_prior(), generator=generator)
    sparse = fit_sparse(x, y, 15, make_prior() if with_prior else None, generator=generator, starts=1)
    errors = [np.sqrt(np.mean((model.predict_mean(at) - truth) ** 2)) for model in (sparse, exact)]
    assert errors[0] < 0.25 * errors[1]
    assert errors[0] < 0.04
    mean, variance = sparse.predict(x)
    assert 0.8 < np.mean((y - mean) ** 2 / (variance + np.exp(2 * sparse.theta[4]))) < 1.2


def test_the_same_generator_gives_the_same_bytes():
    x, y = make_data(np.random.default_rng(0), 200)
    draws = [np.random.default_rng(7) for _ in range(2)]
    first, second = (fit_sparse(x, y, 5, make_prior(), generator=each, starts=2, iterations=30) for each in draws)
    for name in ("pseudo", "theta", "beta", "whiten", "inner"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_duplicate_pseudo_inputs_count_once(generator):
    x, y, pseudo, theta = draw(generator, "zero")
    posterior = SparsePosterior(x, y)
    once, twice = (SparseGP(posterior, each, theta) for each in (pseudo, np.vstack([pseudo, pseudo[:3]])))
    assert twice.log_likelihood == pytest.approx(once.log_likelihood, abs=1e-5)
    for ours, theirs in zip(twice.predict(x), once.predict(x), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    slopes = posterior.derivatives(twice.pseudo, theta)
    np.testing.assert_allclose(slopes.theta, posterior.derivatives(pseudo, theta).theta, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("with_prior", [True, False])
@pytest.mark.parametrize("kind", ["constant column", "one pseudo-input", "as many as data", "repeated", "flat", "two"])
def test_degenerate_data_have_a_sound_fit(kind, with_prior, generator):
    x, y = make_data(generator, 60)
    count = {"one pseudo-input": 1, "as many as data": 60, "two": 2}.get(kind, 5)
    if kind == "constant column":
        x[:, 1] = 0.3
    elif kind == "repeated":
        x, y = np.repeat(x[:4], 15, axis=0), np.repeat(y[:4], 15)
    elif kind == "flat":
        y = np.full(60, 0.5)
    elif kind == "two":
        x, y = x[:2], y[:2]
    found = fit_sparse(
        x, y, count, make_prior(mean="constant") if with_prior else None, "constant",
        generator=generator, starts=1, iterations=50,
    )  # fmt: skip
    points = np.vstack([x, x + 1.0, x + 100.0])
    mean, variance = found.predict(points)
    assert np.isfinite(mean).all()
    assert (variance > 0).all()
    assert (variance <= found.hyperparameters.signal_variance * (1 + 1e-9)).all()
    assert np.isfinite(found.log_posterior)
    if kind in ("repeated", "flat"):
        np.testing.assert_allclose(mean[: len(x)], y, atol=0.2)


def test_noise_far_below_rounding_keeps_the_right_answer(generator):
    x, y, pseudo, theta = draw(generator, "zero")
    theta[4] = -30.0
    dense, sparse = Dense(x, y, pseudo, theta), SparseGP(SparsePosterior(x, y), pseudo, theta)
    assert sparse.log_likelihood == pytest.approx(dense.log_likelihood, rel=1e-6)
    np.testing.assert_allclose(sparse.predict_mean(x), dense.predict(x)[0], atol=1e-5)
    on_data = SparseGP(SparsePosterior(x, y), x, theta)
    np.testing.assert_allclose(on_data.predict_mean(x), y, atol=1e-2)


def test_noise_that_is_too_low_is_named(generator, monkeypatch):
    monkeypatch.setattr(stages.science.gp.sparse, "RELATIVE_JITTER", 0.0)
    x, y, pseudo, theta = draw(generator, "zero")
    theta[:] = [-1.0, -1.0, -1.0, 0.0, -30.0]
    pseudo = np.vstack([x[:1], [[30.0, 30.0, 30.0]]])
    x[:] = x[0]
    told = "noise variance 8.76e-27: too low for 40 data beside a signal variance of 1"
    with pytest.raises(FactorisationError, match=told):
        SparsePosterior(x, y).derivatives(pseudo, theta)
    with pytest.raises(FactorisationError, match="no start has a likelihood that can be evaluated: noise variance"):
        fit_sparse(x, y, 2, None, generator=generator, starts=0, warm_starts=[(pseudo, theta)])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pseudo_count": 0}, "pseudo_count: expected between 1 and 12, the number of data, got 0"),
        ({"pseudo_count": 13}, "pseudo_count: expected between 1 and 12, the number of data, got 13"),
        ({"starts": -1}, "starts: expected at least 0, got -1"),
        ({"starts": 0}, "starts: expected at least 1 without warm starts, got 0"),
        ({"iterations": -1}, "iterations: expected at least 0, got -1"),
        ({"mean": "linear"}, "mean: expected one of zero, constant, got 'linear'"),
        ({"mean": "constant"}, "hyperprior: expected 6 entries for 3 inputs and a constant mean, got 5"),
        ({"inputs": np.full((12, 3), np.nan)}, "expected finite inputs.* in row 0"),
        ({"outputs": np.zeros(3)}, r"expected inputs \(N, D\) and outputs \(N,\)"),
        ({"warm_starts": [(np.zeros((3, 3)), np.zeros(5))]}, "warm start: expected 4 pseudo-inputs, got 3"),
        ({"warm_starts": [(np.zeros((4, 2)), np.zeros(5))]}, r"warm start: expected shape \(B, 3\), got \(4, 2\)"),
        ({"warm_starts": [(np.zeros((4, 3)), np.zeros(6))]}, r"theta: expected 5 entries, got shape \(6,\)"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(changes, told, generator):
    x, y = make_data(generator, 12)
    arguments = {"inputs": x, "outputs": y, "pseudo_count": 4, "prior": make_prior()} | changes
    with pytest.raises(ValueError, match=told) as caught:
        fit_sparse(**arguments, generator=generator)
    assert "\n" not in str(caught.value)


def test_pseudo_inputs_and_points_that_make_no_sense_are_refused(generator):
    x, y, pseudo, theta = draw(generator, "zero")
    posterior = SparsePosterior(x, y)
    for wrong, told in (
        (pseudo[:, :2], r"expected shape \(B, 3\), got \(6, 2\)"),
        (pseudo[:0], "expected at least 1, got none"),
        (np.where(np.arange(6)[:, None] == 2, np.nan, pseudo), r"expected finite values.* in row 2"),
    ):
        with pytest.raises(ValueError, match=f"pseudo-inputs: {told}"):
            posterior.value(wrong, theta)
    model = SparseGP(posterior, pseudo, theta)
    with pytest.raises(ValueError, match=r"points: expected finite values.* in row 0"):
        model.predict(np.full((1, 3), np.inf))
    assert model.predict(np.zeros((0, 3)))[1].shape == (0,)
