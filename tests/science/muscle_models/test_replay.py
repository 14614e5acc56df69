"""Replays against Algorithm 1 itself, the time shift against its definition, and models rebuilt against the loop's."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError
from scipy import stats

from stages.science.gp.interaction import Interaction
from stages.science.gp.marginal import fit
from stages.science.muscle_models.error_rates import ForceTest
from stages.science.muscle_models.loop_settings import LoopSettings
from stages.science.muscle_models.muscle_set import MuscleSet, RecordedModels
from stages.science.muscle_models.replay import Replay, displace
from tests.science.muscle_models.data import LOOP, MUSCLES, PERIOD_S, draw, make_bank, make_tables

INITIAL = [4, 1]


@pytest.fixture
def tables(generator):
    return make_tables(generator)


@pytest.fixture
def replay(tables):
    muscles = MuscleSet.read(tables["candidates"], tables["hyperprior"], tables["scaling"])
    return Replay.read(muscles, tables["bank"])


def run(replay, amplitude_s=0.0, **choices):
    settings = LoopSettings(**{**LOOP, **choices})
    return list(replay.run(settings, replay.muscles.priors, INITIAL, draw, amplitude_s))


def standardised(tables, muscle, trajectory):
    """Return one recording, standardised by hand."""
    rows = tables["bank"].query("muscle == @muscle and trajectory == @trajectory").sort_values("time_s")
    constants = tables["scaling"].query("muscle == @muscle").set_index("quantity")
    scaled = [(rows[name] - constants.loc[name, "centre"]) / constants.loc[name, "scale"] for name in constants.index]
    return np.stack(scaled[:3], axis=1), scaled[3].to_numpy()


@pytest.mark.parametrize("choices", [{}, {"utility": "random", "subsample_utility": "random"}])
def test_without_shift_it_is_the_interaction_pick_for_pick(tables, replay, choices):
    design, muscles = LoopSettings(**{**LOOP, **choices}).design("zero"), replay.muscles
    executed = [[standardised(tables, name, each) for each in INITIAL] for name in MUSCLES]
    at = ((np.arange(6) + 0.5) * 100 / 6).astype(int)
    inputs = [np.vstack([x for x, _ in its])[at] for its in executed]
    outputs = [np.concatenate([y for _, y in its])[at] for its in executed]

    def starts(trial):
        return [draw("starts", trial, name) for name in MUSCLES]

    known = Interaction.begin(design, muscles.candidates, muscles.priors, inputs, outputs, INITIAL, starts(0))
    replayed = run(replay, **choices)
    assert len(replayed) == 4
    for trial, found in enumerate(replayed):
        if trial:
            chosen = known.ask(draw("random", trial)).trajectory
            recorded = [standardised(tables, name, chosen) for name in MUSCLES]
            known, _ = known.tell(chosen, [x for x, _ in recorded], [y for _, y in recorded], starts(trial))
        assert found.used == known.used
        for name in ("inputs", "outputs", "thetas"):
            np.testing.assert_array_equal(getattr(found, name), getattr(known, name))


@pytest.mark.parametrize("amplitude_s", [0.02, 0.1, 0.9])
def test_shifted_pairs_are_recorded_pairs_within_the_amplitude_of_each_pick(tables, replay, amplitude_s):
    known = run(replay, amplitude_s)
    moved = 0
    for before, after in pairwise(known):
        (chosen,) = after.used - before.used
        for index, name in enumerate(MUSCLES):
            x, y = standardised(tables, name, chosen)
            model, taken = before.models[index], []
            for pick in range(len(before.outputs[index]), len(after.outputs[index])):
                scores = model.utility(x, "y_y")
                scores[taken] = -np.inf
                best = int(np.argmax(scores))
                (row,) = np.flatnonzero((x == after.inputs[index][pick]).all(axis=1))
                assert after.outputs[index][pick] == y[row]
                assert abs(row - best) * PERIOD_S <= amplitude_s + 1e-12
                assert row not in taken
                moved += row != best
                taken.append(int(row))
                model = model.grow(x[[row]], y[[row]])
    assert moved > 0


def test_shifted_random_picks_are_distinct_samples_too(tables, replay):
    known = run(replay, 0.1, subsample_utility="random", points_per_trial=20, trials=1)
    (chosen,) = known[1].used - known[0].used
    for index, name in enumerate(MUSCLES):
        x, _ = standardised(tables, name, chosen)
        taken = known[1].inputs[index][6:]
        assert len(np.unique(taken, axis=0)) == 20
        assert all((x == each).all(axis=1).any() for each in taken)


def test_a_shift_changes_what_is_learned_and_repeats_itself(replay):
    first, second, without = run(replay, 0.3), run(replay, 0.3), run(replay)
    np.testing.assert_array_equal(first[-1].thetas, second[-1].thetas)
    np.testing.assert_array_equal(first[0].thetas, without[0].thetas)
    assert not np.array_equal(first[-1].outputs[0], without[-1].outputs[0])


def test_shifts_are_uniform_and_rounded_to_samples(generator):
    rows = np.array([displace(50, [], 101, 0.1, 0.02, generator) for _ in range(4000)])
    shares = np.array([0.5, *[1.0] * 9, 0.5]) / 10
    found = np.bincount(rows - 45, minlength=11)
    assert stats.chisquare(found, 4000 * shares).pvalue > 1e-3
    assert stats.chisquare(found, np.full(11, 4000 / 11)).pvalue < 1e-3


@pytest.mark.parametrize(
    ("amplitude_s", "row", "taken", "samples", "kept"),
    [
        (0.035, 50, [], 101, {49, 50, 51}),  # samples beyond the amplitude are not reached
        (0.06, 1, [], 10, {0, 1, 2, 3, 4}),  # what leaves the trial is drawn again
        (0.06, 9, [], 10, {6, 7, 8, 9}),
        (0.04, 5, [4, 5, 7], 10, {3, 6}),  # and so is what is taken
    ],
)
def test_shifts_reach_free_samples_of_the_trial_within_the_amplitude(amplitude_s, row, taken, samples, kept, generator):
    assert {displace(row, taken, samples, amplitude_s, 0.02, generator) for _ in range(300)} == kept
    with pytest.raises(ValueError, match=rf"free sample within {amplitude_s} s of sample {row}"):
        displace(row, [*taken, *kept], samples, amplitude_s, 0.02, generator)


def test_amplitudes_share_their_uniform_numbers():
    for seed in range(50):
        short, long = (displace(500, [], 1001, each, 0.001, np.random.default_rng(seed)) - 500 for each in (0.1, 0.3))
        assert abs(long - 3 * short) <= 2


def test_recordings_of_other_movements_are_refused_and_those_of_its_own_tell_the_period(tables, replay):
    assert replay.period_s == pytest.approx(PERIOD_S, rel=1e-12)
    with pytest.raises(ValueError, match="expected recordings of movements"):
        Replay.read(replay.muscles, tables["bank"].query("trajectory > 0"))


def test_no_movement_left_is_said(replay):
    with pytest.raises(ValueError, match="neither executed yet nor excluded"):
        run(replay, trials=6)
    assert len(run(replay, trials=6, reuse_trajectories=True)) == 7


def test_errors_are_root_mean_squares_over_the_largest_force_of_the_test(tables, replay, generator):
    unseen = make_bank(generator, movements=3)
    test = ForceTest.read("unseen_bank", unseen, replay.muscles)
    known = run(replay)[-1]
    for index, name in enumerate(MUSCLES):
        rows, model = unseen[unseen["muscle"] == name], known.models[index]
        inputs = ["pressure_kpa", "contraction", "contraction_velocity_per_s"]
        points = ((rows[inputs] - [100, 0.1, 0]) / [30, 0.05, 0.2]).to_numpy()
        predicted, force = 50 + 15 * model.predict_mean(points), rows["force_n"].to_numpy()
        expected = np.sqrt(np.mean((predicted - force) ** 2)) / force.max()
        assert test.error_rates(known.models)[index] == pytest.approx(expected, rel=1e-6)
        assert test.largest_n[index] == force.max()


def test_models_learn_from_trials(tables, replay):
    test = ForceTest.read("bank", tables["bank"], replay.muscles)
    known = run(replay, trials=5)
    assert np.mean(test.error_rates(known[-1].models)) < 0.6 * np.mean(test.error_rates(known[0].models))


def test_settings_say_what_a_bank_cannot_serve():
    settings = LoopSettings(**LOOP)
    assert settings.check_against("time_shift", 5, 50) is settings
    for bank, told in (
        ((4, 50), r"time_shift\.loop\.trials: expected at most 2 \(4 movements"),
        ((5, 1), "expected at most the 1 samples of a trial"),
        ((5, 2), "expected at most the 4 samples of the 2 initial trials"),
    ):
        with pytest.raises(ValueError, match=told):
            settings.check_against("time_shift", *bank)
    reusing = settings.model_copy(update={"reuse_trajectories": True})
    assert reusing.check_against("time_shift", 2, 50) is reusing
    with pytest.raises(ValidationError, match="beyond which an exact GP takes days"):
        LoopSettings(**{**LOOP, "trials": 1000})


def test_the_number_of_displacements_is_that_of_the_muscles(replay):
    known = run(replay, trials=1)[0]
    recorded = [each[0] for each in replay.inputs], [each[0] for each in replay.outputs]
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        known.tell(0, *recorded, [draw(1), draw(2)], [lambda row, taken: row])


@pytest.fixture
def recorded(tables, generator):
    """Return tables, what was fitted to two trials of pam2, and the rows that tell of it."""
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
