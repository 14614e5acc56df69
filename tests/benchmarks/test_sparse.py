"""The sparse GP's log density with its gradient, for 40,000 data, against what the formula needs.

The floor is one matrix product for the distances, the exponential, and two products of an M x M matrix with M x N
numbers (one whitens the covariance, one leads back to its slopes), in blocks of the same size, in the same run.
"""

import numpy as np
import pytest

from stages.science.gp.sparse import BLOCK, SparsePosterior
from stages.science.gp.sparse_fit import fit_sparse
from tests.benchmarks.conftest import peak_memory_mb

POINTS, PSEUDO, INPUTS = 40_000, 30, 3


class Problem:
    """Data of a smooth law, pseudo-inputs among them and a theta."""

    def __init__(self):
        generator = np.random.default_rng(20261121)
        self.x = generator.uniform(-1.5, 1.5, (POINTS, INPUTS))
        smooth = np.sin(1.5 * self.x[:, 0]) + 0.4 * (self.x**2).sum(axis=1) - 1.5
        self.y = smooth + 0.1 * generator.standard_normal(POINTS)
        self.pseudo = generator.uniform(-1.5, 1.5, (PSEUDO, INPUTS))
        self.theta = np.array([0.3, 0.3, 0.3, 0.2, -2.0])
        self.posterior = SparsePosterior(self.x, self.y)
        self.left = np.column_stack([self.pseudo, -0.5 * (self.pseudo**2).sum(axis=1), np.ones(PSEUDO)])
        self.right = np.vstack([self.x.T, np.ones(POINTS), -0.5 * (self.x**2).sum(axis=1)])
        self.square = generator.standard_normal((PSEUDO, PSEUDO))
        self.k, self.product = np.empty((2, PSEUDO, BLOCK))

    def value(self):
        return self.posterior.value(self.pseudo, self.theta)

    def derivatives(self):
        return self.posterior.derivatives(self.pseudo, self.theta)

    def floor(self):
        """Do what no way of computing the gradient can leave out."""
        for start in range(0, POINTS, BLOCK):
            right = self.right[:, start : start + BLOCK]
            k, product = (each[:, : right.shape[1]] for each in (self.k, self.product))
            np.matmul(self.left, right, out=k)
            np.exp(k, out=k)
            for _ in range(2):
                np.matmul(self.square, k, out=product)


@pytest.fixture(scope="module")
def problem():
    return Problem()


def test_value_and_gradient_against_the_floor(problem, against, tell):
    ratio = against(problem.derivatives, problem.floor, 30)
    tell(f"sparse GP: value and gradient / floor, N = {POINTS}, M = {PSEUDO}", ratio)


def test_value_against_the_floor(problem, against, tell):
    ratio = against(problem.value, problem.floor, 30)
    tell(f"sparse GP: value alone / floor, N = {POINTS}, M = {PSEUDO}", ratio)


def test_seconds_of_value_and_gradient(problem, benchmark, sized, tell):
    benchmark.pedantic(problem.derivatives, rounds=sized(30), warmup_rounds=1)
    tell("sparse GP: value and gradient", 1e3 * benchmark.stats.stats.median, "ms")


def test_a_fit(problem, benchmark, sized, tell):
    iterations = sized(50, 10)

    def run():
        generator = np.random.default_rng(0)
        return fit_sparse(problem.x, problem.y, PSEUDO, None, generator=generator, starts=1, iterations=iterations)

    benchmark.pedantic(run, rounds=1)
    tell(f"sparse GP: fit from one start, {iterations} iterations", benchmark.stats.stats.median, "s")


def test_memory_of_value_and_gradient(problem, benchmark, tell):
    peak = benchmark.pedantic(peak_memory_mb, args=(problem.derivatives,), rounds=1)
    tell("sparse GP: memory of one gradient beyond what stays", peak, "MB")
