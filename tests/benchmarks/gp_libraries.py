"""Gaussian processes of other libraries, at the work of an active iteration; each is imported where it is used.

A `Problem` flows in, and a `Prepared` peer flows out: parts to be timed, and how far what it computed agrees with ours.
All models are of double precision and on one thread. Where a library takes one, the hyperprior is ours.
"""

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from stages.science.gp.integrated_variance import TaskVariance
from stages.science.gp.kernel import Array
from tests.benchmarks.problems import INPUTS, PRIOR, Problem

CHUNK = 1000
"""Candidates that a peer predicts at a time; with all at once the slowest of them needs gigabytes."""
CLIMBS = 4
MOST_ITERATIONS = 200
SCORED_BY_BALD, PICKED_FROM = 200, 50
CENTRE, SPREAD = PRIOR.mean, np.sqrt(PRIOR.variance)
SLOPES_APART = "slopes of m and V: largest difference, of the largest"
SD_APART = "SD of f: median relative difference"


@dataclass
class Prepared:
    """A peer with its data.

    Parameters
    ----------
    parts : sequence of (callable, float)
        What is timed, and how many times it is needed: other than once where a part alone is computed.
    agree : callable
        Returns how far what the parts computed agrees with ours.
    compile_s : float
        Seconds of compilation, which are not in those of the parts.
    """

    parts: Sequence[tuple[Callable[[], Any], float]]
    agree: Callable[[], float]
    compile_s: float = np.nan


@dataclass(frozen=True)
class Peer:
    """What is compared.

    Parameters
    ----------
    name, own, of : str
        Of the peer; the key of our task in its place; what `agree` tells.
    needs : tuple of str
        Packages that it imports.
    beyond, lacks : str
        What it computes that we do not, and what we compute that it does not.
    prepare : callable
        Takes a `Problem`.
    once : bool
        Whether it is too slow for several rounds.
    limit : float
        Of what `agree` returns, where both must agree.
    note : str
        How much of it was computed, where that is not all.
    """

    name: str
    own: str
    of: str
    needs: tuple[str, ...]
    beyond: str
    lacks: str
    prepare: Callable[[Problem], Prepared]
    once: bool = False
    limit: float = np.inf
    note: str = ""


@dataclass
class Kept:
    """What the last timed call returned, by muscle."""

    values: dict[int, Any] = field(default_factory=dict)


def hold_to_one_thread() -> None:
    """Set what libraries read when they are imported; a later `set_num_threads` is in `torch_double`."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings of other libraries, such as of inputs that are not in a unit cube."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def torch_double() -> Any:
    """Return torch, with double precision and one thread."""
    import torch

    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    return torch


def predict_in_each(
    fit: Callable[[Array, Array], Any], predict: Callable[[Any, Array], Array]
) -> Callable[[Problem], Prepared]:
    """Return what fits every muscle's data and predicts the standard deviation of f at all its candidates."""

    def prepare(problem: Problem) -> Prepared:
        kept = Kept()

        def run() -> None:
            data = zip(problem.inputs, problem.outputs, problem.points, strict=True)
            with quiet():
                for muscle, (x, y, points) in enumerate(data):
                    kept.values[muscle] = predict(fit(x, y), points)

        def agree() -> float:
            ours = [np.sqrt(m.predict(p)[1]) for m, p in zip(problem.models, problem.points, strict=True)]
            return float(np.median([np.abs(kept.values[k] / sd - 1.0) for k, sd in enumerate(ours)]))

        return Prepared([(run, 1.0)], agree)

    return prepare


def in_chunks(points: Array) -> list[Array]:
    """Return the candidates, chunk by chunk."""
    return np.split(points, range(CHUNK, len(points), CHUNK))


