"""On which inputs a residual depends, and a formula for it: what was planted is found, noise is left alone."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.discrepancy.dependence import find_dependence, find_range, fit_gaussian_process
from stages.science.discrepancy.description import average_dependence, describe, measure_share, tabulate
from stages.science.discrepancy.report_text import describe_remainder
from stages.science.discrepancy.resampling import resample
from stages.science.discrepancy.symbolic_regression import sketch_residual
from stages.science.output_channels.features import list_inputs
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import make_plain
from stages.science.output_channels.output_channel import Driver
from tests.science.discrepancy.searches import DESCRIPTION, DISCREPANCY
from tests.science.discrepancy.toys import make_toy

NOISE = 0.1
TRIALS = 10
WEIGHTS = resample(TRIALS, 400, np.random.default_rng(0))


def plant(seed, surface, noise=NOISE):
    """An output, its residual, and the residual without noise; two more signals were measured beside."""
    generator = np.random.default_rng(seed)
    output = make_toy(seed, trials=TRIALS)
    smooth = np.cumsum(generator.standard_normal((2, *output.x.shape)), axis=1) / 10.0
    beside = [Driver(n, values, own=False) for n, values in zip(("pressure_kpa", "tension_n"), smooth, strict=True)]
    truth = surface(output.x, smooth[0], output.drivers()[1].values)
    return replace(output, beside=tuple(beside)), truth + noise * generator.standard_normal(truth.shape), truth


def depend(output, residual, settings=DESCRIPTION):
    """Return on what a residual depends, and the share of it that this takes away of trials left out."""
    found = find_dependence(output, list_inputs(output), residual, settings, np.random.default_rng(0))
    left = residual - found.heldout
    return found, measure_share((residual**2).sum(axis=0), (left**2).sum(axis=0), WEIGHTS, 0.95)


@pytest.mark.parametrize(
    ("surface", "inputs"),
    [
        (lambda x, p, v: 0.3 * np.sin(4.0 * x), ["x"]),
        (lambda x, p, v: 0.05 * v * np.abs(v) / 4.0, ["x_rate"]),
        (lambda x, p, v: 0.3 * np.tanh(p), ["pressure_kpa"]),
        (lambda x, p, v: 0.3 * np.sin(4.0 * x) + 0.1 * p, ["pressure_kpa", "x"]),
    ],
)
def test_inputs_and_share_are_those_planted(surface, inputs):
    output, residual, truth = plant(1, surface)
    found, share = depend(output, residual)
    assert sorted(each.name for each in found.inputs) == inputs
    possible = (truth**2).sum() / (residual**2).sum()
    assert 0.8 * possible < share.value < 1.05 * possible
    assert 0.0 < share.low < share.value < share.high
    assert np.sqrt(np.mean((found.mean - truth) ** 2)) < 0.5 * NOISE


def test_two_signals_that_tell_something_only_together_are_found():
    output, residual, truth = plant(1, lambda x, p, v: 0.1 * np.sin(4.0 * x) * v)
    found, share = depend(output, residual)
    assert "x" in [each.name for each in found.inputs]
    assert share.value > 0.7 * (truth**2).sum() / (residual**2).sum()


@pytest.mark.parametrize(("seed", "hum"), [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0), (2, 0.5)])
def test_noise_and_a_hum_are_left_alone(seed, hum):
    output, residual, _ = plant(seed, lambda x, p, v: 0.0 * x)
    aside, phase = np.random.default_rng(seed), np.random.default_rng(seed).uniform(0.0, 6.0, TRIALS)
    time = np.arange(len(residual))[:, None] * output.step_s
    residual += hum * np.sin(2.0 * np.pi * 20.0 * time + phase) if hum else 0.05 * aside.standard_normal(TRIALS)
    found, share = depend(output, residual)
    assert not found.inputs or share.low <= 0.0
    assert share.value < 0.1


def test_a_trial_has_no_part_in_what_is_said_of_it():
    output, residual, _ = plant(3, lambda x, p, v: 0.3 * np.sin(4.0 * x))
    spoilt = residual.copy()
    spoilt[:, 4] += 0.2
    alone = DESCRIPTION.model_copy(update={"most_inputs": 1})
    kept, other = (depend(output, each, alone)[0].heldout for each in (residual, spoilt))
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
    found, variance = model.predict(points)
    np.testing.assert_allclose(found, mean, atol=1e-5)
    np.testing.assert_allclose(np.sqrt(variance + model.noise_variance), deviation, atol=1e-5)


def test_the_range_is_the_shortest_that_holds_half(generator):
    values = generator.uniform(0.0, 10.0, 4000)
    taken = np.where((values > 6.0) & (values < 8.0), 1.0, 0.02)
    found = find_range(values, taken, 0.5)
    assert 5.9 < found.low < found.high < 8.1
    assert found.part >= 0.5
    assert found.time == pytest.approx(0.15, abs=0.06)
    everywhere = find_range(values, np.ones(4000), 0.5)
    assert everywhere.part == pytest.approx(everywhere.time, abs=0.01)


def fit_line(seed, shape=None):
    """The toy's line fitted to a line plus a shape of x and its rate; and the inputs."""
    output = make_toy(seed, trials=TRIALS, noise=NOISE)
    if shape is not None:
        x, rate = output.x, np.gradient(output.x, output.step_s, axis=0)
        output = replace(output, measured=output.measured + shape(x, rate))
    model = Model(output)
    return fit(model, make_plain(NOISE), model.start), output.drivers()


