"""Models rebuilt from tables against those that the loop had."""

import numpy as np
import pandas as pd
import pytest

from stages.science.gp.marginal import fit
from stages.science.muscle_models.muscle_set import MuscleSet, RecordedModels
from tests.science.muscle_models.data import MUSCLES, make_tables


@pytest.fixture
def recorded(generator):
    """Return tables, what was fitted to two trials of pam2, and the rows that tell of it."""
    tables = make_tables(generator)
    muscles = MuscleSet.read(tables["candidates"], tables["hyperprior"], tables["scaling"])
    samples = tables["bank"].query("muscle == 'pam2'").iloc[::23]
    points = samples.assign(trial=np.arange(len(samples)) // 6)
    (_, inputs), (_, outputs) = (each for each in muscles.standardise(tables["bank"].iloc[points.index]))
    sizes = [(points["trial"] <= trial).sum() for trial in (0, 1)]
    fitted = [fit(inputs[:n], outputs[:n], muscles.priors[1], generator=generator, starts=1) for n in sizes]
    models = pd.concat([pd.DataFrame({"trial": trial, "value": each.theta}) for trial, each in enumerate(fitted)])
    return tables, fitted, models, points


def test_a_model_stands_on_the_points_of_its_trial_and_earlier_ones(recorded, generator):
    tables, fitted, models, points = recorded
    its = RecordedModels.read(tables["hyperprior"], tables["scaling"], MUSCLES[1])
    at = generator.standard_normal((20, 3))
    for trial in (0, 1):
        rebuilt = its.rebuild(models[models["trial"] == trial], points)
        for found, expected in zip(rebuilt.predict_marginal(at), fitted[trial].predict_marginal(at), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-10)
    assert len(its.rebuild(models[models["trial"] == 0], points).inputs) == 6
    with pytest.raises(ValueError, match=r"expected the rows of one trial, got those of trials \[0, 1\]"):
        its.rebuild(models, points)


def test_a_constant_mean_is_read_from_table_1(recorded):
    tables, _, models, points = recorded
    row = {"muscle": MUSCLES[1], "hyperparameter": "constant_mean", "mean": 0.0, "variance": 1.0}
    prior = pd.concat([tables["hyperprior"], pd.DataFrame([row])], ignore_index=True)
    its = RecordedModels.read(prior, tables["scaling"], MUSCLES[1])
    longer = pd.concat([models[models["trial"] == 1], pd.DataFrame([{"trial": 1, "value": 0.7}])])
    assert its.rebuild(longer, points).predict_mean(np.full((1, 3), 1e3))[0] == pytest.approx(0.7)
    assert RecordedModels.read(prior, tables["scaling"], MUSCLES[0]).mean == "zero"
