"""Constants of a model's memory, identified from points of a force whose memory is known."""

import numpy as np
import pandas as pd
import pytest

from stages.science.gp.hyperprior import Hyperprior
from stages.science.muscle_models.input_constants import Evidence, identify_constants
from stages.science.muscle_models.inputs import InputConstants, ModelSettings
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.scaling import Scaling

STEP_S, SAMPLES, POINTS = 0.02, 200, 12
TRUE = InputConstants(stop_width=0.02, stop_ratio=3.0, highpass_s=0.5, direction_per_s=0.1)
INPUTS = ["pressure", "contraction", "contraction_stop", "contraction_highpass"]
MUSCLES = ["pam1", "pam2"]


def move(trial, muscle, generator):
    """Return a trial of slow sines of pressure and contraction."""
    time_s = STEP_S * np.arange(SAMPLES)
    rate, phase = generator.uniform(0.8, 3.0, 2), generator.uniform(0.0, 6.0, 2)
    pressure, contraction = np.sin(rate[:, None] * time_s + phase[:, None])
    rows = {"pressure_kpa": 150.0 + 80.0 * pressure, "contraction": 0.1 + 0.06 * contraction}
    rows |= {"contraction_velocity_per_s": np.gradient(rows["contraction"], STEP_S)}
    return pd.DataFrame({"trajectory": trial, "trial": trial, "muscle": muscle, "time_s": time_s, **rows})


def make_evidence(octaves, memory):
    """Return points of a force with the true constants' memory, and models whose constants are so far from them."""
    generator = np.random.default_rng(3)
    trials = pd.concat([move(trial, muscle, generator) for trial in range(6) for muscle in MUSCLES], ignore_index=True)
    model = ModelSettings(inputs=INPUTS, constants=TRUE)
    felt = model.extend(trials, ["trial"])
    force = 4.0 * felt["pressure_kpa"] - 2000.0 * felt["contraction"]
    force += memory * (felt["contraction_stop"] + felt["contraction_highpass"]) + generator.normal(0.0, 2.0, len(felt))
    columns = tuple(each.column for each in model.features)
    scaling = Scaling(
        columns, felt[list(columns)].mean().to_numpy(), felt[list(columns)].std().to_numpy(), 400.0, 200.0
    )
    prior = Hyperprior(np.array([1.4, 0.9, 0.9, 0.9, 0.5, -3.0]), np.full(6, 0.5))
    rows = {}
    for muscle in MUSCLES:
        own = np.flatnonzero(trials["muscle"] == muscle).reshape(6, SAMPLES)
        rows["p1", 1, muscle] = own[:, SAMPLES // POINTS // 2 :: SAMPLES // POINTS].ravel()
    recorded = dict.fromkeys(MUSCLES, RecordedModels(prior, "zero", scaling))
    times_s = trials["time_s"].unique()[::4]
    return Evidence(model.scale(octaves), trials, times_s, trials.assign(force_n=force), rows, recorded)


@pytest.mark.parametrize("octaves", [(0.0, 0.0), (2.0, -1.0)])
def test_constants_of_a_known_memory_are_found(octaves):
    found = identify_constants(make_evidence(octaves, 3000.0), 2.0, [1.0, 0.5], 0, np.random.default_rng(0))
    np.testing.assert_allclose(np.add(found.best, octaves), 0.0, atol=0.5)
    assert found.scores[found.best] == max(found.scores.values())
    gained = found.scores[found.best] - found.scores[0.0, 0.0]
    assert gained > 50.0 if any(octaves) else gained < 3.0


def test_constants_that_nothing_depends_on_stay_where_they_were_assumed():
    found = identify_constants(make_evidence((1.0, 1.0), 0.0), 0.5, [1.0], 0, np.random.default_rng(0))
    assert found.best == (0.0, 0.0)


def test_scores_are_of_scales_that_the_constants_give():
    evidence = make_evidence((0.0, 0.0), 3000.0)
    (first, _) = evidence.fit((1.0, 0.0), {}, 0, np.random.default_rng(0)).values()
    model = evidence.model.scale((1.0, 0.0))
    assert (model.constants.stop_width, model.constants.highpass_s) == (0.04, 0.5)
    its = model.extend(evidence.bank, ["trajectory"]).query("muscle == 'pam1'")
    its = its[its["time_s"].isin(evidence.times_s)]["contraction_stop"]
    place = first.scaling.inputs.index("contraction_stop")
    assert first.scaling.input_centre[place] == pytest.approx(its.mean())
    assert first.scaling.input_scale[place] == pytest.approx(its.std(ddof=0))
