"""One active iteration: 4 muscles identified again and 160,000 candidates scored, against what the formula needs.

The floor is one matrix product for the distances, the exponential, and four N x N products with every candidate (one
for the variance, three for its slopes by the lengths), of the same shapes, in chunks of the same size, in the same run.
scikit-learn fits once from one start, its default, or from as many as the search here climbs from, and predicts means
and standard deviations of the same candidates, on the same single thread. It computes no slopes by hyperparameters.
"""

import warnings

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import fit
from stages.science.gp.scoring import trajectory_utility
from tests.benchmarks.conftest import peak_memory_mb
from tests.conftest import ROOT

MUSCLES, TRAJECTORIES, SAMPLES, INPUTS = 4, 40, 1000, 3
CHUNK = 1024
ROUNDS = 15
CLIMBS = 4


def design():
    """The active loop's own settings."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config").active_loop


def force_law(x):
    """A force in standard units: pressure against contraction, with friction that follows the velocity's sign."""
    p, c, v = x.T
    return (0.6 + 0.3 * p) * (1.1 - 0.7 * c + 0.1 * c**2) - 0.15 * np.tanh(4 * v)


class Problem:
    """Data, candidates and the hyperprior of every muscle."""

    def __init__(self, points):
        generator = np.random.default_rng(20261121)
        time = np.linspace(0.0, 4.0, SAMPLES)
        phases = generator.uniform(0, 2 * np.pi, (MUSCLES, TRAJECTORIES, 1, INPUTS))
        speeds = generator.uniform(1.0, 4.0, (MUSCLES, TRAJECTORIES, 1, INPUTS))
        self.candidates = list(1.5 * np.sin(phases + speeds * time[:, None]))
        self.inputs, self.outputs = [], []
        for bank in self.candidates:
            rows = bank.reshape(-1, INPUTS)
            x = rows[generator.choice(len(rows), points, replace=False)]
            self.inputs.append(x)
            self.outputs.append(force_law(x) + 0.05 * generator.standard_normal(points))
        means = np.array([1.4, 0.9, 0.9, 0.4, -2.5])
        self.prior = Hyperprior(means, np.array([0.5, 0.5, 0.5, 0.5, 1.0]))
        self.design = design()
        self.thetas = [model.theta for model in self.identify([(), (), (), ()])]

    def identify(self, warm):
        return [
            fit(
                x,
                y,
                self.prior,
                generator=np.random.default_rng(muscle),
                starts=self.design.starts,
                warm_starts=warm[muscle],
            )
            for muscle, (x, y) in enumerate(zip(self.inputs, self.outputs, strict=True))
        ]

    def fit_again(self):
        return self.identify([(theta,) for theta in self.thetas])

    def score(self, models):
        return trajectory_utility(models, self.candidates, self.design.utility, memory_mb=self.design.memory_mb)

    def iterate(self):
        return self.score(self.fit_again())

    def floor(self):
        """Do what no way of computing the utility can leave out."""
        for x, bank in zip(self.inputs, self.candidates, strict=True):
            points = bank.reshape(-1, INPUTS)
            n = len(x)
            left = np.column_stack([x, -0.5 * (x**2).sum(axis=1), np.ones(n)])
            right = np.ones((INPUTS + 2, CHUNK))
            square = np.random.default_rng(0).standard_normal((n, n))
            k, product = np.empty((2, n, CHUNK))
            for start in range(0, len(points), CHUNK):
                chunk = points[start : start + CHUNK].T
                count = chunk.shape[1]
                right[:INPUTS, :count] = chunk
                right[-1, :count] = -0.5 * np.einsum("db,db->b", chunk, chunk)
                np.matmul(left, right[:, :count], out=k[:, :count])
                np.exp(k[:, :count], out=k[:, :count])
                for _ in range(1 + INPUTS):
                    np.matmul(square, k[:, :count], out=product[:, :count])

    def fit_and_predict_with_scikit_learn(self, starts):
        for x, y, bank in zip(self.inputs, self.outputs, self.candidates, strict=True):
            kernel = ConstantKernel(1.0) * RBF(np.ones(INPUTS)) + WhiteKernel(0.01)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)
                model = GaussianProcessRegressor(kernel, alpha=0.0, n_restarts_optimizer=starts - 1, random_state=0)
                model.fit(x, y)
            model.predict(bank.reshape(-1, INPUTS), return_std=True)


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


@pytest.mark.parametrize("starts", [1, CLIMBS])
def test_iteration_against_scikit_learn(problem, starts, against, tell):
    ratio = against(problem.iterate, lambda: problem.fit_and_predict_with_scikit_learn(starts), 5)
    tell(
        f"active iteration / scikit-learn from {starts} start{'s' * (starts > 1)}, N = {size(problem)}", ratio, "", 1.0
    )


def test_memory_of_an_iteration(problem, benchmark, tell):
    peak = benchmark.pedantic(peak_memory_mb, args=(problem.iterate,), rounds=1)
    tell(f"memory beyond the output, N = {size(problem)}", peak, "MB", 64.0)
