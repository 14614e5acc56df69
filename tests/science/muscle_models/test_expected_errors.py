"""The error to be expected, against the error that comes, where models are right about themselves and where not."""

import numpy as np
import pandas as pd
import pytest

from stages.science.gp.marginal import condition
from stages.science.muscle_models.error_rates import ForceTest
from stages.science.muscle_models.expected_errors import ErrorForecast, Spread, forecast_error, thin
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.scaling import MODEL_INPUTS
from tests.science.muscle_models.data import HYPERPARAMETERS, make_tables

SPREAD = Spread(log_sd=0.3, trials=3)


def forecast(ratios):
    """Models that expect 1, where the measured error was so many times the expected one."""
    ratios = np.asarray(ratios)
    left_out = np.column_stack([np.full(len(ratios), 0.1), 0.1 * ratios])
    return ErrorForecast(np.ones(2), np.ones(2), left_out, SPREAD)


def draw_ratios(trials, mean, generator):
    """Draw the SD of the logarithm as the prior says, and so many ratios of it."""
    log_sd = SPREAD.log_sd * np.sqrt(SPREAD.trials / generator.chisquare(SPREAD.trials))
    return np.exp(generator.normal(mean, log_sd, trials))


@pytest.mark.parametrize("trials", [1, 2, 10])
def test_intervals_and_probabilities_hold_what_they_say_of_log_normal_ratios(trials, generator):
    inside, ended = [], []
    for _ in range(2000):
        *ratios, following = draw_ratios(trials + 1, 0.4, generator)
        told = forecast(ratios)
        low, high = told.interval
        inside.append(low < following < high)
        limit = 1.5 * told.median
        if told.probability_below(limit) >= 0.8:
            ended.append((told.probability_below(limit), following < limit))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)
    if trials == 10:
        said, came = np.mean(ended, axis=0)
        assert came == pytest.approx(said, abs=0.03)


def test_probabilities_are_uniform_over_limits_that_come(generator):
    drawn = []
    for _ in range(1000):
        *ratios, following = draw_ratios(5, -0.2, generator)
        drawn.append(forecast(ratios).probability_below(following))
    for share in (0.1, 0.5, 0.9):
        assert np.mean(np.array(drawn) < share) == pytest.approx(share, abs=0.04)


def test_two_trials_that_agree_do_not_make_sure():
    apart = np.diff(np.log(forecast([1.5, 1.5]).interval)), np.diff(np.log(forecast([1.5] * 50).interval))
    assert apart[0] > 1.0
    assert apart[1] < 0.5


def test_gains_are_taken_from_the_variance_of_each_muscle():
    told = ErrorForecast(np.array([3.0, 5.0]), np.array([0.01, 0.02]), np.array([[0.1, 0.2], [0.1, 0.2]]), SPREAD)
    assert told.median == pytest.approx(2 * (0.03 + 0.10) / 2)
    assert told.after(np.array([5.0, 9.0])) == pytest.approx(2 * (0.02 + 0.08) / 2)


def execute(muscles, law, unmodelled_n, generator):
    """Return a trial's recording: a force of three inputs, and one of the trial that no input tells."""
    frames = []
    for name in muscles.names:
        x = generator.uniform(-1.5, 1.5, (60, 3)) * [30.0, 0.05, 0.2] + [100.0, 0.1, 0.0]
        rows = pd.DataFrame(x, columns=list(MODEL_INPUTS)).assign(muscle=name)
        slow = unmodelled_n * np.sin(np.linspace(0.0, 6.0, 60) + generator.uniform(0.0, 6.0))
        noise = 15.0 * np.exp(HYPERPARAMETERS["log_noise_sd"]) * generator.standard_normal(60)
        frames.append(rows.assign(force_n=50.0 + law(*((x - [100.0, 0.1, 0.0]) / [30.0, 0.05, 0.2]).T) + slow + noise))
    return pd.concat(frames, ignore_index=True)


@pytest.mark.parametrize(("unmodelled_n", "surer_than_right"), [(0.0, False), (5.0, True)])
def test_the_error_that_comes_is_the_one_that_was_expected(unmodelled_n, surer_than_right, generator):
    muscles = MuscleSet.read(*(make_tables(generator)[name] for name in ("candidates", "hyperprior", "scaling")))
    theta = np.array(list(HYPERPARAMETERS.values()))
    inside, medians, uncorrected = [], [], []
    for _ in range(8):
        a, b = generator.normal(size=2)
        law = lambda p, c, v, a=a, b=b: 15.0 * (a * np.sin(p) + b * np.cos(c) + 0.3 * v)  # noqa: E731
        trials = [execute(muscles, law, unmodelled_n, generator) for _ in range(13)]
        task = pd.concat(trials[11:])
        points = pd.concat([each.groupby("muscle").head(8).assign(trial=k) for k, each in enumerate(trials[:11])])
        known = zip(*muscles.standardise(points), muscles.priors, strict=True)
        models = [condition(x, y, theta, prior) for x, y, prior in known]
        seen = [thin(each, muscles) for each in trials[1:11]]
        told = forecast_error(models, muscles.inputs_of(task), muscles, points, seen, SPREAD)
        rate = np.mean(ForceTest.read("task", task, muscles).error_rates(models))
        low, high = told.interval
        inside.append(low < rate < high)
        medians.append(told.median / rate)
        uncorrected.append(np.mean(told.rates * told.expected) / rate)
    assert sum(inside) >= 7
    assert np.median(medians) == pytest.approx(1.0, abs=0.15)
    assert (np.median(uncorrected) < 0.7) == surer_than_right
