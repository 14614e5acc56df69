from dataclasses import replace

import numpy as np
import pytest

from stages.gp import Design, Interaction, condition, fit, subsample, trajectory_utility
from tests.gp.data import make_data, make_prior

DESIGN = Design(
    utility="y_y",
    subsample_utility="y_y",
    reduce="sum",
    points_per_trial=2,
    reuse_trajectories=False,
    log_det_every=10,
    mean="zero",
    starts=3,
    memory_mb=8.0,
)
MUSCLES = 2


def generators(seed):
    return [np.random.default_rng([seed, muscle]) for muscle in range(MUSCLES)]


@pytest.fixture
def bank(generator):
    return tuple(np.cumsum(0.3 * generator.standard_normal((5, 40, 3)), axis=1) for _ in range(MUSCLES))


@pytest.fixture
def data(generator):
    return [make_data(generator, 8) for _ in range(MUSCLES)]


@pytest.fixture
def recordings(generator):
    """What three trials measured: each a list over muscles of inputs and one of outputs."""
    trials = [[make_data(generator, 30) for _ in range(MUSCLES)] for _ in range(3)]
    return [([x for x, _ in trial], [y for _, y in trial]) for trial in trials]


def begin(bank, data, design=DESIGN, used=()):
    priors = [make_prior(mean=design.mean)] * MUSCLES
    return Interaction.begin(design, bank, priors, [x for x, _ in data], [y for _, y in data], used, generators(0))


@pytest.mark.parametrize(
    "design",
    [
        DESIGN,
        replace(DESIGN, mean="constant"),
        replace(DESIGN, reduce="max"),
        replace(DESIGN, utility="log_det", log_det_every=4),
        replace(DESIGN, utility="variance", subsample_utility="f_f", points_per_trial=3),
    ],
    ids=["y_y", "constant mean", "max", "log_det", "variance"],
)
def test_ask_and_tell_are_the_algorithm_by_hand(design, bank, data, recordings):
    prior = make_prior(mean=design.mean)
    known = [(x.copy(), y.copy()) for x, y in data]
    models = [
        fit(x, y, prior, design.mean, generator=each, starts=3)
        for (x, y), each in zip(known, generators(0), strict=True)
    ]
    interaction = begin(bank, data, design)
    executed = []
    for trial, (inputs, outputs) in enumerate(recordings, start=1):
        choice = interaction.ask(np.random.default_rng(trial))
        scores = trajectory_utility(models, bank, design.utility, design.reduce, stride=design.log_det_every)
        scores[executed] = -np.inf
        assert choice.trajectory == int(np.argmax(scores))
        np.testing.assert_allclose(choice.scores, scores, rtol=1e-9)
        executed.append(choice.trajectory)

        interaction, picks = interaction.tell(choice.trajectory, inputs, outputs, generators(trial))
        for muscle, own in enumerate(generators(trial)):
            x, y = inputs[muscle], outputs[muscle]
            at = subsample(models[muscle], x, y, design.points_per_trial, design.subsample_utility)
            assert picks[muscle].tolist() == at.tolist()
            known[muscle] = np.vstack([known[muscle][0], x[at]]), np.append(known[muscle][1], y[at])
            warm = (models[muscle].theta,)
            models[muscle] = fit(*known[muscle], prior, design.mean, generator=own, starts=3, warm_starts=warm)
            np.testing.assert_allclose(interaction.thetas[muscle], models[muscle].theta, atol=1e-9)
            assert (interaction.inputs[muscle] == known[muscle][0]).all()
            assert (interaction.outputs[muscle] == known[muscle][1]).all()
    assert interaction.used == set(executed)
    assert len(set(executed)) == 3


def test_the_same_is_told_by_a_state_rebuilt_from_its_record(bank, data, recordings):
    told, _ = begin(bank, data).tell(1, *recordings[0], generators(1))
    rebuilt = Interaction(
        told.design,
        tuple(each.copy() for each in told.candidates),
        told.priors,
        tuple(each.copy() for each in told.inputs),
        tuple(each.copy() for each in told.outputs),
        tuple(each.copy() for each in told.thetas),
        frozenset({1}),
    )
    ask = np.random.default_rng(2)
    assert rebuilt.ask(ask).scores.tobytes() == told.ask(ask).scores.tobytes()
    first, second = (each.tell(2, *recordings[1], generators(2)) for each in (told, rebuilt))
    assert [each.tobytes() for each in first[0].thetas] == [each.tobytes() for each in second[0].thetas]
    assert [each.tolist() for each in first[1]] == [each.tolist() for each in second[1]]


