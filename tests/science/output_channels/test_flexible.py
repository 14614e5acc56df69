"""A flexible model leaves the noise: of what sums of features explain, of what happens at one place, and of a line."""

from dataclasses import replace

import numpy as np
import pytest

from stages.science.output_channels.features import build_features
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.flexible import (
    explain_by_drift,
    explain_by_features,
    explain_by_trees,
    find_floor,
    keep_least,
)
from stages.science.output_channels.noise import Noise, make_plain
from tests.science.discrepancy.toys import make_toy

NOISE = 0.1


def measure(residual, output):
    return float(np.sqrt((residual[output.present] ** 2).mean()))


def fit_line(seed, *hidden, **kwargs):
    """Return an output with hidden effects and the fit of its line."""
    output = make_toy(seed, hidden, noise=NOISE, **kwargs)
    return output, fit(Model(output), make_plain(NOISE), Model(output).start)


WAVE = (lambda x: np.sin(3.0 * x), 0.6)
PLACE = (lambda x: np.where(np.abs(x - 0.3) < 0.08, 1.0, 0.0), 2.0)


@pytest.mark.parametrize("seed", range(3))
def test_features_explain_what_is_smooth_trees_what_happens_at_one_place_and_neither_explains_noise(seed):
    output, nominal = fit_line(seed, WAVE)
    left = explain_by_features(nominal, build_features(output), None)
    assert measure(nominal.residual, output) > 3.0 * NOISE
    assert measure(left, output) == pytest.approx(NOISE, rel=0.12)
    output, nominal = fit_line(seed, PLACE)
    assert measure(nominal.residual, output) > 3.0 * NOISE
    assert measure(explain_by_trees(output, nominal.residual), output) < 0.5 * measure(nominal.residual, output)
    output, nominal = fit_line(seed)
    assert measure(explain_by_features(nominal, build_features(output), None), output) > 0.98 * NOISE
    assert measure(explain_by_trees(output, nominal.residual), output) > 0.98 * NOISE


def follow_late(x, width=0.1):
    """Return what follows x at a distance of its play, on either side."""
    y = x.copy()
    for k in range(1, len(x)):
        y[k] = np.clip(y[k - 1], x[k] - width, x[k] + width)
    return y


@pytest.mark.parametrize("hidden", [follow_late, lambda x: np.maximum(x - 1.0, 0.0)])
def test_features_have_the_play_and_the_kinks_of_a_state(hidden):
    output, nominal = fit_line(2, (hidden, 5.0), beside=())
    assert measure(explain_by_features(nominal, build_features(output), None), output) < 1.1 * NOISE


def test_a_slope_that_falls_from_trial_to_trial_drifts_and_slopes_in_no_order_do_not():
    """The same six slopes; of thirty orders by chance, some would predict left-out trials better by a drift."""
    slopes, drifting = np.linspace(-0.5, 0.5, 6), []
    for order in [np.arange(6)[::-1], *(np.random.default_rng(seed).permutation(6) for seed in range(30))]:
        toy = make_toy(1, noise=NOISE, trials=6)
        output = replace(toy, measured=toy.measured + slopes[order] * toy.x)
        nominal = fit(Model(output), make_plain(NOISE), Model(output).start)
        left = explain_by_drift(nominal, None)
        drifting.append(left is not None)
        assert measure(nominal.residual, output) > 2.0 * NOISE
        assert len(drifting) > 1 or measure(left, output) < 1.5 * NOISE
    assert drifting[0]
    assert sum(drifting[1:]) <= 1


def test_trials_that_are_not_learnt_teach_nothing_and_those_without_samples_are_passed_over():
    output, nominal = fit_line(1, WAVE)
    learnt = np.arange(8) < 6
    spoilt = nominal.residual + 5.0 * ~learnt
    kept, other = (explain_by_trees(output, each, learnt)[:, learnt] for each in (nominal.residual, spoilt))
    np.testing.assert_array_equal(kept, other)
    present = output.present.copy()
    present[:, ::5] = False
    emptied = replace(output, present=present)
    left = explain_by_trees(emptied, np.where(present, nominal.residual, 0.0))
    assert measure(left, emptied) < 0.5 * measure(nominal.residual, output)


def test_the_least_is_kept_and_a_line_is_no_noise():
    output = make_toy(2, noise=NOISE, trials=8, samples=600)
    time = np.arange(600)[:, None] * output.step_s
    residual = output.measured - output.measured.mean()
    noise = NOISE * np.random.default_rng(5).standard_normal(residual.shape)
    ringing = noise + 0.2 * np.sin(2.0 * np.pi * 20.0 * time)
    kept = keep_least([("memory", residual), ("", ringing)], output)
    assert kept.line_hz == pytest.approx(20.0, abs=0.1)
    assert np.sqrt(kept.raw.sum() / ringing.size) == pytest.approx(NOISE, rel=0.05)
    assert kept.family == ""
    assert keep_least([("", noise)], output).line_hz is None


def test_the_floor_of_opened_trials_is_the_noise_as_estimated_and_not_what_the_fit_leaves():
    learnt, noise = np.arange(12) % 3 != 0, Noise(NOISE, 1e-6, 0.03, 1e-6, 1.0)
    floor = find_floor(fit_line(4, WAVE, trials=12)[1], noise, learnt)
    assert np.sqrt(floor.raw[~learnt].sum() / (300 * 4)) == pytest.approx(NOISE, rel=0.12)
    fitted = fit_line(4, trials=12)[1]
    floor = find_floor(fitted, noise, learnt)
    gap = (fitted.residual**2).sum(axis=0)
    assert (floor.raw[~learnt] != gap[~learnt]).all()
    assert floor.raw[~learnt].sum() == pytest.approx(gap[~learnt].sum(), rel=0.2)
