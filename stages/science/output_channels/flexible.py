"""A flexible residual model: what any function of the measured signals could still explain.

A fitted model and its output flow in; out flows what each trial's residual would be if generic features with weights of
their own, or boosted trees, neither of which has a name for anything, were fitted to the others. It names nothing: it
tells the noise from what is reproducible.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from stages.science.output_channels.features import build_features
from stages.science.output_channels.fitting import Fit
from stages.science.output_channels.grams import Grams
from stages.science.output_channels.noise import Noise, whiten
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.spectral_line import find_line, remove_line
from stages.science.signals.trajectories import Array

Mask = NDArray[np.bool_]
CALM = 1.075
"""Gap over that beside a drift below which there is none; half of what the smallest gap of interest is above one."""
ORDERS, FEWEST = 99, 5
"""Other orders of the trials in all of which a drift has to explain less, and trials below which there are too few."""
MEMORY, SESSION_CHANGE = "memory", "session_change"
"""Families of models without a name: a linear memory of the inputs, and a drift of values along the session."""
PENALTIES = (1e4, 1e3, 1e2, 1e1, 1.0, 1e-1, 1e-2, 1e-3)
"""Of weights, all tried: what is left may rise before it falls, where a smooth signal needs large weights."""
FOLDS = 5
MEMORY_SAMPLES = 200
"""Largest number of delayed samples of all inputs in a linear memory."""
AT_ONCE = 16
"""Columns of signals that are squared at once."""
MOST_ROWS = 2000
"""Samples that trees are fitted to, at most; neighbours in time tell the same."""
TREES = {"max_iter": 25, "learning_rate": 0.3, "max_leaf_nodes": 12, "min_samples_leaf": 20, "max_bins": 64}


@dataclass(frozen=True)
class Leftover:
    """What a flexible model leaves of a residual, trial by trial, each left out in turn."""

    raw: Array
    """Sums of squares left, (K,), in the channel's unit squared."""
    residual: Array
    """What it leaves of each trial that it was not fitted to, (T, K)."""
    line_hz: float | None
    """Frequency of an oscillation in all trials that nothing measured explains: no noise, and not in the above."""
    family: str = ""
    """The family whose model leaves the least; empty where that has none."""


@dataclass(frozen=True)
class Drift:
    """A value of a model that drifts evenly along the session: its name and unit, and the value at both ends."""

    name: str
    unit: str
    first: float
    last: float
    without: Array
    left: Array
    """Sums of squares that values, fitted anew, leave of each trial left out, (K,), without the drift and with it."""


def keep_least(left: Sequence[tuple[str, Array]], output: OutputChannel, learnt: Mask | None = None) -> Leftover:
    """Return the least of what models leave, (T, K) each, by family, without a spectral line, if it has one.

    The least is told by all trials, or by those learnt, a (K,) mask.
    """
    known = np.ones(output.trials, dtype=bool) if learnt is None else learnt
    family, residual = min(left, key=lambda each: float((each[1][:, known] ** 2).sum()))
    line_hz = find_line(residual, output.present, output.step_s, output.limits)
    if line_hz is not None:
        residual = remove_line(residual, output.present, output.step_s, line_hz)
    return Leftover((residual**2).sum(axis=0), residual, line_hz, family)


def find_floor(fit: Fit, noise: Noise, learnt: Mask) -> Leftover:
    """Return what flexible models leave that are fitted to some trials alone; noise, as far as one can tell.

    A channel without inputs to remember has no memory: what the fit itself leaves is never taken for a floor.
    """
    output = fit.model.output
    plain = [each for each in explain(output, fit.residual, learnt) if each[1] is not fit.residual]
    return keep_least([*explain_changing(fit, build_features(output), noise, learnt), *plain], output, learnt)


def explain(output: OutputChannel, residual: Array, learnt: Mask | None = None) -> list[tuple[str, Array]]:
    """Return what is left of each trial's residual, (T, K), by models that leave the output's own values; by family."""
    pasts = (output.recall(MEMORY_SAMPLES), output.recall(MEMORY_SAMPLES, output.measured - residual), output.mix())
    memories = [(MEMORY, explain_by_memory(output, residual, past, learnt)) for past in pasts]
    return [("", explain_by_trees(output, residual, learnt)), *memories]


