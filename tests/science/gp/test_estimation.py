import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from stages.science.gp.estimation import climb, find_map
from stages.science.gp.factor import FactorisationError
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import fit
from stages.science.gp.posterior import LogPosterior
from tests.science.gp.data import Textbook, make_data, make_prior


@pytest.mark.parametrize(
    ("count", "mean"), [(6, "zero"), (15, "zero"), (15, "constant"), (25, "zero"), (80, "constant")]
)
def test_the_search_is_never_worse_than_scipy_from_many_starts(count, mean, generator):
    x, y = make_data(generator, count)
    prior = make_prior(mean=mean, variance=1.0)

    def objective(theta):
        return -Textbook(x, y, theta).log_likelihood - norm(prior.mean, np.sqrt(prior.variance)).logpdf(theta).sum()

    bounds = [(centre - 4, centre + 4) for centre in prior.mean]
    best = min(
        minimize(objective, start, method="L-BFGS-B", bounds=bounds).fun
        for start in [prior.mean, *prior.draw(8, generator)]
    )
    found = fit(x, y, prior, mean, generator=generator)
    assert -found.log_posterior <= best + 1e-6
    assert objective(found.theta) == pytest.approx(-found.log_posterior, abs=1e-7)


def test_the_higher_of_two_modes_is_found(generator):
    """Data that a short signal explains, or noise."""
    y = np.array([0.5, -0.6, 0.55, -0.4, 0.62, -0.5, 0.45, -0.58, 0.5])
    two_modes = LogPosterior(np.linspace(-2, 2, 9)[:, None], y, Hyperprior(np.array([0.5, -0.5, -1.5]), np.ones(3)))
    short, noisy = climb(two_modes, np.array([-1.5, -0.7, -4.0])), climb(two_modes, np.array([1.5, -1.5, -0.7]))
    assert abs(short.value - noisy.value) > 0.1
    assert max(short.gradient_norm, noisy.gradient_norm) < 1e-6
    lower = min(short, noisy, key=lambda each: each.value)
    found = find_map(two_modes, generator, 12, warm_starts=[lower.theta])
    assert found.value == pytest.approx(max(short.value, noisy.value), abs=1e-9)


def test_the_search_is_determined_by_its_generator(generator):
    posterior = LogPosterior(*make_data(generator, 20), make_prior())
    first, second = (find_map(posterior, np.random.default_rng(5), 8) for _ in range(2))
    assert first.theta.tobytes() == second.theta.tobytes()
    draws, untouched = np.random.default_rng(5), np.random.default_rng(5)
    find_map(posterior, draws, 8)
    untouched.standard_normal((8, 5))
    assert draws.standard_normal() == untouched.standard_normal()


def test_all_starts_end_at_the_same_maximum_to_rounding(generator):
    posterior = LogPosterior(*make_data(generator, 30), make_prior(variance=0.05))
    ends = np.array([climb(posterior, start).theta for start in posterior.prior.draw(6, generator)])
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], ends.shape), atol=1e-7)


def test_a_saddle_is_left():
    x = np.array([[-1.0], [1.0]])
    posterior = LogPosterior(x, np.array([1.0, -1.0]), Hyperprior(np.zeros(3), np.array([1.0, 1.0, 1.0])))
    found = climb(posterior, np.array([3.0, 0.0, 0.0]))
    assert np.linalg.eigvalsh(posterior.derivatives(found.theta)[2]).max() < 0


def test_starts_that_are_out_of_range_or_cannot_be_factorised_are_passed_over(generator):
    x, y = make_data(generator, 10)
    x[4] = x[3]
    posterior = LogPosterior(x, y, make_prior())
    wide = find_map(LogPosterior(x, y, make_prior(variance=1e4)), generator, 30)
    assert np.isfinite(wide.theta).all()
    assert wide.gradient_norm < 1e-6
    lost = np.array([0.0, 0.0, 0.0, 40.0, -49.0])
    absurd = np.array([0.0, 0.0, 0.0, 400.0, -490.0])
    found = find_map(posterior, generator, 2, warm_starts=[absurd, lost])
    assert found.gradient_norm < 1e-6
    assert found.value == pytest.approx(find_map(posterior, generator, 8).value, abs=1e-9)


def test_no_start_is_said(generator):
    x, y = make_data(generator, 10)
    prior = Hyperprior(np.array([0.0, 0.0, 0.0, 300.0, 0.0]), np.full(5, 1e-4))
    with pytest.raises(FactorisationError, match=r"expected logarithms between -50 and 50, got .*300"):
        fit(x, y, prior, generator=generator)
