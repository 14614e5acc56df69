"""Algorithm 1, with exact models of picked samples and with sparse models of all samples."""

from dataclasses import replace

import numpy as np
import pytest

from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.marginal import fit
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_interaction import SparseDesign, SparseInteraction
from stages.science.gp.sparse_marginal import condition_sparse
from stages.science.gp.subsample import subsample
from tests.science.gp.data import make_data, make_prior

SHARED = {"utility": "y_y", "reduce": "sum", "reuse_trajectories": False, "mean": "zero", "memory_mb": 8.0}
DESIGN = Design(**SHARED, subsample_utility="y_y", points_per_trial=2, joint_every=10, starts=3)
SPARSE = SparseDesign(**SHARED, pseudo_inputs=6, starts=2, first_iterations=30, iterations=8)
MUSCLES = 2


def generators(seed):
    return [np.random.default_rng([seed, muscle]) for muscle in range(MUSCLES)]


def measure(generator, count):
    """Return a list over muscles of inputs and one of outputs."""
    return [list(each) for each in zip(*(make_data(generator, count) for _ in range(MUSCLES)), strict=True)]


class Exact:
    """A muscle's exact model of the samples that were picked, by hand."""

    design, kind, count = DESIGN, Interaction, 8
    recorded = ("candidates", "inputs", "outputs", "thetas")

    def __init__(self, design, x, y, generator):
        self.design, self.x, self.y, self.prior = design, x, y, make_prior(mean=design.mean)
        self.model = fit(x, y, self.prior, design.mean, generator=generator, starts=3)

    def learn(self, x, y, generator):
        """Learn from a trial; return which samples were picked."""
        design, warm = self.design, (self.model.theta,)
        at = subsample(self.model, x, y, design.points_per_trial, design.subsample_utility)
        self.x, self.y = np.vstack([self.x, x[at]]), np.append(self.y, y[at])
        self.model = fit(self.x, self.y, self.prior, design.mean, generator=generator, starts=3, warm_starts=warm)
        return at.tolist()

    @property
    def found(self):
        return {"thetas": self.model.theta}


class Sparse:
    """A muscle's sparse model of all samples, by hand."""

    design, kind, count = SPARSE, SparseInteraction, 30
    recorded = (*Exact.recorded, "pseudo")

    def __init__(self, design, x, y, generator):
        self.design, self.x, self.y, self.prior = design, x, y, make_prior(mean=design.mean)
        self.fit = fit_sparse(x, y, 6, self.prior, design.mean, generator=generator, starts=2, iterations=30)

    def learn(self, x, y, generator):
        """Learn from a trial, from all of its samples and by no draw."""
        self.x, self.y = np.vstack([self.x, x]), np.append(self.y, y)
        data, warm = (self.x, self.y, 6, self.prior, self.design.mean), [(self.fit.pseudo, self.fit.theta)]
        self.fit = fit_sparse(*data, generator=np.random.default_rng(9), starts=0, warm_starts=warm, iterations=8)

    @property
    def model(self):
        return condition_sparse(self.x, self.y, self.fit.pseudo, self.fit.theta, self.prior, self.design.mean)

    @property
    def found(self):
        return {"thetas": self.fit.theta, "pseudo": self.fit.pseudo}


@pytest.fixture(params=[Exact, Sparse])
def way(request):
    return request.param


@pytest.fixture
def bank(generator):
    return tuple(np.cumsum(0.3 * generator.standard_normal((5, 40, 3)), axis=1) for _ in range(MUSCLES))


@pytest.fixture
def recordings(generator):
    """What three trials measured."""
    return [measure(generator, 30) for _ in range(3)]


def begin(way, bank, used=(), **changes):
    design = replace(way.design, **changes)
    data = measure(np.random.default_rng(5), way.count)
    return way.kind.begin(design, bank, [make_prior(mean=design.mean)] * MUSCLES, *data, used, generators(0))


def tell(interaction, *told):
    """Return the state that follows, and the picks where there are any."""
    after = interaction.tell(*told)
    return after if isinstance(after, tuple) else (after, None)


@pytest.mark.parametrize(
    ("way", "changes"),
    [
        (Exact, {}),
        (Exact, {"mean": "constant"}),
        (Exact, {"reduce": "max"}),
        (Exact, {"utility": "log_det", "joint_every": 4}),
        (Exact, {"utility": "variance", "subsample_utility": "f_f", "points_per_trial": 3}),
        (Sparse, {"mean": "constant", "reduce": "max"}),
        (Sparse, {"utility": "variance"}),
    ],
)
def test_ask_and_tell_are_the_algorithm_by_hand(way, changes, bank, recordings):
    interaction, executed = begin(way, bank, **changes), []
    design, data = interaction.design, measure(np.random.default_rng(5), way.count)
    muscles = [way(design, *each) for each in zip(*data, generators(0), strict=True)]
    for trial, recorded in enumerate(recordings, start=1):
        choice = interaction.ask(np.random.default_rng(trial))
        stride = {"stride": design.joint_every} if way is Exact else {}
        models = [each.model for each in muscles]
        scores = trajectory_utility(models, bank, design.utility, design.reduce, **stride)
        scores[executed] = -np.inf
        assert choice.trajectory == int(np.argmax(scores))
        np.testing.assert_allclose(choice.scores, scores, rtol=1e-9)
        executed.append(choice.trajectory)

        interaction, picks = tell(interaction, choice.trajectory, *recorded, generators(trial))
        for m, (muscle, x, y, own) in enumerate(zip(muscles, *recorded, generators(trial), strict=True)):
            picked = muscle.learn(x, y, own)
            assert picks is None or picks[m].tolist() == picked
            np.testing.assert_array_equal(interaction.inputs[m], muscle.x)
            np.testing.assert_array_equal(interaction.outputs[m], muscle.y)
            for name, values in muscle.found.items():
                np.testing.assert_allclose(getattr(interaction, name)[m], values, atol=1e-9)
    assert interaction.used == set(executed)
    assert len(set(executed)) == 3