def explain_changing(
    fit: Fit, features: Array, noise: Noise | None, learnt: Mask | None = None
) -> list[tuple[str, Array]]:
    """Return what is left by models beside which the output's values change: of features, and of a drift of them."""
    by_drift = explain_by_drift(fit, noise, learnt)
    drifting = [] if by_drift is None else [(SESSION_CHANGE, by_drift)]
    return [("", explain_by_features(fit, features, noise, learnt)), *drifting]


def explain_by_drift(fit: Fit, noise: Noise | None, learnt: Mask | None = None) -> Array | None:
    """Return what is left of each trial's residual, (T, K), by values that drift evenly along the session.

    None where the gap falls by less than `CALM`, or would fall as far if the trials had come in another order, as it
    may where each trial has a gain of its own (a permutation test; none tells orders of fewer than `FEWEST` trials).
    """
    start_s, known = fit.model.output.start_s, slice(None) if learnt is None else learnt
    no_drift = np.empty((*fit.residual.shape, 0))
    before, left = (explain_by_features(fit, each, noise, learnt) for each in (no_drift, build_drift(fit, start_s)))
    square = (left[:, known] ** 2).sum()
    if len(start_s) < FEWEST or CALM**2 * square > (before[:, known] ** 2).sum():
        return None
    generator, place = np.random.default_rng(0), np.argsort(np.argsort(start_s))
    for order in (generator.permutation(len(start_s)) for _ in range(ORDERS)):
        if np.ptp(place[order] - place) == 0 or np.ptp(place[order] + place) == 0:
            continue  # the same order, or the opposite one, in which the same drift is seen
        other = explain_by_features(fit, build_drift(fit, start_s[order]), noise, learnt)
        if (other[:, known] ** 2).sum() <= square:
            return None
    return left


def build_drift(fit: Fit, start_s: Array) -> Array:
    """Return the features of values that drift evenly along a session, (T, K, P), by the trials' (K,) starts."""
    session_s = np.arange(len(fit.residual))[:, None] * fit.model.output.step_s + start_s
    return fit.slopes * ((session_s - session_s.mean()) / max(float(session_s.std()), 1e-300))[:, :, None]


def find_drift(fit: Fit) -> Drift:
    """Return the value of a model whose drift along the session predicts trials left out best."""
    drifting, present = build_drift(fit, fit.model.output.start_s), fit.model.output.present
    session_s = (np.arange(len(present))[:, None] * fit.model.output.step_s + fit.model.output.start_s)[present]
    without, *lefts = (
        (explain_by_features(fit, drifting[:, :, places], None) ** 2).sum(axis=0)
        for places in ([], *([place] for place in range(fit.slopes.shape[2])))
    )
    best = int(np.argmin([each.sum() for each in lefts]))
    columns = np.concatenate([fit.slopes, drifting[:, :, [best]]], axis=2)[present]
    change = np.linalg.lstsq(columns, fit.residual[present], rcond=None)[0]
    ends = (np.array([session_s.min(), session_s.max()]) - session_s.mean()) / max(float(session_s.std()), 1e-300)
    first, last = fit.values[best] + change[best] + change[-1] * ends
    parameter = fit.model.parameters[best]
    unit = fit.model.output.unit if parameter.unit == "unit of the output" else parameter.unit
    return Drift(parameter.name, unit, float(first), float(last), without, lefts[best])


def explain_by_features(fit: Fit, features: Array, noise: Noise | None, learnt: Mask | None = None) -> Array:
    """Return what is left of each trial's residual, (T, K), when the others' is fitted by generic features, (T, K, F).

    The model's own values may change along with the features' weights. Without a noise, the residual is taken as white.
    `learnt` is a mask of the trials that it may be fitted to, (K,); all, unless told.
    """
    output = fit.model.output
    present = output.present
    spread = fit.spread or 1.0

    def collect(trial: int) -> Array:
        return np.concatenate([fit.slopes[:, trial], features[:, trial], fit.residual[:, trial, None]], axis=1)

    white = np.empty((*fit.residual.shape, fit.slopes.shape[2] + features.shape[2] + 1))
    for trial in range(output.trials):
        own = collect(trial)
        one = own[:, None], present[:, [trial]]
        white[:, trial] = own / spread if noise is None else whiten(*one, noise, output.step_s)[:, 0]
    known = np.ones(output.trials, dtype=bool) if learnt is None else learnt
    return _leave_each_out(white, collect, fit.precision, known)