@pytest.mark.parametrize(
    ("shape", "terms"),
    [
        (lambda x, v: 0.03 * v * np.abs(v), {"[x rate]*|x rate|": 0.03}),
        (lambda x, v: 0.5 * x**3, {"x^3": 0.5}),
        (lambda x, v: 0.1 * x * v, {"x*[x rate]": 0.1}),
    ],
)
def test_planted_terms_come_back_with_their_weights(shape, terms):
    fitted, inputs = fit_line(2, shape)
    found = sketch_residual(fitted, inputs, DESCRIPTION)
    assert dict(found.terms) == pytest.approx(terms, rel=0.1)
    assert found.after.sum() < 0.5 * found.before.sum()
    assert found.after.sum() == pytest.approx(NOISE**2 * fitted.residual.size, rel=0.1)


def test_a_direction_is_told():
    fitted, inputs = fit_line(3, lambda x, v: 0.4 * np.sign(v))
    found = sketch_residual(fitted, inputs, DESCRIPTION)
    text, weight = found.terms[0]
    assert text.startswith("tanh([x rate]/")
    assert weight == pytest.approx(0.4, rel=0.2)


@pytest.mark.parametrize("seed", range(6))
def test_noise_has_no_formula(seed):
    fitted, inputs = fit_line(seed)
    found = sketch_residual(fitted, inputs, DESCRIPTION)
    assert not found.terms or measure_share(found.before, found.after, WEIGHTS, 0.95).low <= 0.0


def test_what_the_constants_imitate_is_no_term():
    fitted, inputs = fit_line(1, lambda x, v: 0.7 * x)
    assert not sketch_residual(fitted, inputs, DESCRIPTION).terms


def describe_line(shape):
    fitted, _ = fit_line(4, shape)
    return describe(fitted, NOISE, DESCRIPTION, WEIGHTS, 0.95, np.random.default_rng(1))


def test_a_planted_drag_is_described_drawn_and_told():
    found = describe_line(lambda x, v: 0.05 * v * np.abs(v))
    row = tabulate(found)
    assert row["inputs"] == "x_rate"
    assert row["low"] < row["share"] < row["high"]
    assert row["share"] == pytest.approx(row["above_floor"], abs=0.1)
    assert row["hint"].endswith("*[x rate]*|x rate|")
    averages = average_dependence([found])
    assert np.abs(averages["said"] - averages["mean"]).max() < 0.1
    said = " ".join(describe_remainder(pd.DataFrame([row]), "unexplained", DISCREPANCY.report))
    assert "What stays unexplained in y of toy depends on x rate" in said
    assert "A hint, no finding: on toy it is about 0.05" in said


@pytest.mark.parametrize(("grown", "told"), [(0.0, ""), (-0.6, "slope"), (0.6, "slope")])
def test_a_slope_that_drifts_along_the_session_is_told_with_both_ends(grown, told):
    """The slope is 1.4; ten trials begin ten seconds apart, and last three."""
    toy = make_toy(0, trials=TRIALS)
    session = (np.arange(len(toy.x))[:, None] * toy.step_s + toy.start_s) / 93.0
    found = describe_line(lambda x, v: grown * session * x)
    row = tabulate(found)
    assert row["drift"] == told
    if told:
        assert row["drift_first"] == pytest.approx(1.4, abs=0.05)
        assert row["drift_last"] == pytest.approx(1.4 + grown, abs=0.05)
        assert row["drift_share"] == pytest.approx(row["above_floor"], abs=0.05)
        said = " ".join(describe_remainder(pd.DataFrame([row]), "unexplained", DISCREPANCY.report))
        assert "mostly a drift of slope along the session, from 1." in said


def test_what_other_constants_alone_explain_is_no_drift():
    """A fit that has not moved from where it began is off, as one at a bound is."""
    fitted, _ = fit_line(4, None)
    off = fit(fitted.model, make_plain(NOISE), fitted.model.start, iterations=0)
    assert (off.residual**2).sum() > 2.0 * (fitted.residual**2).sum()
    assert tabulate(describe(off, NOISE, DESCRIPTION, WEIGHTS, 0.95, np.random.default_rng(1)))["drift"] == ""


def test_of_noise_nothing_is_told_but_that():
    row = tabulate(describe_line(None))
    assert (row["inputs"], row["hint"]) == ("", "")
    assert row["above_floor"] < 0.1
    table = pd.DataFrame([row])
    said = describe_remainder(table, "named", DISCREPANCY.report)
    assert len(said) == 1
    assert "no Gaussian process" in said[0]
    assert not describe_remainder(table, "no_discrepancy", DISCREPANCY.report)
    assert not describe_remainder(table[:0], "named", DISCREPANCY.report)
    assert (
        "hardly above what flexible models leave" in describe_remainder(table[:0], "unexplained", DISCREPANCY.report)[0]
    )
