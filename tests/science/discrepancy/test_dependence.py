"""On what a residual depends: planted surfaces are found, with their inputs and where they lie; noise is left alone."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.discrepancy.dependence import find_dependence, find_range, fit_gaussian_process
from stages.science.discrepancy.description import measure_share
from stages.science.discrepancy.resampling import resample
from stages.science.output_channels.output_channel import Driver
from tests.science.discrepancy.searches import DESCRIPTION
from tests.science.discrepancy.toys import make_toy

NOISE = 0.1
TRIALS = 10


class Aside:
    """A toy beside which something else was measured."""

    def __init__(self, toy, **signals):
        self.toy, self.signals = toy, signals

    def __getattr__(self, name):
        return getattr(self.toy, name)

    def drivers(self):
        return [*self.toy.drivers(), *(Driver(name, values, own=False) for name, values in self.signals.items())]


def plant(seed, surface, noise=NOISE):
    """An output, its residual, and the residual without noise; two more signals were measured beside."""
    generator = np.random.default_rng(seed)
    output = make_toy(seed, trials=TRIALS)
    smooth = np.cumsum(generator.standard_normal((2, *output.x.shape)), axis=1) / 10.0
    output = Aside(output, pressure_kpa=smooth[0], tension_n=smooth[1])
    truth = surface(output.x, smooth[0], output.drivers()[1].values)
    return output, truth + noise * generator.standard_normal(truth.shape), truth


def measure(residual, left):
    weights = resample(TRIALS, 400, np.random.default_rng(0))
    return measure_share((residual**2).sum(axis=0), (left**2).sum(axis=0), weights, 0.95)


@pytest.mark.parametrize(
    ("surface", "inputs"),
    [
        (lambda x, p, v: 0.3 * np.sin(4.0 * x), ["x"]),
        (lambda x, p, v: 0.05 * v * np.abs(v) / 4.0, ["x_rate"]),
        (lambda x, p, v: 0.3 * np.tanh(p), ["pressure_kpa"]),
        (lambda x, p, v: 0.3 * np.sin(4.0 * x) + 0.1 * p, ["pressure_kpa", "x"]),
    ],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_inputs_and_share_are_those_planted(seed, surface, inputs):
    output, residual, truth = plant(seed, surface)
    found = find_dependence(output, residual, DESCRIPTION, np.random.default_rng(0))
    assert sorted(each.name for each in found.inputs) == inputs
    share = measure(residual, residual - found.heldout)
    possible = (truth**2).sum() / (residual**2).sum()
    assert 0.8 * possible < share.value < 1.05 * possible
    assert 0.0 < share.low < share.value < share.high
    assert np.sqrt(np.mean((found.mean - truth) ** 2)) < 0.5 * NOISE


def test_two_signals_that_tell_something_only_together_are_found():
    output, residual, truth = plant(1, lambda x, p, v: 0.1 * np.sin(4.0 * x) * v)
    found = find_dependence(output, residual, DESCRIPTION, np.random.default_rng(0))
    assert "x" in [each.name for each in found.inputs]
    share = measure(residual, residual - found.heldout)
    assert share.value > 0.7 * (truth**2).sum() / (residual**2).sum()


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_left_alone(seed):
    output, residual, _ = plant(seed, lambda x, p, v: 0.0 * x)
    residual += 0.05 * np.random.default_rng(seed).standard_normal(TRIALS)
    found = find_dependence(output, residual, DESCRIPTION, np.random.default_rng(0))
    share = measure(residual, residual - found.heldout)
    assert not found.inputs or share.low <= 0.0
    assert share.value < 0.1


def test_a_trial_has_no_part_in_what_is_said_of_it():
    output, residual, _ = plant(3, lambda x, p, v: 0.3 * np.sin(4.0 * x))
    spoilt = residual.copy()
    spoilt[:, 4] += 0.2
    alone = DESCRIPTION.model_copy(update={"most_inputs": 1})
    kept, other = (
        find_dependence(output, each, alone, np.random.default_rng(0)).heldout for each in (residual, spoilt)
    )
    np.testing.assert_allclose(other[:, 4], kept[:, 4], atol=1e-9)


def test_with_a_pseudo_input_at_every_row_it_is_the_exact_gaussian_process(generator):
    inputs = generator.standard_normal((60, 2))
    outputs = np.sin(2.0 * inputs[:, 0]) * inputs[:, 1] + 0.2 * generator.standard_normal(60)
    model = fit_gaussian_process(inputs, outputs, 60, generator)
    lengths, signal, noise = np.split(np.exp(model.theta), [2, 3])
    kernel = ConstantKernel(signal[0] ** 2) * RBF(lengths) + WhiteKernel(noise[0] ** 2)
    exact = GaussianProcessRegressor(kernel, optimizer=None).fit(inputs, outputs)
    points = generator.standard_normal((40, 2))
    mean, deviation = exact.predict(points, return_std=True)
    found, variance = model.predict_outputs(points)
    np.testing.assert_allclose(found, mean, atol=1e-5)
    np.testing.assert_allclose(np.sqrt(variance), deviation, atol=1e-5)


def test_a_hum_is_no_dependence():
    output, residual, _ = plant(2, lambda x, p, v: 0.0 * x)
    time = np.arange(len(residual))[:, None] * output.step_s
    residual += 0.5 * np.sin(2.0 * np.pi * 20.0 * time + np.random.default_rng(2).uniform(0.0, 6.0, TRIALS))
    found = find_dependence(output, residual, DESCRIPTION, np.random.default_rng(0))
    assert not found.inputs or measure(residual, residual - found.heldout).low <= 0.0


def test_the_range_is_the_shortest_that_holds_half(generator):
    values = generator.uniform(0.0, 10.0, 4000)
    taken = np.where((values > 6.0) & (values < 8.0), 1.0, 0.02)
    found = find_range(values, taken, 0.5)
    assert 5.9 < found.low < found.high < 8.1
    assert found.part >= 0.5
    assert found.time == pytest.approx(0.15, abs=0.06)
    everywhere = find_range(values, np.ones(4000), 0.5)
    assert everywhere.part == pytest.approx(everywhere.time, abs=0.01)
