"""The maximum of a sparse GP's log density, over pseudo-inputs and hyperparameters, from several starts.

A start has the centres of clusters of data for pseudo-inputs, and the hyperparameters of an exact GP fitted to a few
rows. scipy's L-BFGS-B climbs from each, in bounds that no sensible model reaches, and the highest point of all is kept:
what is returned is never below a start. A climb stops where a step gains less than `GAIN` of the value, where the
largest slope is below `SLOPE`, or after the given number of iterations.
"""

from collections.abc import Sequence

import numpy as np

from stages.science.gp.factor import FactorisationError
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array
from stages.science.gp.marginal import fit
from stages.science.gp.posterior import LARGEST_LOG, check_points, read_theta
from stages.science.gp.sparse import SparsePosterior
from stages.science.gp.sparse_model import SparseGP

GAIN = 1e-9
SLOPE = 1e-5
SPAN = 10.0
"""Logarithms may leave those of the starts by so much."""
LOWEST_NOISE = 1e-4
"""Smallest noise SD in units of the outputs' SD when no hyperprior says what it is like."""
SUBSET = 64
"""Rows of the exact GP whose hyperparameters are a start."""
CLUSTERED = 2000
"""Rows that are clustered, at most."""
ROUNDS = 10
"""Of clustering."""

Start = tuple[Array, Array]


def fit_sparse(
    inputs: Array,
    outputs: Array,
    pseudo_count: int,
    prior: Hyperprior | None,
    mean: str = "zero",
    *,
    generator: np.random.Generator,
    starts: int = 3,
    warm_starts: Sequence[Start] = (),
    hold_pseudo: bool = False,
    iterations: int = 300,
) -> SparseGP:
    """Return the sparse GP at the highest maximum found.

    Parameters
    ----------
    inputs, outputs, prior, mean
        As of `fit`; no hyperprior for the largest likelihood.
    pseudo_count : int
        M, at most N.
    generator, starts : Generator, int
        Draws so many starts, beside the warm ones; every one is climbed.
    warm_starts : sequence of ((M, D), (P,)) pairs of float arrays
        Pseudo-inputs and theta to climb from too.
    hold_pseudo : bool
        Whether pseudo-inputs stay where a start has them, and hyperparameters alone are searched.
    iterations : int
        Of each climb, at most.

    Raises
    ------
    ValueError
        When a shape or a number does not fit or a value is not finite.
    FactorisationError
        When the likelihood can be evaluated at no start.
    """
    posterior = SparsePosterior(inputs, outputs, prior, mean)
    n = len(posterior.outputs)
    if not 1 <= pseudo_count <= n:
        raise ValueError(f"pseudo_count: expected between 1 and {n}, the number of data, got {pseudo_count}")
    for name, number in (("starts", starts), ("iterations", iterations)):
        if number < 0:
            raise ValueError(f"{name}: expected at least 0, got {number}")
    if not starts and not warm_starts:
        raise ValueError("starts: expected at least 1 without warm starts, got 0")
    places = [_check_start(posterior, pseudo_count, *each) for each in warm_starts]
    for _ in range(starts):
        places.append((_draw_pseudo(posterior, pseudo_count, generator), _draw_theta(posterior, generator)))
    found, reasons = [], []
    for start in places:
        try:
            found.append(_climb(posterior, start, hold_pseudo, iterations))
        except FactorisationError as error:
            reasons.append(error)
    if not found:
        raise FactorisationError(f"no start has a likelihood that can be evaluated: {reasons[0]}")
    return SparseGP(posterior, *max(found, key=lambda each: each[0])[1])


