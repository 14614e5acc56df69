from dataclasses import replace

import numpy as np
import pytest

from stages.gp import SparseDesign, SparseInteraction, condition_sparse, fit_sparse, trajectory_utility
from tests.gp.data import make_data, make_prior

DESIGN = SparseDesign(
    utility="y_y",
    reduce="sum",
    reuse_trajectories=False,
    mean="zero",
    memory_mb=8.0,
    pseudo_inputs=6,
    starts=2,
    first_iterations=30,
    iterations=8,
)
MUSCLES = 2


def generators(seed):
    return [np.random.default_rng([seed, muscle]) for muscle in range(MUSCLES)]


@pytest.fixture
def bank(generator):
    return tuple(np.cumsum(0.3 * generator.standard_normal((5, 40, 3)), axis=1) for _ in range(MUSCLES))


@pytest.fixture
def data(generator):
    return [make_data(generator, 30) for _ in range(MUSCLES)]


@pytest.fixture
def recordings(generator):
    """What two trials measured: each a list over muscles of inputs and one of outputs."""
    trials = [[make_data(generator, 40) for _ in range(MUSCLES)] for _ in range(2)]
    return [([x for x, _ in trial], [y for _, y in trial]) for trial in trials]


def begin(bank, data, design=DESIGN, used=()):
    priors = [make_prior(mean=design.mean)] * MUSCLES
    return SparseInteraction.begin(
        design, bank, priors, [x for x, _ in data], [y for _, y in data], used, generators(0)
    )


@pytest.mark.parametrize(
    "design",
    [DESIGN, replace(DESIGN, mean="constant", reduce="max"), replace(DESIGN, utility="variance")],
    ids=["y_y", "constant mean, max", "variance"],
)
def test_ask_and_tell_are_the_algorithm_by_hand(design, bank, data, recordings):
    prior, mean = make_prior(mean=design.mean), design.mean
    known = [(x.copy(), y.copy()) for x, y in data]
    found = [
        fit_sparse(x, y, 6, prior, mean, generator=each, starts=2, iterations=30)
        for (x, y), each in zip(known, generators(0), strict=True)
    ]
    interaction, executed = begin(bank, data, design), []
    for trial, (inputs, outputs) in enumerate(recordings, start=1):
        models = [condition_sparse(*known[m], found[m].pseudo, found[m].theta, prior, mean) for m in range(MUSCLES)]
        choice = interaction.ask(np.random.default_rng(trial))
        scores = trajectory_utility(models, bank, design.utility, design.reduce)
        scores[executed] = -np.inf
        assert choice.trajectory == int(np.argmax(scores))
        np.testing.assert_allclose(choice.scores, scores, rtol=1e-9)
        executed.append(choice.trajectory)

        interaction = interaction.tell(choice.trajectory, inputs, outputs, generators(trial))
        for m, (x, y) in enumerate(zip(inputs, outputs, strict=True)):
            known[m] = np.vstack([known[m][0], x]), np.append(known[m][1], y)
            warm = [(found[m].pseudo, found[m].theta)]
            found[m] = fit_sparse(
                *known[m], 6, prior, mean, generator=generators(9)[m], starts=0, warm_starts=warm, iterations=8
            )
            np.testing.assert_array_equal(interaction.inputs[m], known[m][0])
            np.testing.assert_array_equal(interaction.outputs[m], known[m][1])
            np.testing.assert_allclose(interaction.thetas[m], found[m].theta, atol=1e-9)
            np.testing.assert_allclose(interaction.pseudo[m], found[m].pseudo, atol=1e-9)
    assert interaction.used == set(executed)


def test_the_same_is_told_by_a_state_rebuilt_from_its_record(bank, data, recordings):
    told = begin(bank, data).tell(1, *recordings[0], generators(1))
    names = ("candidates", "inputs", "outputs", "thetas", "pseudo")
    rebuilt = replace(told, **{name: tuple(each.copy() for each in getattr(told, name)) for name in names})
    ask = np.random.default_rng(2)
    assert rebuilt.ask(ask).scores.tobytes() == told.ask(ask).scores.tobytes()
    first, second = (each.tell(2, *recordings[1], generators(2)) for each in (told, rebuilt))
    for name in ("thetas", "pseudo"):
        assert [each.tobytes() for each in getattr(first, name)] == [each.tobytes() for each in getattr(second, name)]


def test_telling_never_ends_below_the_models_that_it_began_with(bank, data, recordings):
    before = begin(bank, data)
    after = before.tell(0, *recordings[0], generators(1))
    for m in range(MUSCLES):
        held = condition_sparse(after.inputs[m], after.outputs[m], before.pseudo[m], before.thetas[m], make_prior())
        assert after.models[m].log_posterior > held.log_posterior
    assert [len(each) for each in before.inputs] == [30, 30]
    assert [len(each) for each in after.inputs] == [70, 70]
    assert (before.used, after.used) == (frozenset(), {0})


def test_random_is_drawn_from_what_is_left(bank, data):
    interaction = begin(bank, data, replace(DESIGN, utility="random"), used=[1, 3])
    draws = np.random.default_rng(3)
    chosen = [interaction.ask(draws) for _ in range(100)]
    assert {each.trajectory for each in chosen} == {0, 2, 4}
    assert all(each.scores is None for each in chosen)


def test_what_makes_no_sense_is_refused(bank, data, recordings):
    inputs, outputs = recordings[0]
    interaction = begin(bank, data)
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        interaction.tell(0, inputs[:1], outputs[:1], generators(1))
    with pytest.raises(ValueError, match="trajectory: expected 0 to 4, got 5"):
        interaction.tell(5, inputs, outputs, generators(1))
    with pytest.raises(ValueError, match="used: expected trajectories 0 to 4, got 7"):
        begin(bank, data, used=[7])
    with pytest.raises(ValueError, match="pseudo_count: expected between 1 and 30, the number of data, got 31"):
        begin(bank, data, replace(DESIGN, pseudo_inputs=31))
    with pytest.raises(ValueError, match="log_det takes exact models"):
        begin(bank, data, replace(DESIGN, utility="log_det")).ask(np.random.default_rng(0))
