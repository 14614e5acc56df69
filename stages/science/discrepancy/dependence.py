"""On which measured signals a residual depends: a few inputs, chosen forward, and a sparse GP of them.

An output and its residual flow in; out flow the inputs, the GP's prediction of each trial that it has not seen, and its
prediction when it has seen all. It names nothing: it says where to look.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.science.discrepancy.settings import DescriptionSettings
from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_model import SparseGP
from stages.science.output_channels.output_channel import Driver, OutputChannel
from stages.science.plant.learned_map import LearnedInput, LearnedMap
from stages.science.signals.trajectories import Array

FOLDS = 10
MOST_ROWS = 2000
"""Largest number of samples that a GP is fitted to; neighbouring samples are redundant."""
LENGTHS = (0.35, 1.0)
"""Length scales of the kernels by which inputs are chosen, in standard deviations; longer for several inputs."""
RIDGES = (1.0, 10.0)
"""Ratios of noise to signal variance by which inputs are chosen; large, as the noise is correlated."""
SPREAD = 1.0
"""Standard deviation of the logarithms of a GP's hyperparameters about those that it starts from."""
LEAST_VARIANCE = 1e-6
"""Conditional over prior variance of a row, below which no more pseudo-inputs are needed."""
ITERATIONS = 30
BINS = 20