def test_telling_leaves_a_state_alone_and_one_rebuilt_from_its_record_tells_the_same(way, bank, recordings):
    before = begin(way, bank)
    told, _ = tell(before, 1, *recordings[0], generators(1))
    assert [len(each) for each in before.inputs] == [way.count] * 2
    assert [len(each) for each in told.inputs] == [way.count + (2 if way is Exact else 30)] * 2
    assert (before.used, told.used) == (frozenset(), {1})
    rebuilt = replace(told, **{name: tuple(each.copy() for each in getattr(told, name)) for name in way.recorded})
    ask = np.random.default_rng(2)
    assert rebuilt.ask(ask).scores.tobytes() == told.ask(ask).scores.tobytes()
    first, second = (tell(each, 2, *recordings[1], generators(2)) for each in (told, rebuilt))
    for name in way.recorded:
        assert [x.tobytes() for x in getattr(first[0], name)] == [x.tobytes() for x in getattr(second[0], name)]
    np.testing.assert_equal(first[1], second[1])


def test_used_trajectories_are_excluded_unless_they_may_be_used_again(bank):
    free = begin(Exact, bank).ask(np.random.default_rng(0))
    barred = begin(Exact, bank, [free.trajectory, 0]).ask(np.random.default_rng(0))
    assert barred.scores[free.trajectory] == barred.scores[0] == -np.inf
    free.scores[[free.trajectory, 0]] = -np.inf
    assert barred.trajectory == np.argmax(free.scores)
    again = begin(Exact, bank, range(5), reuse_trajectories=True).ask(np.random.default_rng(0))
    assert again.trajectory == free.trajectory
    assert np.isfinite(again.scores).all()
    told = "neither executed yet nor excluded, but all 5 of the bank were; record a larger bank or allow reuse"
    with pytest.raises(ValueError, match=told):
        begin(Exact, bank, range(5)).ask(np.random.default_rng(0))


def test_random_choice_is_drawn_evenly_from_what_is_available_and_nothing_else_draws(way, bank):
    interaction = begin(way, bank, [1, 3], utility="random")
    draws = np.random.default_rng(3)
    chosen = [interaction.ask(draws).trajectory for _ in range(600)]
    assert set(chosen) == {0, 2, 4}
    assert min(chosen.count(each) for each in {0, 2, 4}) > 150
    assert interaction.ask(draws).scores is None
    assert [interaction.ask(np.random.default_rng(3)).trajectory for _ in range(3)] == [chosen[0]] * 3
    begin(way, bank).ask(draws := np.random.default_rng(3))
    assert draws.random() == np.random.default_rng(3).random()


def test_random_picks_are_distinct_and_follow_the_generators(bank, recordings):
    interaction = begin(Exact, bank, subsample_utility="random", points_per_trial=20)
    first, again, other = (interaction.tell(0, *recordings[0], generators(seed))[1] for seed in (1, 1, 2))
    assert [len(set(each)) for each in first] == [20] * MUSCLES
    for own, same, others in zip(first, again, other, strict=True):
        assert own.tolist() == same.tolist() != others.tolist()


def test_trajectories_and_muscles_that_are_not_there_are_refused(way, bank, recordings):
    interaction, (inputs, outputs) = begin(way, bank), recordings[0]
    for wrong in (-1, 5):
        with pytest.raises(ValueError, match=f"trajectory: expected 0 to 4, got {wrong}"):
            interaction.tell(wrong, inputs, outputs, generators(1))
    with pytest.raises(ValueError, match="used: expected trajectories 0 to 4, got 7"):
        begin(way, bank, [1, 7])
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        interaction.tell(0, inputs[:1], outputs[:1], generators(1))
    with pytest.raises(ValueError, match="expected 2 muscles, got 1"):
        begin(way, bank[:1])


@pytest.mark.parametrize("by", ["y_y", "random"])
def test_a_recording_with_too_few_samples_is_refused(by, bank, recordings):
    short = [[each[:1] for each in values] for values in recordings[0]]
    with pytest.raises(ValueError, match="count: expected between 0 and 1 picks, got 2"):
        begin(Exact, bank, subsample_utility=by).tell(0, *short, generators(1))


def test_a_sparse_design_that_makes_no_sense_is_refused(bank):
    with pytest.raises(ValueError, match="pseudo_count: expected between 1 and 30, the number of data, got 31"):
        begin(Sparse, bank, pseudo_inputs=31)
    with pytest.raises(ValueError, match="log_det takes exact models"):
        begin(Sparse, bank, utility="log_det").ask(np.random.default_rng(0))
