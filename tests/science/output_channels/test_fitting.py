"""Fits against SciPy's least squares, and trials left out against fits without them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import Noise, whiten
from tests.science.discrepancy.toys import KINK, WAVE, make_toy

NOISE = Noise(0.1, 0.05, 0.05, 0.02, 1.0)


@pytest.mark.parametrize("forms", [(), (WAVE,), (WAVE, KINK)])
def test_the_largest_posterior_is_that_of_scipy(forms):
    toy = make_toy(1, [(WAVE.effect, 0.4)])
    model = Model(toy, forms)
    mean, sd = model.prior

    def residuals(values):
        gap = whiten((toy.measured - model.simulate(values))[:, :, None], toy.present, NOISE, toy.step_s)
        return np.concatenate([gap.ravel(), (values - mean) / sd])

    found = fit(model, NOISE, model.start)
    expected = least_squares(residuals, model.start, bounds=model.bounds, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(found.values, expected.x, rtol=1e-5, atol=1e-6)


def test_bounds_hold_and_are_told():
    model = Model(make_toy(2, [(WAVE.effect, -1.0)]), (WAVE,))
    found = fit(model, NOISE, model.start)
    assert found.values[-1] == 0.0
    assert found.free.tolist() == [True, True, False]


def test_a_trial_left_out_is_a_fit_without_it():
    toy = make_toy(3, [(WAVE.effect, 0.4)], trials=5)
    model = Model(toy, (WAVE,))
    found = fit(model, NOISE, model.start)
    left = found.leave_each_out()
    for k in range(5):
        kept = [each for each in range(5) if each != k]
        without = fit(Model(toy.take(kept), (WAVE,)), NOISE, found.values)
        own = toy.measured[:, k] - Model(toy, (WAVE,)).simulate(without.values)[:, k]
        np.testing.assert_allclose(left[:, k], own, atol=1e-6)


def test_gaps_take_no_part():
    toy = make_toy(4)
    holes = toy.present.copy()
    holes[50:120, 2] = False
    wrong = toy.measured.copy()
    wrong[50:120, 2] = 99.0
    models = [Model(replace(toy, present=holes, measured=measured)) for measured in (toy.measured, wrong)]
    np.testing.assert_array_equal(*(fit(each, NOISE, each.start).values for each in models))