@dataclass(frozen=True)
class Dependence:
    """On which inputs a residual depends, as far as trials left out confirm it, the one that tells most first.

    In the channel's unit, (T, K), zero where not present: what a GP says of each trial, inputs and all chosen without
    it, and mean and standard deviation of the GP of all trials, which is kept as a map; None without inputs.
    """

    inputs: tuple[Driver, ...]
    heldout: Array
    mean: Array
    deviation: Array
    learned: LearnedMap | None

    @property
    def along(self) -> Array:
        """The first input, (T, K)."""
        return self.inputs[0].values

    def split(self, present: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
        """Return the samples where the second input is low, and where it is high; all, under no name, without one."""
        if len(self.inputs) < 2:
            return {"": present}
        second, name = self.inputs[1].values, self.inputs[1].name
        low = second <= float(np.median(second[present]))
        return {f"low {name}": present & low, f"high {name}": present & ~low}


def find_dependence(
    output: OutputChannel,
    offered: Sequence[Driver],
    residual: Array,
    settings: DescriptionSettings,
    generator: np.random.Generator,
) -> Dependence:
    """Return on which of the inputs offered a residual depends.

    The output has the trials that may be looked at; the residual, (T, K), is zero where not present, in the channel's
    unit. The generator draws samples and pseudo-inputs.

    Notes
    -----
    Inputs are added one by one, each the one with which a GP of fixed lengths predicts trials left out best, as long as
    that helps by `least_errors` standard errors over trials; where none helps alone, two of the element's own may
    together. The GP of the chosen ones is that of Snelson and Ghahramani (2006) with a length for each input. What it
    takes away is told of trials that had no part in either: in each of `FOLDS` folds inputs are chosen anew.
    """
    present = output.present
    inputs = [each for each in offered if np.ptp(each.values[present]) > 0.0]
    means, spreads = ([take(each.values[present]) for each in inputs] for take in (np.mean, np.std))
    columns = (np.stack([each.values for each in inputs], axis=2) - means) / spreads
    heldout, mean, deviation = np.zeros((3, *residual.shape))
    nothing = Dependence((), heldout, mean, deviation, learned=None)
    if not (residual[present] != 0.0).any() or output.trials < 3:
        return nothing
    thin = np.zeros(present.shape, dtype=bool)  # drawn at random, as an even stride would turn a hum into an offset
    thin.flat[generator.permutation(np.flatnonzero(present))[:MOST_ROWS]] = True
    rows, trial, target = columns[thin], np.nonzero(thin)[1], residual[thin]
    search = _Forward(rows, target, trial, output.trials, settings, [each.own for each in inputs])
    chosen = search.choose(np.ones(output.trials, dtype=bool))
    if not chosen:
        return nothing
    size = _measure(target)
    whole = fit_gaussian_process(rows[:, chosen], target / size, settings.pseudo_inputs, generator)
    said, variance = whole.predict(columns[present][:, chosen])
    mean[present], deviation[present] = size * said, size * np.sqrt(variance)
    for fold in range(min(FOLDS, output.trials)):
        out = np.arange(output.trials) % FOLDS == fold
        told = search.choose(~out)
        asked = present & out
        if not told or not asked.any():
            continue
        learnt = ~out[trial]
        scale = _measure(target[learnt])
        model = fit_gaussian_process(rows[learnt][:, told], target[learnt] / scale, settings.pseudo_inputs, generator)
        heldout[asked] = scale * model.predict_mean(columns[asked][:, told])
    ranges = [(inputs[k].name, float(means[k]), float(spreads[k]), inputs[k].values[present]) for k in chosen]
    learned = LearnedMap(
        channel=output.channel,
        element=output.element,
        inputs=[
            LearnedInput(name=name, middle=m, spread=s, length=float(length), low=float(v.min()), high=float(v.max()))
            for (name, m, s, v), length in zip(ranges, whole.hyperparameters.lengths, strict=True)
        ],
        deviation=_measure((residual - heldout)[present]),
        lowest=float(mean[present].min()),
        highest=float(mean[present].max()),
        points=whole.pseudo.tolist(),
        weights=(size * whole.hyperparameters.signal_variance * whole.weights).tolist(),
    )
    return Dependence(tuple(inputs[k] for k in chosen), heldout, mean, deviation, learned)


def _measure(values: Array) -> float:
    """Return a root mean square; one of nothing but zeros."""
    return float(np.sqrt((values**2).mean())) or 1.0


def fit_gaussian_process(inputs: Array, outputs: Array, pseudo_count: int, generator: np.random.Generator) -> SparseGP:
    """Return a sparse GP of a residual over its root mean square, (N,), its hyperparameters the most probable ones.

    Inputs, (N, D), are standardised; the generator is of the fit.
    """
    dimensions = inputs.shape[1]
    length = LENGTHS[0] * np.sqrt(dimensions)
    kept = _decompose(inputs / length, pseudo_count)[0]
    start = np.log([*np.full(dimensions, 2.0 * length), 0.7, 0.7])
    prior = Hyperprior(start, np.full(start.size, SPREAD**2))
    return fit_sparse(
        inputs,
        outputs,
        len(kept),
        prior,
        generator=generator,
        starts=0,
        warm_starts=[(inputs[kept], start)],
        hold_pseudo=True,
        iterations=ITERATIONS,
    )


@dataclass
class _Forward:
    """Forward selection of inputs; sums over the rows of each trial are kept to leave trials out quickly."""

    rows: Array
    target: Array
    trial: NDArray[np.intp]
    trials: int
    settings: DescriptionSettings
    own: Sequence[bool]
    known: dict[tuple[int, ...], list[tuple[Array, Array]]] = field(default_factory=dict)

    def choose(self, learnt: NDArray[np.bool_]) -> list[int]:
        """Return the columns that reduce the error of the trials in `learnt`, the best first."""
        most = self.settings.most_inputs
        squares = np.bincount(self.trial, self.target**2, self.trials).astype(float)
        chosen: list[int] = []
        left = squares[learnt]
        while len(chosen) < min(most, self.rows.shape[1]):
            others = [k for k in range(self.rows.shape[1]) if k not in chosen]
            found = {k: self._leave_out([*chosen, k], squares, learnt) for k in others}
            best = self._prefer(found)
            if not self._helps(left - found[best], squares[learnt]):
                break
            chosen.append(best)
            left = found[best]
        return chosen or (self._choose_pair(squares, learnt) if most > 1 else [])

    def _choose_pair(self, squares: Array, learnt: NDArray[np.bool_]) -> list[int]:
        """Return two columns of the element that reduce the error together, though neither does alone."""
        pairs = list(combinations([k for k, own in enumerate(self.own) if own], 2))
        found = {pair: self._leave_out(pair, squares, learnt) for pair in pairs}
        best = min(pairs, key=lambda pair: float(found[pair].sum()), default=None)
        return list(best) if best and self._helps(squares[learnt] - found[best], squares[learnt]) else []

    def _helps(self, gain: Array, squares: Array) -> bool:
        error = float(gain.std(ddof=1)) * np.sqrt(len(gain))
        least = self.settings.least_help * float(squares.sum())
        return bool(gain.sum() > max(self.settings.least_errors * error, least))

    def _prefer(self, found: Mapping[int, Array]) -> int:
        """Return the best column; one of the element's own, unless another's is significantly better."""
        best = min(found, key=lambda k: float(found[k].sum()))
        nearest = min((k for k in found if self.own[k]), key=lambda k: float(found[k].sum()), default=best)
        loss = found[nearest] - found[best]
        bearable = self.settings.least_errors * loss.std(ddof=1) * np.sqrt(len(loss))
        return nearest if loss.sum() <= bearable else best

    def _leave_out(self, chosen: Sequence[int], squares: Array, learnt: NDArray[np.bool_]) -> Array:
        """Return what is left of the squares of each trial learnt, when the others predict it."""
        lefts = []
        for grams, cross in self._sum(tuple(sorted(chosen))):
            own, against = grams[learnt], cross[learnt]
            total, summed = own.sum(axis=0) - own, against.sum(axis=0) - against
            for ridge in RIDGES:
                weights = np.linalg.solve(total + ridge * np.eye(total.shape[1]), summed[:, :, None])[:, :, 0]
                curved = np.einsum("kp,kpq,kq->k", weights, own, weights)
                lefts.append(squares[learnt] - 2.0 * (weights * against).sum(axis=1) + curved)
        return min(lefts, key=lambda left: float(left.sum()))

    def _sum(self, chosen: tuple[int, ...]) -> list[tuple[Array, Array]]:
        """Return by length the sums of each trial's features, (K, M, M), and of them by the target, (K, M)."""
        if chosen not in self.known:
            columns = self.rows[:, chosen] / np.sqrt(len(chosen))
            self.known[chosen] = []
            for length in LENGTHS:
                features = _decompose(columns / length, self.settings.pseudo_inputs)[1]
                parts = [features[:, self.trial == k] for k in range(self.trials)]
                cross = [part @ self.target[self.trial == k] for k, part in enumerate(parts)]
                self.known[chosen].append((np.stack([part @ part.T for part in parts]), np.stack(cross)))
        return self.known[chosen]


def _decompose(scaled: Array, count: int) -> tuple[list[int], Array]:
    """Return the pivot rows of a pivoted Cholesky factor of the covariance, and the factor, (M, N).

    The (N, D) rows are in units of the lengths (Fine and Scheinberg, JMLR 2, 2001; as pseudo-inputs, Burt, Rasmussen
    and van der Wilk, JMLR 21, 2020).
    """
    halves = 0.5 * (scaled**2).sum(axis=1)
    rest, root = np.ones(len(scaled)), np.zeros((min(count, len(scaled)), len(scaled)))
    rows: list[int] = []
    for place in range(len(root)):
        row = int(np.argmax(rest))
        if rest[row] < LEAST_VARIANCE:
            break
        covariance = np.exp(np.minimum(scaled @ scaled[row] - halves - halves[row], 0.0))
        root[place] = (covariance - root[:place, row] @ root[:place]) / np.sqrt(rest[row])
        rest = np.maximum(rest - root[place] ** 2, 0.0)
        rest[row] = 0.0
        rows.append(row)
    return rows, root[: len(rows)]


class Range(NamedTuple):
    """Range of an input in which most is taken away, the part of it that lies there, and the share of time."""

    low: float
    high: float
    part: float
    time: float


def find_range(values: Array, taken: Array, least_part: float) -> Range:
    """Return the range of an input, (N,), shortest in time, that holds a part of what is taken away, (N,)."""
    edges = np.quantile(values, np.linspace(0.0, 1.0, BINS + 1))
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    sums = np.bincount(place, taken, BINS)
    total = max(float(sums.sum()), 1e-300)
    along = np.concatenate([[0.0], np.cumsum(sums)])
    for width in range(1, BINS + 1):
        held = along[width:] - along[:-width]
        first = int(np.argmax(held))
        if held[first] >= least_part * total or width == BINS:
            break
    inside = (place >= first) & (place < first + width)
    part = min(float(held[first]) / total, 1.0)
    return Range(float(edges[first]), float(edges[first + width]), part, float(inside.mean()))
