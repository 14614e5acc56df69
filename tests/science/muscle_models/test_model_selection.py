"""Inputs of models and constants of their memory, by the evidence of points of a force whose memory is known."""

import numpy as np
import pandas as pd
import pytest

from stages.science.gp.hyperprior import Hyperprior
from stages.science.muscle_models.inputs import InputConstants, ModelSettings
from stages.science.muscle_models.model_selection import Choice, Evidence, select_model
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


def make_evidence(octaves, memory, inputs=INPUTS):
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
    lengths = [1.4, *(0.9 for _ in inputs[1:])]
    prior = Hyperprior(np.array([*lengths, 0.5, -3.0]), np.full(len(inputs) + 2, 0.5))
    rows = {}
    for muscle in MUSCLES:
        own = np.flatnonzero(trials["muscle"] == muscle).reshape(6, SAMPLES)
        rows["p1", 1, muscle] = own[:, SAMPLES // POINTS // 2 :: SAMPLES // POINTS].ravel()
    recorded = dict.fromkeys(MUSCLES, RecordedModels(prior, "zero", scaling))
    times_s = trials["time_s"].unique()[::4]
    constants = Choice(tuple(INPUTS), (*octaves, 0.0)).apply(model).constants
    given = ModelSettings(inputs=list(inputs), constants=constants)
    return Evidence(given, trials, times_s, trials.assign(force_n=force), rows, recorded, (0.9, 0.5))


@pytest.mark.parametrize("octaves", [(0.0, 0.0), (2.0, -1.0)])
def test_constants_of_a_known_memory_are_found(octaves):
    found = select_model(make_evidence(octaves, 3000.0), 2.0, [1.0, 0.5], np.random.default_rng(0))
    np.testing.assert_allclose(np.add(found.best.octaves[:2], octaves), 0.0, atol=0.5)
    assert set(found.best.inputs) >= set(INPUTS)
    assert found.scores[found.best] == max(found.scores.values())
    assert found.gain > 50.0 if any(octaves) else found.gain < 5.0


@pytest.mark.parametrize(
    ("inputs", "memory"), [(INPUTS[:3], 3000.0), ([*INPUTS, "pressure_highpass"], 3000.0), (INPUTS, 0.0)]
)
def test_inputs_that_force_depends_on_are_found_and_others_left_out(inputs, memory):
    found = select_model(make_evidence((0.0, 0.0), memory, inputs), 2.0, [1.0], np.random.default_rng(0))
    assert found.first.inputs == tuple(inputs)
    assert found.best.inputs == tuple(INPUTS if memory else INPUTS[:2])
    toggled = {name: found.scores[found.best] - found.scores[each] for name, each in found.best.list_toggles()}
    assert min(toggled.values()) > 0.0


def test_a_constant_that_is_not_in_use_is_as_assumed():
    moved = Choice(tuple(INPUTS), (1.0, 2.0, 0.0))
    toggled = dict(moved.list_toggles())
    assert toggled["contraction_highpass"] == Choice(tuple(INPUTS[:3]), (1.0, 0.0, 0.0))
    assert dict(toggled["contraction_highpass"].list_toggles())["pressure_highpass"].octaves == (1.0, 0.0, 0.0)
    assert toggled["pressure_highpass"].octaves == (1.0, 2.0, 0.0)


def test_a_model_keeps_an_input():
    assert "contraction_stop" not in dict(Choice(("contraction_stop",), (0.0,) * 3).list_toggles())


def test_models_have_the_scales_that_the_constants_give():
    evidence = make_evidence((0.0, 0.0), 3000.0)
    choice = Choice(tuple(INPUTS), (1.0, 0.0, 0.0))
    (first, _) = evidence.fit(choice, {}, np.random.default_rng(0)).values()
    model = choice.apply(evidence.model)
    assert (model.constants.stop_width, model.constants.highpass_s) == (0.04, 0.5)
    its = model.extend(evidence.bank, ["trajectory"]).query("muscle == 'pam1'")
    its = its[its["time_s"].isin(evidence.times_s)]["contraction_stop"]
    place = first.scaling.inputs.index("contraction_stop")
    assert first.scaling.input_centre[place] == pytest.approx(its.mean())
    assert first.scaling.input_scale[place] == pytest.approx(its.std(ddof=0))


def test_evidence_is_the_integral_of_the_posterior_over_the_hyperparameters():
    (first, _) = (
        make_evidence((0.0, 0.0), 3000.0).fit(Choice(tuple(INPUTS), (0.0,) * 3), {}, np.random.default_rng(0)).values()
    )
    drawn = np.random.default_rng(1).multivariate_normal(first.model.theta, 1.5 * first.model.laplace.covariance, 4000)
    away = drawn - first.model.theta
    density = -0.5 * np.einsum("ni,ij,nj->n", away, np.linalg.inv(1.5 * first.model.laplace.covariance), away)
    density -= 0.5 * np.linalg.slogdet(3.0 * np.pi * first.model.laplace.covariance)[1]
    ratios = np.array([first.model.posterior.value(each) for each in drawn]) - density
    assert first.log_evidence == pytest.approx(np.logaddexp.reduce(ratios) - np.log(len(ratios)), abs=0.3)