def explain_by_trees(output: OutputChannel, residual: Array, learnt: Mask | None = None) -> Array:
    """Return what is left of each trial's residual, (T, K), when boosted trees are fitted to that of others.

    They see what happens at one place of several signals together, which sums of features miss, and nothing of the
    past. Inputs are the output's drivers, time in trial and time in session; `learnt` is as in `explain_by_features`.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    known = np.ones(output.trials, dtype=bool) if learnt is None else learnt
    within = np.repeat((np.arange(len(residual)) * output.step_s)[:, None], output.trials, axis=1)
    inputs = np.stack([*(each.values for each in output.drivers()), within, within + output.start_s], axis=2)
    stride = int(np.ceil(output.present[:, known].sum() / MOST_ROWS))
    left = residual.copy()
    for fold in range(min(FOLDS, output.trials)):
        out = np.arange(output.trials) % FOLDS == fold
        rows = output.present[::stride] & (known & ~out)
        if rows.sum() < 2 * TREES["min_samples_leaf"]:
            continue
        trees = HistGradientBoostingRegressor(**TREES, early_stopping=False, random_state=0)
        trees.fit(inputs[::stride][rows], residual[::stride][rows])
        told = output.present & out
        if told.any():
            left[told] -= trees.predict(inputs[told])
    return left


def explain_by_memory(output: OutputChannel, residual: Array, past: Array, learnt: Mask | None = None) -> Array:
    """Return what is left of each trial's residual, (T, K), when others' is fitted by what was before, (T, K, F).

    Of inputs it sees an oscillation that one sets off, which features that forget evenly and trees without a past do
    not; of the answer what its sensor makes of it; of products a gain that follows late. `learnt` is as in
    `explain_by_features`.
    """
    if not past.shape[2]:
        return residual
    known = np.ones(output.trials, dtype=bool) if learnt is None else learnt
    together = np.where(output.present[:, :, None], np.concatenate([past, residual[:, :, None]], axis=2), 0.0)
    spread = float(np.sqrt((residual**2).sum() / max(output.present.sum(), 1))) or 1.0
    return _leave_each_out(together / spread, lambda trial: together[:, trial], np.empty(0), known)


def _solve(matrix: Array, right: Array) -> Array:
    """Solve by the Cholesky factor of a symmetric (F, F) matrix, which is lost; NaN where it has none."""
    _, solved, failed = scipy.linalg.lapack.dposv(matrix.T, right, overwrite_a=True)
    return np.full_like(right, np.nan) if failed else np.asarray(solved)


def _leave_each_out(white: Array, collect: Callable[[int], Array], precision: Array, learnt: Mask) -> Array:
    """Return what is left of each trial, (T, K), by columns of white signals, (T, K, F), the residual last.

    `collect` returns a trial's signals as they are, (T, F): one trial at a time, as there are hundreds of columns.
    """
    first, trials, columns = len(precision), white.shape[1], white.shape[2] - 1
    sizes = [(white[:, :, place : place + AT_ONCE] ** 2).mean(axis=(0, 1)) for place in range(0, columns, AT_ONCE)]
    scale = np.sqrt(np.maximum(np.concatenate(sizes)[:columns], 1e-300))
    scale[:first] = 1.0
    grams = Grams(np.empty((trials, columns, columns)), np.empty((trials, columns)), np.empty(trials), np.zeros(trials))
    for trial in range(trials):
        own = white[:, trial].copy()
        own[:, :-1] /= scale
        grams.slopes[trial] = own[:, :-1].T @ own[:, :-1]
        grams.cross[trial] = own[:, -1] @ own[:, :-1]
        grams.square[trial] = (own[:, -1] ** 2).sum()
    total, cross = grams.slopes[learnt].sum(axis=0), grams.cross[learnt].sum(axis=0)
    least, best = np.inf, np.zeros((trials, columns))
    for penalty in PENALTIES:
        ridge = np.diag(np.concatenate([precision, np.full(total.shape[0] - first, penalty)]))
        weights = np.tile(_solve(total + ridge, cross), (trials, 1))
        for k in np.flatnonzero(learnt):
            weights[k] = _solve(total - grams.slopes[k] + ridge, cross - grams.cross[k])
        left = float(grams.left_out(weights)[learnt].sum())
        if left < least:
            least, best = left, weights
    residual = np.empty(white.shape[:2])
    for trial, weights in enumerate(best / scale):
        own = collect(trial)
        residual[:, trial] = own[:, -1] - own[:, :-1] @ weights
    return residual
