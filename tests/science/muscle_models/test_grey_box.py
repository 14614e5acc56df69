"""A plant's force with a Gaussian process of what it leaves: plants that are the truth, nearly so, and say nothing."""

import numpy as np
import pytest

from stages.science.gp.marginal import fit
from stages.science.muscle_models.grey_box import GreyBox, predict_interval
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.scaling import MODEL_OUTPUT
from tests.science.muscle_models.data import draw, make_tables

NOISE_N = 0.3
"""Standard deviation of the force's noise in `make_bank`."""


@pytest.fixture
def muscle(generator):
    """The recorded models' common part, points, and test samples of a muscle, both with the law's own force."""
    tables = make_tables(generator)
    rows = tables["bank"].query("muscle == 'pam1'").reset_index(drop=True)
    pressure, contraction = (rows["pressure_kpa"] - 100) / 30, (rows["contraction"] - 0.1) / 0.05
    law = 50 + 20 * np.sin(pressure) + 8 * contraction**2 + 5 * np.tanh(rows["contraction_velocity_per_s"] / 0.2)
    rows = rows.assign(law_n=law)
    assert np.std(rows[MODEL_OUTPUT] - law) == pytest.approx(NOISE_N, rel=0.1)
    recorded = RecordedModels.read(tables["hyperprior"], tables["scaling"], "pam1")
    return recorded, rows[rows["trajectory"] < 4].iloc[::5], rows[rows["trajectory"] >= 4]


def test_a_plant_that_is_the_truth_leaves_the_noise_alone(muscle):
    recorded, points, test = muscle
    law, inputs = test["law_n"].to_numpy(), recorded.scaling.inputs_of(test)
    grey = GreyBox.identify(recorded, points, points["law_n"].to_numpy(), draw("grey"), 4)
    error = np.sqrt(np.mean((grey.predict_mean(inputs, law) - law) ** 2))
    assert error < NOISE_N
    mean_n, half_n = grey.predict_interval(inputs, law, 1.96)
    assert np.mean(np.abs(test[MODEL_OUTPUT].to_numpy() - mean_n) < half_n) > 0.93
    noise_n = recorded.scaling.force_scale_n * np.sqrt(grey.residual.noise_variance)
    assert 0.5 * NOISE_N < noise_n < 3.0 * NOISE_N


def test_a_plant_that_is_wrong_by_a_law_of_the_inputs_is_mended(muscle):
    recorded, points, test = muscle
    wrong = [each["law_n"].to_numpy() + 0.1 * each["pressure_kpa"].to_numpy() - 8.0 for each in (points, test)]
    grey = GreyBox.identify(recorded, points, wrong[0], draw("grey"), 4)
    law = test["law_n"].to_numpy()
    left = grey.predict_mean(recorded.scaling.inputs_of(test), wrong[1]) - law
    assert np.sqrt(np.mean(left**2)) < 0.15 * np.sqrt(np.mean((wrong[1] - law) ** 2))


def test_a_plant_that_says_the_scales_centre_leaves_the_model_of_the_force_itself(muscle):
    recorded, points, test = muscle
    scaling = recorded.scaling
    still = [np.full(len(each), scaling.force_centre_n) for each in (points, test)]
    grey = GreyBox.identify(recorded, points, still[0], draw("grey"), 4)
    own = fit(scaling.inputs_of(points), scaling.output_of(points), recorded.prior, generator=draw("grey"), starts=4)
    np.testing.assert_allclose(grey.residual.theta, own.theta, rtol=1e-9, atol=1e-9)
    inputs = scaling.inputs_of(test)
    expected = predict_interval(own, scaling, inputs, 1.96)
    np.testing.assert_allclose(grey.predict_mean(inputs, still[1]), expected[0], rtol=1e-7)
    for got, told in zip(grey.predict_interval(inputs, still[1], 1.96), expected, strict=True):
        np.testing.assert_allclose(got, told, rtol=1e-7)
