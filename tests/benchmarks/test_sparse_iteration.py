"""One trial's work with sparse models of all samples, against that with exact ones of as many points as pseudo-inputs.

Four muscles are identified again, the sparse models from where they were before the last trial, and 40 trajectories of
200 candidates are scored by y_y, with the settings of the study; data are as many as after ten trials.
"""

import numpy as np
import pytest
from hydra import compose, initialize_config_dir

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import fit
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.sparse_interaction import SparseDesign, SparseInteraction
from tests.benchmarks.conftest import peak_memory_mb
from tests.benchmarks.test_active_iteration import force_law
from tests.conftest import ROOT

MUSCLES, TRAJECTORIES, CANDIDATES, INPUTS = 4, 40, 200, 3
TRIALS = 12
ROUNDS = 5


class Problem:
    """All samples of twelve trials, of which the last is about to be told."""

    def __init__(self, samples):
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            section = compose("config", overrides=["workflow=paper"]).sparse_loop
        generator = np.random.default_rng(20261121)
        self.starts, self.pseudo_inputs = section.exact_starts, section.pseudo_inputs
        self.candidates = [self.walk(generator, TRAJECTORIES, CANDIDATES) for _ in range(MUSCLES)]
        self.inputs = [self.walk(generator, TRIALS, samples).reshape(-1, INPUTS) for _ in range(MUSCLES)]
        self.outputs = [force_law(x) + 0.05 * generator.standard_normal(len(x)) for x in self.inputs]
        self.prior = Hyperprior(np.array([1.4, 0.9, 0.9, 0.4, -2.5]), np.array([0.5, 0.5, 0.5, 0.5, 1.0]))
        design = SparseDesign(
            utility="y_y",
            reduce=section.reduce,
            reuse_trajectories=False,
            mean="zero",
            memory_mb=section.memory_mb,
            pseudo_inputs=self.pseudo_inputs,
            starts=1,
            first_iterations=section.first_iterations,
            iterations=section.iterations,
        )
        earlier = [x[:-samples] for x in self.inputs], [y[:-samples] for y in self.outputs]
        self.last = [x[-samples:] for x in self.inputs], [y[-samples:] for y in self.outputs]
        priors = [self.prior] * MUSCLES
        self.known = SparseInteraction.begin(design, self.candidates, priors, *earlier, [], self.generators())

    @staticmethod
    def walk(generator, trajectories, samples):
        time = np.linspace(0.0, 4.0, samples)
        phases = generator.uniform(0, 2 * np.pi, (trajectories, 1, INPUTS))
        speeds = generator.uniform(1.0, 4.0, (trajectories, 1, INPUTS))
        return 1.5 * np.sin(phases + speeds * time[:, None])

    def generators(self):
        return [np.random.default_rng(muscle) for muscle in range(MUSCLES)]

    def iterate(self):
        return trajectory_utility(self.known.tell(0, *self.last, self.generators()).models, self.candidates, "y_y")

    def iterate_exactly(self):
        at = np.linspace(0, len(self.outputs[0]) - 1, self.pseudo_inputs).astype(int)
        data = zip(self.inputs, self.outputs, self.generators(), strict=True)
        models = [fit(x[at], y[at], self.prior, generator=each, starts=self.starts) for x, y, each in data]
        return trajectory_utility(models, self.candidates, "y_y")


@pytest.fixture(
    scope="module", params=[200, pytest.param(1000, marks=pytest.mark.long)], ids=lambda kept: f"N={kept * TRIALS}"
)
def problem(request):
    return Problem(request.param)


def size(problem):
    return len(problem.outputs[0])


def test_iteration_against_the_exact_one(problem, against, tell):
    ratio = against(problem.iterate, problem.iterate_exactly, ROUNDS)
    tell(f"trial with sparse models, N = {size(problem)} / exact, N = {problem.pseudo_inputs}", ratio)


def test_seconds_of_an_iteration(problem, benchmark, sized, tell):
    benchmark.pedantic(problem.iterate, rounds=sized(ROUNDS), warmup_rounds=1)
    tell(f"trial with sparse models, N = {size(problem)}", benchmark.stats.stats.median, "s")


def test_memory_of_an_iteration(problem, benchmark, tell):
    sparse, exact = (peak_memory_mb(each) for each in (problem.iterate, problem.iterate_exactly))
    benchmark.pedantic(problem.iterate, rounds=1)
    tell(f"memory of a trial with sparse models, N = {size(problem)}", sparse, "MB")
    tell(f"memory of a trial with exact models, N = {problem.pseudo_inputs}", exact, "MB")
