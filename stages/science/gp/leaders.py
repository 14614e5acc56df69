"""The trajectories of a bank that may be the best by `y_y`: a bound excludes the others at less cost than their scores.

Exact models and candidates flow in; scores flow out, minus infinity where a trajectory is not the best for certain.

With K = sum_j lam_j q_j q_j', s^2 the noise and h_j = q_j'k / sqrt(lam_j + s^2), let r eigenvectors be kept, rho =
lam / (lam + s^2) of the first that is not, and R = sf^2 - sum_j<=r h_j^2 (lam_j + s^2) / lam_j. As sum_j (q_j'k)^2 /
lam_j <= sf^2 over all j (the variance given f itself at the data is not negative), the rest of any sum of w_j
(q_j'k)^2 / lam_j is at most R max_j>r w_j. Hence, with U = sf^2 - sum_j<=r h_j^2::

    V is in [U - rho R, U], and s^2 b'b exceeds its first r terms by at most R rho (1 - rho)
    dV/dlog l_d = -2 |y_d|^2 with y_d = (M_d - x*_d) h, M_d = (Lam + s^2)^1/2 Q' diag(x_d) Q (Lam + s^2)^-1/2
    the rest changes |y_d| by at most sqrt(R) (|M_d diag(rho)^1/2 of the rest| + |x*_d| sqrt(rho))

(x in units of the lengths; y_d is C^1/2 (b o (x - x*)) in the eigenvectors, as long as the L' (b o (x - x*)) of
`prediction`; rho (1 - rho) grows with rho < 1/2). The mean's slopes are linear in k, and exact. With S = T T'::

    |T' dV| changes by at most sum_i S_ii^1/2 |change of dV_i|: a bound of q = |T' dm|^2 + |T' dV|^2 / (3 V) from above
    exp(2 y_y) = 4/3 + (q - s^2 / 3) / (V + s^2)

is monotonic in V: the end of V's interval that the sign of q - s^2 / 3 tells gives the bound. The truncation is that of
Karhunen and Loeve, the exclusion branch and bound (Land and Doig 1960).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.distance import keeps_digits
from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP
from stages.science.gp.prediction import limit_chunk
from stages.science.gp.scoring import trajectory_utility

BOUNDED = "y_y"
LEAST_POINTS = 40
"""Data of a model below which all scores are hardly dearer than bounds."""
LEAST_NOISE = 1e-6
"""Of the signal's variance; below, rounding would make bounds wide. Above, no factor needs jitter."""
ROUNDED, ROUNDING = 1e-9, 1e-6
"""Allowances for rounding: of variances, of the signal's (see `keeps_digits`); of all else, of the bound."""
TIED = 1e-9
"""Of the best score, within which the order of a second one is not certain: then all are computed."""
LARGEST_REST, LARGEST_CHANGE, LARGEST_SHARE, DROPPED = 0.02, 0.15, 0.75, 0.02
"""Of rho, of the change of |T' dV| over R, of the eigenvectors that are kept before all are, and of |M_d| over sn / sf:
what took least time. Bounds hold whatever they are, rho below 1/2."""


def score_leaders(
    models: Sequence[MarginalGP], candidates: Sequence[Array], available: NDArray[np.intp], memory_mb: float
) -> Array:
    """Return the sums of `y_y` of the (R,) trajectories that may be the best of those available, of the best at least.

    Takes what `trajectory_utility` takes; elsewhere scores are minus infinity. The largest score is that of the same
    trajectory as without bounds.
    """
    scores = np.full(len(candidates[0]), -np.inf)
    inputs = [each[available] for each in candidates]
    if not all(map(_is_bounded, models)):
        scores[available] = trajectory_utility(models, candidates, BOUNDED, memory_mb=memory_mb)[available]
        return scores
    bounds = np.sum(
        [Bound(model).of_trajectories(x, memory_mb) for model, x in zip(models, inputs, strict=True)], axis=0
    )
    for row in np.argsort(-bounds):
        if bounds[row] < scores.max():
            break
        one = [each[row : row + 1] for each in inputs]
        scores[available[row]] = trajectory_utility(models, one, BOUNDED, memory_mb=memory_mb)[0]
    if np.sum(scores >= scores.max() * (1 - TIED)) > 1:
        scores[available] = trajectory_utility(models, candidates, BOUNDED, memory_mb=memory_mb)[available]
    return scores


