"""One active iteration: 4 muscles identified again and 160,000 candidates scored, against what the formula needs.

The floor is one matrix product for the distances, the exponential, and four N x N products with every candidate (one
for the variance, three for its slopes by the lengths), of the same shapes, in chunks of the same size, in the same run.
scikit-learn fits once from one start, its default, or from as many as the search here climbs from, and predicts means
and standard deviations of the same candidates, on the same single thread. It computes no slopes by hyperparameters.

Sparse models of all samples of ten trials are identified again from where they were before the last trial, with the
settings of the study, and score 40 trajectories of 200 candidates by y_y; exact ones are of as many points as
pseudo-inputs.
"""

import numpy as np
import pytest

from stages.science.gp.marginal import fit
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.sparse_interaction import SparseDesign, SparseInteraction
from tests.benchmarks.gp_libraries import fit_scikit_learn
from tests.benchmarks.problems import INPUTS, MUSCLES, PRIOR, TRAJECTORIES, Problem, force_law, read_section, walk
from tests.benchmarks.turns import peak_allocated_mb

ROUNDS, SPARSE_ROUNDS = 15, 5
CLIMBS = 4
TRIALS, CANDIDATES = 12, 200


LONG = [pytest.param(count, marks=pytest.mark.long) for count in (60, 120)]


@pytest.fixture(scope="module", params=[30, *LONG], ids="N={}".format)
def problem(request):
    return Problem(request.param)


def size(problem):
    return len(problem.inputs[0])


def test_iteration_against_the_floor(problem, against, tell):
    limits = {30: (3.0, 2.0), 60: (None, None), 120: (1.7, 1.4)}[size(problem)]
    ratio = against(problem.iterate, problem.floor, ROUNDS)
    tell(f"active iteration / floor, N = {size(problem)}", ratio, "", *limits)


def test_fit_against_the_floor(problem, against, tell):
    ratio = against(problem.fit_again, problem.floor, ROUNDS)
    tell(f"fit alone / floor, N = {size(problem)}", ratio)


def test_choice_against_the_floor(problem, against, tell):
    ratio = against(problem.choose_leader, problem.floor, ROUNDS)
    tell(f"choice by a bound and few scores / floor, N = {size(problem)}", ratio)


def fit_and_predict(problem, starts):
    for x, y, points in zip(problem.inputs, problem.outputs, problem.points, strict=True):
        fit_scikit_learn(x, y, starts).predict(points, return_std=True)


@pytest.mark.parametrize("starts", [1, CLIMBS])
def test_iteration_against_scikit_learn(problem, starts, against, tell):
    ratio = against(problem.iterate, lambda: fit_and_predict(problem, starts), 5)
    tell(
        f"active iteration / scikit-learn from {starts} start{'s' * (starts > 1)}, N = {size(problem)}", ratio, "", 1.0
    )


def test_memory_of_an_iteration(problem, benchmark, tell):
    peak = benchmark.pedantic(peak_allocated_mb, args=(problem.iterate,), rounds=1)
    tell(f"memory beyond the output, N = {size(problem)}", peak, "MB", 64.0)


class SparseProblem:
    """All samples of twelve trials, of which the last is about to be told."""

    def __init__(self, samples):
        section = read_section("sparse_loop")
        generator = np.random.default_rng(20261121)
        self.starts, self.pseudo_inputs = section.exact_starts, section.pseudo_inputs
        self.candidates = [walk(generator, TRAJECTORIES, CANDIDATES) for _ in range(MUSCLES)]
        self.inputs = [walk(generator, TRIALS, samples).reshape(-1, INPUTS) for _ in range(MUSCLES)]
        self.outputs = [force_law(x) + 0.05 * generator.standard_normal(len(x)) for x in self.inputs]
        taken = ("reduce", "memory_mb", "pseudo_inputs", "first_iterations", "iterations")
        given = {"utility": "y_y", "reuse_trajectories": False, "mean": "zero", "starts": 1}
        design = SparseDesign(**given, **{name: section[name] for name in taken})
        earlier = [x[:-samples] for x in self.inputs], [y[:-samples] for y in self.outputs]
        self.last = [x[-samples:] for x in self.inputs], [y[-samples:] for y in self.outputs]
        self.known = SparseInteraction.begin(
            design, self.candidates, [PRIOR] * MUSCLES, *earlier, [], self.generators()
        )

    def generators(self):
        return [np.random.default_rng(muscle) for muscle in range(MUSCLES)]

    def iterate(self):
        return trajectory_utility(self.known.tell(0, *self.last, self.generators()).models, self.candidates, "y_y")

    def iterate_exactly(self):
        at = np.linspace(0, len(self.outputs[0]) - 1, self.pseudo_inputs).astype(int)
        data = zip(self.inputs, self.outputs, self.generators(), strict=True)
        models = [fit(x[at], y[at], PRIOR, generator=each, starts=self.starts) for x, y, each in data]
        return trajectory_utility(models, self.candidates, "y_y")


@pytest.fixture(
    scope="module", params=[200, pytest.param(1000, marks=pytest.mark.long)], ids=lambda kept: f"N={kept * TRIALS}"
)
def sparse(request):
    return SparseProblem(request.param)


def test_sparse_iteration_against_the_exact_one(sparse, against, tell):
    ratio = against(sparse.iterate, sparse.iterate_exactly, SPARSE_ROUNDS)
    tell(f"trial with sparse models, N = {size(sparse)} / exact, N = {sparse.pseudo_inputs}", ratio)


def test_seconds_of_a_sparse_iteration(sparse, benchmark, sized, tell):
    benchmark.pedantic(sparse.iterate, rounds=sized(SPARSE_ROUNDS), warmup_rounds=1)
    tell(f"trial with sparse models, N = {size(sparse)}", benchmark.stats.stats.median, "s")


def test_memory_of_a_sparse_iteration(sparse, benchmark, tell):
    most, exact = (peak_allocated_mb(each) for each in (sparse.iterate, sparse.iterate_exactly))
    benchmark.pedantic(sparse.iterate, rounds=1)
    tell(f"memory of a trial with sparse models, N = {size(sparse)}", most, "MB")
    tell(f"memory of a trial with exact models, N = {sparse.pseudo_inputs}", exact, "MB")
