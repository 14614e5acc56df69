"""Scores of whole trajectories, and samples of a recording picked by their scores."""

import tracemalloc

import numpy as np
import pytest

from stages.science.gp.marginal import MarginalGP, condition, fit
from stages.science.gp.posterior import LogPosterior
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.subsample import subsample
from stages.science.gp.utilities import UTILITIES
from tests.science.gp.data import make_data, make_prior

MB = 2**20


@pytest.fixture
def models(generator):
    prior = make_prior()
    return [
        condition(*make_data(generator, count), theta, prior)
        for count, theta in zip((12, 9, 14), prior.draw(3, generator), strict=True)
    ]


@pytest.fixture
def bank(generator):
    """Three muscles' inputs along seven trajectories of 50 samples."""
    return [np.cumsum(0.3 * generator.standard_normal((7, 50, 3)), axis=1) for _ in range(3)]


@pytest.mark.parametrize("utility", UTILITIES)
def test_scores_are_those_of_a_loop(utility, models, bank):
    bank = [each[:3, :25] for each in bank]
    points = np.empty((3, 3, 25))
    for muscle, trajectory, sample in np.ndindex(points.shape):
        at = bank[muscle][trajectory, sample][None]
        points[muscle, trajectory, sample] = models[muscle].utility(at, utility)[0]
    for reduce in ("sum", "max"):
        expected = getattr(np, reduce)(points, axis=2).sum(axis=0)
        np.testing.assert_allclose(trajectory_utility(models, bank, utility, reduce), expected, rtol=1e-10)


@pytest.mark.parametrize("stride", [1, 7, 10, 50])
def test_log_det_adds_up_over_muscles_and_takes_every_so_many_th_sample(stride, models, bank):
    expected = [
        sum(model.joint_information(inputs[index, ::stride]) for model, inputs in zip(models, bank, strict=True))
        for index in range(7)
    ]
    np.testing.assert_allclose(trajectory_utility(models, bank, "log_det", stride=stride), expected, rtol=1e-12)


@pytest.mark.parametrize("utility", ["y_y", "log_det"])
def test_the_memory_bound_changes_no_score_and_scoring_no_candidate(utility, models, generator):
    bank = [generator.standard_normal((10, 400, 3)) for _ in models]
    before = [each.copy() for each in bank]
    expected = trajectory_utility(models, bank, utility)
    for memory_mb in (0.1, 1000.0):
        np.testing.assert_allclose(trajectory_utility(models, bank, utility, memory_mb=memory_mb), expected, rtol=1e-12)
    np.testing.assert_array_equal(bank, before)


@pytest.mark.parametrize(("memory_mb", "samples"), [(0.5, 1000), (1.0, 1000), (2.0, 1000), (2.0, 8000)])
def test_working_memory_stays_within_its_bound_where_it_would_not(memory_mb, samples, generator):
    theta = np.array([0.0, 0, 0, 0, -2])
    models = [condition(*make_data(generator, 60), theta, make_prior()) for _ in range(2)]
    bank = [generator.standard_normal((5, samples // 5, 3)) for _ in models]

    def peak_mb(bound_mb):
        tracemalloc.start()
        trajectory_utility(models, bank, "y_y", memory_mb=bound_mb)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak / MB

    trajectory_utility(models, [each[:1] for each in bank], "y_y")
    assert peak_mb(memory_mb) <= memory_mb < peak_mb(1e4)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"reduce": "mean"}, "reduce: expected one of sum, max, got 'mean'"),
        ({"utility": "entropy"}, "utility: expected one of .*log_det, got 'entropy'"),
        ({"memory_mb": 0.0}, "memory_mb: expected more than 0, got 0.0"),
        ({"stride": 0}, "stride: expected at least 1, got 0"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(change, told, models, bank):
    with pytest.raises(ValueError, match=told):
        trajectory_utility(models, bank, **{"utility": "y_y", **change})


def test_candidates_that_do_not_fit_or_are_not_finite_are_refused(models, bank):
    for each in (bank[:2], [*bank[:2], bank[2][:5]], [one[0] for one in bank]):
        with pytest.raises(ValueError, match=rf"candidates \(R, T, D\) for each of 3 models, got {len(each)}"):
            trajectory_utility(models, each, "y_y")
    with pytest.raises(ValueError, match=r"expected candidates \(R, T, D\) for each of 0 models"):
        trajectory_utility([], [], "y_y")
    bank[1][3, 20, 2] = np.nan
    for utility in ("y_y", "log_det"):
        with pytest.raises(ValueError, match="points: expected finite values"):
            trajectory_utility(models, bank, utility)


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


def test_recordings_and_counts_that_make_no_sense_are_refused(model, recording):
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