def test_telling_leaves_what_was_known_before_alone(bank, data, recordings):
    before = begin(bank, data)
    after, _ = before.tell(0, *recordings[0], generators(1))
    assert [len(each) for each in before.inputs] == [8, 8]
    assert [len(each) for each in after.inputs] == [10, 10]
    assert before.used == frozenset()
    assert after.used == {0}


def test_models_stand_on_data_and_recorded_theta(bank, data):
    interaction = begin(bank, data)
    for (x, y), theta, model in zip(data, interaction.thetas, interaction.models, strict=True):
        expected = condition(x, y, theta, make_prior()).predict(bank[0][0])
        np.testing.assert_array_equal(model.predict(bank[0][0]), expected)


def test_used_trajectories_are_excluded(bank, data):
    free = begin(bank, data).ask(np.random.default_rng(0))
    barred = begin(bank, data, used=[free.trajectory, 0]).ask(np.random.default_rng(0))
    assert barred.trajectory not in {free.trajectory, 0}
    assert barred.scores[free.trajectory] == barred.scores[0] == -np.inf
    left = [index for index in range(5) if index not in {free.trajectory, 0}]
    assert barred.trajectory == max(left, key=lambda index: free.scores[index])


def test_reuse_allows_a_used_trajectory(bank, data):
    allowed = replace(DESIGN, reuse_trajectories=True)
    best = begin(bank, data, allowed).ask(np.random.default_rng(0)).trajectory
    again = begin(bank, data, allowed, used=range(5)).ask(np.random.default_rng(0))
    assert again.trajectory == best
    assert np.isfinite(again.scores).all()


def test_an_exhausted_bank_is_said(bank, data):
    exhausted = begin(bank, data, used=range(5))
    told = "expected a trajectory that was not executed yet, but all 5 of the bank were; record a larger bank or allow "
    with pytest.raises(ValueError, match=f"{told}reuse"):
        exhausted.ask(np.random.default_rng(0))


def test_random_choice_is_drawn_evenly_from_what_is_available(bank, data):
    interaction = begin(bank, data, replace(DESIGN, utility="random"), used=[1, 3])
    draws = np.random.default_rng(3)
    chosen = [interaction.ask(draws).trajectory for _ in range(600)]
    assert set(chosen) == {0, 2, 4}
    assert min(chosen.count(each) for each in {0, 2, 4}) > 150
    assert interaction.ask(draws).scores is None
    repeated = [interaction.ask(np.random.default_rng(3)).trajectory for _ in range(3)]
    assert repeated == [chosen[0]] * 3


def test_only_the_random_control_draws(bank, data):
    draws = np.random.default_rng(3)
    begin(bank, data).ask(draws)
    assert draws.random() == np.random.default_rng(3).random()


def test_random_picks_are_distinct_and_follow_the_generators(bank, data, recordings):
    interaction = begin(bank, data, replace(DESIGN, subsample_utility="random", points_per_trial=20))
    first, again, other = (interaction.tell(0, *recordings[0], generators(seed))[1] for seed in (1, 1, 2))
    for muscle in range(MUSCLES):
        assert len(set(first[muscle])) == 20
        assert first[muscle].tolist() == again[muscle].tolist()
        assert first[muscle].tolist() != other[muscle].tolist()


def test_a_trajectory_that_is_not_in_the_bank_is_refused(bank, data, recordings):
    interaction = begin(bank, data)
    for wrong in (-1, 5):
        with pytest.raises(ValueError, match=f"trajectory: expected 0 to 4, got {wrong}"):
            interaction.tell(wrong, *recordings[0], generators(1))
    with pytest.raises(ValueError, match="used: expected trajectories 0 to 4, got 7"):
        begin(bank, data, used=[1, 7])


def test_muscles_that_are_missing_are_refused(bank, data, recordings):
    inputs, outputs = recordings[0]
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        begin(bank, data).tell(0, inputs[:1], outputs[:1], generators(1))
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        begin(bank[:1], data)


def test_a_recording_with_too_few_samples_is_refused(bank, data, recordings):
    inputs, outputs = recordings[0]
    for by in ("y_y", "random"):
        interaction = begin(bank, data, replace(DESIGN, subsample_utility=by))
        with pytest.raises(ValueError, match="count: expected between 0 and 1 picks, got 2"):
            interaction.tell(0, [x[:1] for x in inputs], [y[:1] for y in outputs], generators(1))