def _is_bounded(model: MarginalGP) -> bool:
    read, scaled = model.hyperparameters, (model.inputs - model.inputs.mean(axis=0)) / model.hyperparameters.lengths
    return bool(
        len(scaled) >= LEAST_POINTS
        and model.posterior.mean == "zero"
        and read.noise_variance >= LEAST_NOISE * read.signal_variance
        and keeps_digits(scaled, read.signal_variance, read.noise_variance)
    )


class Bound:
    """Upper bounds of an exact model's `y_y`; the model has a zero mean and needed no jitter."""

    def __init__(self, model: MarginalGP):
        read, data = model.hyperparameters, model.inputs
        self._signal, self._noise, self._lengths = read.signal_variance, read.noise_variance, read.lengths
        self._rounded, self._least = (each * self._signal for each in (ROUNDED, len(data) * np.finfo(float).eps))
        self._centre, self._root = data.mean(axis=0), model.laplace.root.T
        self._sd = np.sqrt(np.diag(model.laplace.covariance))
        scaled = (data - self._centre) / read.lengths
        half_norms = 0.5 * np.einsum("nd,nd->n", scaled, scaled)
        self._left = np.column_stack([scaled, np.log(self._signal) - half_norms, np.ones(len(data))])

        values, vectors = (each[..., ::-1] for each in np.linalg.eigh(model.posterior.covariance(model.theta)))
        values = np.maximum(values, np.finfo(float).tiny)
        roots, rest = np.sqrt(values + self._noise), values / (values + self._noise)
        moved = np.stack([roots[:, None] * (vectors.T * column @ vectors) / roots for column in scaled.T])
        kept = self._keep(rest, moved, np.abs(scaled).max(axis=0))
        self._split(kept, rest, moved)
        sure = np.maximum(1.0 - len(data) * np.finfo(float).eps * values[0] / values[:kept], 0.0)
        self._sums = np.vstack([np.ones(kept), sure / rest[:kept], 1.0 - rest[:kept]])
        self._rows = np.vstack([(vectors / roots).T[:kept], _find_slopes(model, scaled)])

    def _keep(self, rest: Array, moved: Array, reach: Array) -> int:
        """Return how many eigenvectors are kept; any number is right."""
        d, n = len(reach), len(rest)
        norms = np.cumsum((np.square(moved).sum(axis=1) * rest)[:, ::-1], axis=1)[:, ::-1]
        change = 2.0 * self._sd[:d] @ (np.sqrt(norms) + reach[:, None] * np.sqrt(rest)) ** 2 + 4.0 * self._sd[d] * rest
        enough = np.append((change < LARGEST_CHANGE) & (rest < LARGEST_REST), True)
        kept = int(np.argmax(enough))
        return kept if kept <= LARGEST_SHARE * n else n

    def _split(self, kept: int, rest: Array, moved: Array) -> None:
        beyond = moved[:, :, kept:] * np.sqrt(rest[kept:])
        self._beyond = np.linalg.norm(beyond, 2, axis=(1, 2)) if beyond.size else np.zeros(len(moved))
        self._rest = float(rest[kept]) if beyond.size else 0.0
        across, self._dropped = _compress(moved[:, kept:, :kept], DROPPED * np.sqrt(self._noise / self._signal))
        self._moved = np.concatenate([moved[:, :kept, :kept], across], axis=1).astype(np.float32)
        self._size = np.linalg.norm(moved[:, :, :kept], axis=(1, 2))

    def of_trajectories(self, trajectories: Array, memory_mb: float) -> Array:
        """Return a bound of the sum over each of (R, T, D) trajectories, (R,)."""
        points = np.ascontiguousarray(trajectories.reshape(-1, trajectories.shape[2]).T)
        points -= self._centre[:, None]
        points /= self._lengths[:, None]
        self._weigh_changes(np.maximum(points.max(axis=1), -points.min(axis=1)))
        n, (d, height, kept) = len(self._left), self._moved.shape
        size = limit_chunk(n + len(self._rows) + kept + d * (height + kept) + 20 * d + 20, memory_mb)
        self._k, self._found = np.empty((n, size)), np.empty((len(self._rows), size))
        self._y, self._spare = (np.empty((d, each, size), np.float32) for each in (height, kept))
        self._right, self._slopes = np.ones((d + 2, size)), np.empty((d + 2, size))
        with np.errstate(all="ignore"):
            chunks = [self._bound(points[:, at : at + size]) for at in range(0, points.shape[1], size)]
        sums: Array = np.concatenate(chunks).reshape(len(trajectories), -1).sum(axis=1)
        return np.nan_to_num(sums * (1.0 + ROUNDING), nan=np.inf)

    def _weigh_changes(self, reach: Array) -> None:
        """Prepare `_change` for points that are as far from the centre: |y_d| is known within delta = e sqrt(R) + f."""
        d, kept = len(reach), self._moved.shape[2]
        e = self._beyond + reach * np.sqrt(self._rest)
        rounding = (kept + 8) * float(np.finfo(np.float32).eps) * (self._size + reach)
        f = (self._dropped + rounding) * np.sqrt(self._signal)
        own, squared = self._sd[:d], self._rest * (1.0 - self._rest)
        self._by_norms = 4.0 * own * np.stack([e, f])
        by_noise = 2.0 * (self._sd[d] * (self._rest + squared) + self._sd[d + 1] * squared)
        constant = 2.0 * own @ f**2 + 4.0 * self._sd[d] * self._rounded
        self._by_unseen = 2.0 * own @ e**2 + by_noise, 4.0 * own @ (e * f), constant

    def _change(self, norms: Array, unseen: Array) -> Array:
        """Return how much |R' dV| may change by what is left out, (B,): sum S_dd^1/2 (4 |y_d| delta + 2 delta^2)."""
        square, linear, constant = self._by_unseen
        by_root, by_one = self._by_norms @ norms
        return np.sqrt(unseen) * (by_root + linear) + by_one + square * unseen + constant

    def _bound(self, at: Array) -> Array:
        d, count = at.shape
        right, slopes = self._right[:, :count], self._slopes[:, :count]
        right[:d] = at
        np.einsum("db,db->b", at, at, out=right[d + 1])
        right[d + 1] *= -0.5
        k = np.matmul(self._left, right, out=self._k[:, :count])
        found = np.matmul(self._rows, np.exp(k, out=k), out=self._found[:, :count])
        h, first, second = found[: -2 * d - 2], found[-2 * d - 2 : -d - 2], found[-d - 2 : -2]
        slopes[:d] = at * (at * found[-2] - first) + second
        slopes[d], slopes[d + 1] = found[-1], -found[-1]
        by_mean = self._root @ slopes

        norms = self._measure(right[:d], h)
        explained, noise_free, squared = self._sums @ np.square(h, out=h)
        above = (self._signal + self._rounded) - explained
        unseen = np.maximum(self._signal - noise_free, 0.0) + self._rounded
        below = np.maximum(above - self._rest * unseen - 2.0 * self._rounded, self._least)
        np.multiply(np.square(norms), -2.0, out=slopes[:d])
        slopes[d], slopes[d + 1] = 2.0 * (above - squared), 2.0 * squared
        by_variance = self._root @ slopes
        size = np.sqrt(np.einsum("pb,pb->b", by_variance, by_variance)) + self._change(norms, unseen)
        excess = np.einsum("pb,pb->b", by_mean, by_mean) + size * size / (3.0 * below) - self._noise / 3.0
        return 0.5 * np.log(4.0 / 3.0 + excess / (np.where(excess > 0, below, above) + self._noise))

    def _measure(self, at: Array, h: Array) -> Array:
        """Return |y_d| of the kept eigenvectors, (D, B), in single precision."""
        kept, count = h.shape
        single, y = h.astype(np.float32), self._y[:, :, :count]
        np.matmul(self._moved.reshape(-1, kept), single, out=y.reshape(-1, count))
        y[:, :kept] -= np.multiply(at.astype(np.float32)[:, None], single, out=self._spare[:, :, :count])
        return np.sqrt(np.einsum("dnb,dnb->db", y, y))


def _compress(matrices: Array, least: float) -> tuple[Array, Array]:
    """Return (D, J, r) matrices with fewer rows and the same norms of products, but for what is dropped, (D,)."""
    if not matrices.size:
        return matrices, np.zeros(len(matrices))
    _, values, rows = np.linalg.svd(matrices, full_matrices=False)
    count = int((values > least).sum(axis=1).max())
    dropped = values[:, count] if count < values.shape[1] else np.zeros(len(matrices))
    return values[:, :count, None] * rows[:, :count], dropped


def _find_slopes(model: MarginalGP, scaled: Array) -> Array:
    """Return rows to multiply k with, (2 D + 2, N): for the slopes by the lengths, a'k, and the slope by sf."""
    covariance, posterior = model.posterior.covariance(model.theta), model.posterior
    solve = posterior.factor(model.theta).solve
    weights = solve(posterior.residual(model.theta))
    columns = scaled.T
    corrections = [solve(((column[:, None] - column) ** 2 * covariance) @ weights) for column in columns]
    both = [2.0 * weights * columns, weights * columns**2 - np.array(corrections)]
    return np.vstack([*both, weights, 2.0 * model.noise_variance * solve(weights)])