def fit_scikit_learn(x: Array, y: Array, starts: int) -> GaussianProcessRegressor:
    """Return scikit-learn's model at the largest likelihood that it finds from so many starts."""
    kernel = ConstantKernel(1.0) * RBF(np.ones(INPUTS)) + WhiteKernel(0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = GaussianProcessRegressor(kernel, alpha=0.0, n_restarts_optimizer=starts - 1, random_state=0)
        return model.fit(x, y)


def predict_scikit_learn(model: GaussianProcessRegressor, points: Array) -> Array:
    """Return the standard deviation of f, (B,); the model's own is of a measurement."""
    noise = model.kernel_.k2.noise_level
    return np.sqrt(np.maximum(np.square(model.predict(points, return_std=True)[1]) - noise, 1e-12))


def build_priors(x: Array) -> tuple[Any, Any]:
    """Return GPyTorch's kernel and likelihood with our hyperprior, on logarithms as ours is."""
    torch = torch_double()
    from gpytorch.kernels import RBFKernel, ScaleKernel
    from gpytorch.likelihoods import GaussianLikelihood
    from gpytorch.priors import NormalPrior

    def normal(at: Any) -> Any:
        return NormalPrior(torch.tensor(CENTRE[at]), torch.tensor(SPREAD[at]))

    base = RBFKernel(ard_num_dims=x.shape[1])
    kernel, likelihood = ScaleKernel(base), GaussianLikelihood()
    base.register_prior("lengths", normal(slice(INPUTS)), lambda each: each.lengthscale.log())
    kernel.register_prior("signal", normal(INPUTS), lambda each: 0.5 * each.outputscale.log())
    noise = likelihood.noise_covar
    noise.register_prior("level", normal(INPUTS + 1), lambda each: 0.5 * each.noise.log())
    base.lengthscale = torch.tensor(np.exp(CENTRE[:INPUTS]))
    kernel.outputscale = float(np.exp(2 * CENTRE[INPUTS]))
    noise.noise = float(np.exp(2 * CENTRE[INPUTS + 1]))
    return kernel, likelihood


def fit_gpytorch(x: Array, y: Array) -> Any:
    """Return GPyTorch's exact model at its MAP, climbed by L-BFGS from the hyperprior's mean."""
    torch = torch_double()
    from gpytorch import ExactMarginalLogLikelihood
    from gpytorch.distributions import MultivariateNormal
    from gpytorch.means import ZeroMean
    from gpytorch.models import ExactGP

    class Model(ExactGP):
        def __init__(self, likelihood: Any, kernel: Any):
            super().__init__(torch.tensor(x), torch.tensor(y), likelihood)
            self.mean_module, self.covar_module = ZeroMean(), kernel

        def forward(self, at: Any) -> Any:
            return MultivariateNormal(self.mean_module(at), self.covar_module(at))

    kernel, likelihood = build_priors(x)
    model = Model(likelihood, kernel)
    objective = ExactMarginalLogLikelihood(likelihood, model)
    climber = torch.optim.LBFGS(
        model.parameters(), max_iter=MOST_ITERATIONS, line_search_fn="strong_wolfe", tolerance_grad=1e-7
    )

    def close() -> Any:
        climber.zero_grad()
        loss = -objective(model(*model.train_inputs), model.train_targets)
        loss.backward()
        return loss

    climber.step(close)
    return model.eval()


def predict_gpytorch(model: Any, points: Array) -> Array:
    """Return the standard deviation of f, (B,)."""
    torch = torch_double()
    from gpytorch.settings import fast_pred_var

    with torch.no_grad(), fast_pred_var():
        found = [model(torch.tensor(each)[:, None]).variance[:, 0].numpy() for each in in_chunks(points)]
        return np.sqrt(np.concatenate(found))


def fit_botorch(x: Array, y: Array) -> Any:
    """Return BoTorch's SingleTaskGP at its MAP: its own priors, standardisation and climb."""
    torch = torch_double()
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch import ExactMarginalLogLikelihood

    model = SingleTaskGP(torch.tensor(x), torch.tensor(y)[:, None])
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def predict_botorch(model: Any, points: Array) -> Array:
    """Return the standard deviation of f, (B,)."""
    torch = torch_double()
    with torch.no_grad():
        found = [model.posterior(torch.tensor(each)[:, None]).variance[:, 0, 0].numpy() for each in in_chunks(points)]
        return np.sqrt(np.concatenate(found))


def fit_botorch_as_ours(x: Array, y: Array) -> Any:
    """Return BoTorch's model with our hyperprior, kernel and mean, at its MAP."""
    torch = torch_double()
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch import ExactMarginalLogLikelihood
    from gpytorch.means import ZeroMean

    kernel, likelihood = build_priors(x)
    model = SingleTaskGP(
        torch.tensor(x),
        torch.tensor(y)[:, None],
        likelihood=likelihood,
        covar_module=kernel,
        mean_module=ZeroMean(),
        outcome_transform=None,
    )
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def pick_with_botorch(model: Any, task: Array, inputs: Array, count: int) -> list[int]:
    """Return the rows of (T, D) inputs that qNegIntegratedPosteriorVariance picks greedily, (count,)."""
    torch = torch_double()
    from botorch.acquisition.active_learning import qNegIntegratedPosteriorVariance

    points, picks = torch.tensor(inputs), list[int]()
    for _ in range(count):
        pending = points[picks] if picks else None
        score = qNegIntegratedPosteriorVariance(model, mc_points=torch.tensor(task), X_pending=pending)
        with torch.no_grad():
            values = score(points[:, None])
        values[picks] = -torch.inf
        picks.append(int(values.argmax()))
    return picks


def prepare_integrated_variance(problem: Problem) -> Prepared:
    """All models are fitted; the first muscle's samples are picked among some of its first trajectory."""
    tasks, every, count = problem.task
    candidates, kept = problem.candidates[0][0, ::every], Kept()
    inputs = candidates[:: max(1, len(candidates) // PICKED_FROM)]

    def fit() -> None:
        with quiet():
            for muscle, (x, y) in enumerate(zip(problem.inputs, problem.outputs, strict=True)):
                kept.values[muscle] = fit_botorch_as_ours(x, y)

    def pick() -> None:
        with quiet():
            kept.values[-1] = pick_with_botorch(kept.values[0], tasks[0], inputs, count)

    def agree() -> float:
        ours = TaskVariance(problem.models[0], tasks[0]).pick(inputs, count)[0]
        return len(set(ours) & set(kept.values[-1])) / count

    everything = sum(map(len, problem.candidates)) * len(candidates) / len(inputs)
    return Prepared([(fit, 1.0), (pick, everything)], agree)


def prepare_fully_bayesian(problem: Problem) -> Prepared:
    """The first muscle's model is sampled by NUTS, as the library has it, and some of its candidates are scored."""
    kept, points = Kept(), problem.points[0][:: max(1, len(problem.points[0]) // SCORED_BY_BALD)]

    def sample() -> None:
        torch = torch_double()
        from botorch.fit import fit_fully_bayesian_model_nuts
        from botorch.models.fully_bayesian import FullyBayesianSingleTaskGP

        with quiet():
            x, y = torch.tensor(problem.inputs[0]), torch.tensor(problem.outputs[0])[:, None]
            kept.values[0] = FullyBayesianSingleTaskGP(x, y)
            fit_fully_bayesian_model_nuts(kept.values[0], disable_progbar=True)

    def score() -> None:
        torch = torch_double()
        from botorch.acquisition.bayesian_active_learning import qBayesianActiveLearningByDisagreement

        with quiet(), torch.no_grad():
            found = qBayesianActiveLearningByDisagreement(kept.values[0])(torch.tensor(points)[:, None])
            kept.values[1] = found.numpy().reshape(len(points), -1).mean(axis=1)

    def agree() -> float:
        ours = problem.models[0].utility(points, "hyperparameter_information")
        return float(spearmanr(ours, kept.values[1]).statistic)

    everything = sum(map(len, problem.points)) / len(points)
    return Prepared([(sample, float(len(problem.inputs))), (score, everything)], agree)


def build_moments(x: Array, y: Array) -> Callable[[Any, Any], Any]:
    """Return our predictive mean and variance as a JAX function of theta, (P,), and (C, B, D) points, (2, C, B)."""
    import jax
    import jax.numpy as jnp
    from jax.scipy.linalg import solve_triangular

    def covary(theta: Any, first: Any, second: Any) -> Any:
        scaled = (first[:, None] - second) / jnp.exp(theta[:INPUTS])
        return jnp.exp(2 * theta[INPUTS] - 0.5 * jnp.square(scaled).sum(axis=-1))

    def moments(theta: Any, chunks: Any) -> Any:
        noisy = covary(theta, x, x) + jnp.exp(2 * theta[INPUTS + 1]) * jnp.eye(len(x))
        inverse = solve_triangular(jnp.linalg.cholesky(noisy), np.eye(len(x)), lower=True)
        weights = inverse.T @ (inverse @ y)

        def predict(points: Any) -> Any:
            k = covary(theta, x, points)
            return jnp.stack([weights @ k, jnp.exp(2 * theta[INPUTS]) - jnp.square(inverse @ k).sum(axis=0)])

        return jnp.moveaxis(jax.lax.map(predict, chunks), 1, 0)

    return moments


def prepare_jax(problem: Problem) -> Prepared:
    """Derivatives of our formula by forward differentiation, compiled before for each muscle's data."""
    import jax

    jax.config.update("jax_enable_x64", True)
    kept, begun, compiled = Kept(), process_time(), []
    for x, y, theta, points in zip(problem.inputs, problem.outputs, thetas(problem), problem.points, strict=True):
        given = theta, points.reshape(-1, min(CHUNK, len(points)), INPUTS)
        differentiate = jax.jit(jax.jacfwd(build_moments(x, y)))
        compiled.append((differentiate.lower(*given).compile(), given))
    compile_s = process_time() - begun

    def run() -> None:
        for muscle, (differentiate, given) in enumerate(compiled):
            kept.values[muscle] = differentiate(*given).block_until_ready()

    def agree() -> float:
        apart = []
        for muscle, ours in enumerate(problem.differentiate()):
            theirs = np.asarray(kept.values[muscle]).reshape(2, -1, len(PRIOR.mean))
            apart += [np.abs(b - a).max() / np.abs(a).max() for a, b in zip(ours, theirs, strict=True)]
        return float(max(apart))

    return Prepared([(run, 1.0)], agree, compile_s)


def thetas(problem: Problem) -> list[Array]:
    """Return every muscle's MAP."""
    return [model.theta for model in problem.models]


def fit_gpy(x: Array, y: Array) -> Any:
    """Return GPy's model at the largest likelihood, by its own climb from its own start."""
    import GPy

    model = GPy.models.GPRegression(x, y[:, None], GPy.kern.RBF(x.shape[1], ARD=True))
    model.optimize()
    return model


def predict_gpy(model: Any, points: Array) -> Array:
    """Return the standard deviation of f, (B,)."""
    found = [model.predict_noiseless(each)[1][:, 0] for each in in_chunks(points)]
    return np.sqrt(np.maximum(np.concatenate(found), 1e-12))


Y_Y, TASK, SLOPES = "identify, score by y_y", "identify, choose for a task", "slopes by theta"
PEERS = (
    *(
        Peer(
            f"scikit-learn, {starts} start{'s' * (starts > 1)}",
            Y_Y,
            SD_APART,
            (),
            "the mean",
            "hyperprior, uncertainty of theta",
            predict_in_each(lambda x, y, starts=starts: fit_scikit_learn(x, y, starts), predict_scikit_learn),
        )
        for starts in (1, CLIMBS)
    ),
    Peer(
        "GPyTorch, MAP",
        Y_Y,
        SD_APART,
        ("torch", "gpytorch"),
        "gradients by the candidates, on demand",
        "uncertainty of theta, further starts",
        predict_in_each(fit_gpytorch, predict_gpytorch),
    ),
    Peer(
        "BoTorch SingleTaskGP",
        Y_Y,
        SD_APART,
        ("torch", "botorch"),
        "the mean",
        "uncertainty of theta, further starts",
        predict_in_each(fit_botorch, predict_botorch),
    ),
    Peer(
        "GPy, 1 start",
        Y_Y,
        SD_APART,
        ("GPy",),
        "the mean",
        "hyperprior, uncertainty of theta, further starts",
        predict_in_each(fit_gpy, predict_gpy),
    ),
    Peer(
        "BoTorch qNegIntegratedPosteriorVariance",
        TASK,
        "share of the picks that are ours",
        ("torch", "botorch"),
        "gradients by the candidates, on demand",
        "further starts",
        prepare_integrated_variance,
        note="fitted in full; 50 of 250 samples of 1 of 160 trajectories were scored",
    ),
    Peer(
        "BoTorch NUTS, qBALD",
        Y_Y,
        "rank correlation with hyperparameter_information",
        ("torch", "botorch", "numpyro"),
        "the posterior of theta beyond a Gaussian; its mean over draws",
        "a closed form: its scores are estimates from 16 draws of theta",
        prepare_fully_bayesian,
        once=True,
        note="1 of 4 muscles was sampled, and 200 of its 40,000 candidates scored",
    ),
    Peer(
        "JAX jacfwd of our formula",
        SLOPES,
        SLOPES_APART,
        ("jax",),
        "derivatives of any order, on demand",
        "the fit, scores, and bounded memory",
        prepare_jax,
        limit=1e-6,
    ),
)
OWN: dict[str, Callable[[Problem], Callable[[], Any]]] = {
    Y_Y: lambda problem: problem.iterate,
    TASK: lambda problem: problem.choose,
    SLOPES: lambda problem: problem.differentiate,
}
