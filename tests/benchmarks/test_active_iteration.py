"""One active iteration: 4 muscles identified again and 160,000 candidates scored, against what the formula needs.

The floor is one matrix product for the distances, the exponential, and four N x N products with every candidate (one
for the variance, three for its slopes by the lengths), of the same shapes, in chunks of the same size, in the same run.
scikit-learn fits once from one start, its default, or from as many as the search here climbs from, and predicts means
and standard deviations of the same candidates, on the same single thread. It computes no slopes by hyperparameters.

Sparse models of all samples of ten trials are identified again from where they were before the last trial, with the
settings of the study, and score 40 trajectories of 200 candidates by y_y; exact ones are of as many points as
pseudo-inputs.
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
from stages.science.gp.sparse_interaction import SparseDesign, SparseInteraction
from tests.benchmarks.conftest import peak_memory_mb
from tests.conftest import ROOT

MUSCLES, TRAJECTORIES, SAMPLES, INPUTS = 4, 40, 1000, 3
CHUNK = 1024
ROUNDS, SPARSE_ROUNDS = 15, 5
CLIMBS = 4
TRIALS, CANDIDATES = 12, 200
PRIOR = Hyperprior(np.array([1.4, 0.9, 0.9, 0.4, -2.5]), np.array([0.5, 0.5, 0.5, 0.5, 1.0]))


def read_section(name):
    """The loop's own settings in the paper's design."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config", overrides=["workflow=paper"])[name]


def walk(generator, trajectories, samples):
    time = np.linspace(0.0, 4.0, samples)
    phases = generator.uniform(0, 2 * np.pi, (trajectories, 1, INPUTS))
    speeds = generator.uniform(1.0, 4.0, (trajectories, 1, INPUTS))
    return 1.5 * np.sin(phases + speeds * time[:, None])


def force_law(x):
    """A force in standard units: pressure against contraction, with friction that follows the velocity's sign."""
    p, c, v = x.T
    return (0.6 + 0.3 * p) * (1.1 - 0.7 * c + 0.1 * c**2) - 0.15 * np.tanh(4 * v)


class Problem:
    """Data and candidates of every muscle."""

    def __init__(self, points):
        generator = np.random.default_rng(20261121)
        self.candidates = np.split(walk(generator, MUSCLES * TRAJECTORIES, SAMPLES), MUSCLES)
        self.inputs, self.outputs = [], []
        for bank in self.candidates:
            rows = bank.reshape(-1, INPUTS)
            x = rows[generator.choice(len(rows), points, replace=False)]
            self.inputs.append(x)
            self.outputs.append(force_law(x) + 0.05 * generator.standard_normal(points))
        self.design = read_section("active_loop")
        self.thetas = [model.theta for model in self.identify([(), (), (), ()])]

    def identify(self, warm):
        starts, data = self.design.starts, zip(self.inputs, self.outputs, warm, strict=True)
        return [
            fit(x, y, PRIOR, generator=np.random.default_rng(muscle), starts=starts, warm_starts=thetas)
            for muscle, (x, y, thetas) in enumerate(data)
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
    most, exact = (peak_memory_mb(each) for each in (sparse.iterate, sparse.iterate_exactly))
    benchmark.pedantic(sparse.iterate, rounds=1)
    tell(f"memory of a trial with sparse models, N = {size(sparse)}", most, "MB")
    tell(f"memory of a trial with exact models, N = {sparse.pseudo_inputs}", exact, "MB")
