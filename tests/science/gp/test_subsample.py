import numpy as np
import pytest

from stages.science.gp.marginal import MarginalGP, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.subsample import subsample
from stages.science.gp.utilities import UTILITIES
from tests.science.gp.data import make_data, make_prior


@pytest.fixture(params=["zero", "constant"])
def model(request, generator):
    return fit(*make_data(generator, 8), make_prior(mean=request.param), request.param, generator=generator)


@pytest.fixture
def recording(generator):
    x, y = make_data(generator, 60)
    return np.vstack([x, x[:5]]), np.append(y, y[:5])


@pytest.mark.parametrize("utility", UTILITIES)
def test_picks_are_those_of_conditioning_from_scratch(utility, model, recording):
    x, y = recording
    picks = []
    for _ in range(5):
        data = np.vstack([model.inputs, x[picks]]), np.append(model.posterior.outputs, y[picks])
        posterior = LogPosterior(*data, model.posterior.prior, model.posterior.mean)
        known = MarginalGP(posterior, model.theta, model.laplace.covariance)
        scores = known.utility(x, utility)
        best = max((index for index in range(len(x)) if index not in picks), key=lambda index: scores[index])
        picks.append(best)
    assert subsample(model, x, y, 5, utility).tolist() == picks


def test_picks_repel_each_other_and_only_their_outputs_are_read(model, recording):
    x, y = recording
    together = subsample(model, x, y, 5, "y_y")
    alone = np.argsort(-model.utility(x, "y_y"), kind="stable")[:5]
    assert together[0] == alone[0]
    assert set(together) != set(alone)
    hidden = np.full_like(y, np.nan)
    hidden[together] = y[together]
    assert (subsample(model, x, hidden, 5, "y_y") == together).all()


def test_no_sample_is_picked_twice_and_none_where_none_is_wanted(model, recording):
    x, y = recording
    assert sorted(subsample(model, x[:12], y[:12], 12, "variance")) == list(range(12))
    picks = subsample(model, x, y, 0, "y_y")
    assert picks.shape == (0,)
    assert picks.dtype == np.intp


def test_what_makes_no_sense_is_refused(model, recording):
    x, y = recording
    shapes = r"expected inputs \(N, D\) and outputs \(N,\), got shapes \(65, 3\) and \(60,\)"
    for outputs, count, told in (
        (np.full_like(y, np.nan), 1, "expected finite outputs, got nan in row 8"),
        (y, -1, "count: expected between 0 and 65 picks, got -1"),
        (y, 66, "count: expected between 0 and 65 picks, got 66"),
        (y[:60], 1, shapes),
    ):
        with pytest.raises(ValueError, match=told):
            subsample(model, x, outputs, count, "y_y")