def _climb(posterior: SparsePosterior, start: Start, hold_pseudo: bool, iterations: int) -> tuple[float, Start]:
    """Climb from one start; return the highest value met and where, never below the start."""
    from scipy.optimize import Bounds, minimize  # a fifth of a second that most commands need not wait for

    shape, size = start[0].shape, 0 if hold_pseudo else start[0].size
    scale = np.abs(posterior.inputs - posterior.centre).max(axis=0)
    scale[scale == 0] = 1.0

    best = posterior.value(*start), start
    worst = best[0] - 1e3 * (1.0 + abs(best[0]))

    def evaluate(at: Array) -> tuple[float, Array]:
        nonlocal best
        pseudo = start[0] if hold_pseudo else at[:size].reshape(shape) * scale + posterior.centre
        try:
            found = posterior.derivatives(pseudo, at[size:])
        except FactorisationError:
            return -worst, np.zeros_like(at)
        if found.value > best[0]:
            best = found.value, (pseudo.copy(), at[size:].copy())
        return -found.value, -np.append((found.pseudo * scale).ravel()[:size], found.theta)

    relative = ((start[0] - posterior.centre) / scale).ravel()[:size]
    lower, upper = _bounds(posterior, start[1])
    bounds = Bounds(np.append(np.minimum(-3.0, relative), lower), np.append(np.maximum(3.0, relative), upper))
    if iterations:
        minimize(
            evaluate,
            np.append(relative, start[1]),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 20, "ftol": GAIN, "gtol": SLOPE},
        )
    return best


def _draw_pseudo(posterior: SparsePosterior, count: int, generator: np.random.Generator) -> Array:
    """Return centres of clusters of the data, (count, D): Lloyd's rounds from rows drawn at random."""
    rows = posterior.inputs
    scale = rows.std(axis=0)
    rows = rows[generator.permutation(len(rows))[: max(CLUSTERED, count)]]
    scaled = (rows - posterior.centre) / np.where(scale > 0, scale, 1.0)
    centres = scaled[:count].copy()
    for _ in range(ROUNDS):
        nearest = np.argmin(0.5 * (centres**2).sum(axis=1) - scaled @ centres.T, axis=1)
        filled = np.bincount(nearest, minlength=count)
        totals = np.zeros_like(centres)
        np.add.at(totals, nearest, scaled)
        centres = np.where(filled[:, None] > 0, totals / np.maximum(filled, 1)[:, None], centres)
    return np.asarray(centres * scale + posterior.centre)


def _draw_theta(posterior: SparsePosterior, generator: np.random.Generator) -> Array:
    """Return hyperparameters of an exact GP fitted to rows drawn at random, (P,), or the hyperprior's mean."""
    rows = generator.permutation(len(posterior.outputs))[:SUBSET]
    prior = posterior.prior or _guess_prior(posterior)
    x, y = posterior.inputs[rows], posterior.outputs[rows]
    try:
        theta = fit(x, y, prior, posterior.mean, generator=generator, starts=2).theta
    except FactorisationError:
        theta = prior.mean
    return np.clip(theta, *_bounds(posterior, theta))


def _guess_prior(posterior: SparsePosterior) -> Hyperprior:
    """Return a wide hyperprior around the data's own scales: to start with, not counted."""
    spread, height = posterior.inputs.std(axis=0), _height(posterior)
    spread[spread == 0] = 1.0
    means = np.concatenate([np.log(spread), np.log([height, 0.1 * height])])
    variances = np.ones(means.size)
    if posterior.mean == "constant":
        means, variances = np.append(means, posterior.outputs.mean()), np.append(variances, height**2)
    return Hyperprior(means, variances)


def _height(posterior: SparsePosterior) -> float:
    return float(posterior.outputs.std()) or 1.0


def _bounds(posterior: SparsePosterior, theta: Array) -> tuple[Array, Array]:
    """Return the lower and upper bounds of theta, which lies within them."""
    d = posterior.inputs.shape[1]
    lower, upper = np.full(theta.size, -np.inf), np.full(theta.size, np.inf)
    lower[: d + 2] = np.maximum(theta[: d + 2] - SPAN, -LARGEST_LOG)
    upper[: d + 2] = np.minimum(theta[: d + 2] + SPAN, LARGEST_LOG)
    if posterior.prior is None:
        lower[d + 1] = max(lower[d + 1], min(np.log(LOWEST_NOISE * _height(posterior)), theta[d + 1]))
    return lower, upper


def _check_start(posterior: SparsePosterior, count: int, pseudo: Array, theta: Array) -> Start:
    pseudo = check_points(pseudo, posterior.inputs.shape[1], "warm start")
    if len(pseudo) != count:
        raise ValueError(f"warm start: expected {count} pseudo-inputs, got {len(pseudo)}")
    theta = np.asarray(theta, dtype=float)
    read_theta(theta, posterior.inputs.shape[1], posterior.size)
    return pseudo, theta
