"""The active iteration that benchmarks measure: data, candidates and a task of every muscle, and what none can omit."""

from functools import cache, cached_property

import numpy as np
from hydra import compose, initialize_config_dir

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.integrated_variance import INTEGRATED_VARIANCE
from stages.science.gp.leaders import score_leaders
from stages.science.gp.marginal import MarginalGP, fit
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.task_utilities import task_utility
from tests.conftest import ROOT

MUSCLES, TRAJECTORIES, SAMPLES, INPUTS = 4, 40, 1000, 3
CHUNK = 1024
SEED = 20261121
PRIOR = Hyperprior(np.array([1.4, 0.9, 0.9, 0.4, -2.5]), np.array([0.5, 0.5, 0.5, 0.5, 1.0]))


@cache
def read_section(name, workflow="paper"):
    """A section of a workflow's own settings, by default the paper's design."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config", overrides=[f"workflow={workflow}"])[name]


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

    def __init__(self, points, muscles=MUSCLES, trajectories=TRAJECTORIES, samples=SAMPLES):
        generator = np.random.default_rng(SEED)
        self.candidates = np.split(walk(generator, muscles * trajectories, samples), muscles)
        self.inputs, self.outputs = [], []
        for bank in self.candidates:
            rows = bank.reshape(-1, INPUTS)
            x = rows[generator.choice(len(rows), points, replace=False)]
            self.inputs.append(x)
            self.outputs.append(force_law(x) + 0.05 * generator.standard_normal(points))
        self.design = read_section("active_loop")
        self.thetas = [model.theta for model in self.identify([()] * muscles)]

    @cached_property
    def models(self):
        """The muscles' models as identified again."""
        return self.fit_again()

    def renew_models(self):
        """Return the models as a fit leaves them: nothing is computed yet that their predictions need."""
        return [MarginalGP(each.posterior, each.theta) for each in self.models]

    @cached_property
    def task(self):
        """Inputs of every muscle for which its model is wanted, and how the identification's design scores for them."""
        generator = np.random.default_rng(SEED + 1)
        section, design = (read_section(each, "identification") for each in ("task", "active_loop"))
        samples = section.samples // section.trajectories
        inputs = [walk(generator, section.trajectories, samples).reshape(-1, INPUTS) for _ in self.inputs]
        return inputs, design.joint_every, design.points_per_trial

    @property
    def points(self):
        """Each muscle's candidates, (B, D)."""
        return [bank.reshape(-1, INPUTS) for bank in self.candidates]

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

    def choose_leader(self):
        """Choose by the paper's utility, with scores of those trajectories alone that a bound does not exclude."""
        models, every = self.renew_models(), np.arange(len(self.candidates[0]))
        return score_leaders(models, self.candidates, every, self.design.memory_mb).argmax()

    def iterate(self):
        return self.score(self.fit_again())

    def score_for_task(self, models):
        """Score trajectories by what their best samples take from the task's variance."""
        tasks, every, count = self.task
        thinned = [each[:, ::every] for each in self.candidates]
        return task_utility(models, tasks, thinned, count, INTEGRATED_VARIANCE)

    def choose(self):
        return self.score_for_task(self.fit_again())

    def differentiate(self):
        """Return the slopes of mean and variance of all candidates by the hyperparameters."""
        return [model.sensitivities(each) for model, each in zip(self.models, self.points, strict=True)]

    def floor(self):
        """Do what no way of computing the utility can leave out."""
        for x, points in zip(self.inputs, self.points, strict=True):
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
