"""A formula of a few terms for a residual: a hint at what is missing, no finding.

A fitted model and a few inputs flow in; out flow the terms that predict trials left out, with their weights. The
nominal constants, and the parameters of effects already named, may change along with the weights.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from stages.science.discrepancy.settings import DescriptionSettings
from stages.science.output_channels.features import TURNING
from stages.science.output_channels.fitting import Fit
from stages.science.output_channels.output_channel import Driver
from stages.science.recording.signal_names import name_signal
from stages.science.signals.trajectories import Array

DEGREE = 3
MOST_ROWS = 100_000
"""Samples that terms are fitted to, at most."""


@dataclass(frozen=True)
class Sketch:
    """A formula: texts and weights of its terms, in the channel's unit over the term's; none where none is confirmed.

    Sums of squares, (K,), are of each trial's residual without the terms, and with those told by the other trials.
    """

    terms: tuple[tuple[str, float], ...]
    before: Array
    after: Array
    code: tuple[str, ...] = ()
    """The terms in Python, of the inputs x[0], x[1] and so on; empty where what answers is a motion."""
    sizes: tuple[float, ...] = ()
    """Root mean squares of the terms."""

    @property
    def formula(self) -> str:
        """The terms as text; empty without any."""
        signs = [("-" if weight < 0.0 else "+", f"{abs(weight):.3g}", text) for text, weight in self.terms]
        joined = " ".join(f"{sign} {size}{f'*{text}' if text != '1' else ''}" for sign, size, text in signs)
        return joined.removeprefix("+ ") if joined[:1] != "-" else f"-{joined[2:]}"


def sketch_residual(fit: Fit, inputs: Sequence[Driver], settings: DescriptionSettings) -> Sketch:
    """Return a short formula for what a fitted model leaves.

    Only the inputs may stand in it. The settings say how many terms it may have; they are chosen by orthogonal least
    squares (Chen, Billings and Luo, Int. J. Control 50, 1989).

    Notes
    -----
    Terms are products of powers of the inputs, up to the third degree; of a rate v also v|v|, the direction tanh(v/s)
    with s a tenth of its standard deviation, and the direction times other inputs. Of formulas of growing length the
    shortest is taken whose error on trials left out is within one standard error of the least.
    """
    output = fit.model.output
    stride = int(np.ceil(max(output.present.sum(), 1) / MOST_ROWS))
    present = output.present[::stride]
    residual = np.where(present, fit.residual[::stride], 0.0)
    squares = (residual**2).sum(axis=0)
    nothing = Sketch((), squares, squares)
    if not inputs or output.trials < 3 or squares.sum() == 0.0:
        return nothing
    names, code, values = map(list, zip(*_list_terms(inputs, output.present), strict=True))
    answers = output.respond(np.stack(values, axis=2))
    code += [""] * (answers.shape[2] - len(code))
    names += [f"answer to ({name})" for name in names][: answers.shape[2] - len(names)]
    terms = np.where(present[:, :, None], answers[::stride], 0.0)
    sizes = np.sqrt(np.maximum((terms**2).sum(axis=(0, 1)) / present.sum(), 1e-300))
    scale = float(np.sqrt(squares.sum() / present.sum()))
    slopes = fit.slopes[::stride] / np.sqrt(fit.precision) / scale
    together = np.concatenate([slopes, terms / sizes, (residual / scale)[:, :, None]], axis=2).transpose(1, 0, 2)
    sums = _Sums(together.transpose(0, 2, 1) @ together, slopes.shape[2])
    total = sums.trials.sum(axis=0)
    paths = [sums.list_supports(total - own, settings) for own in sums.trials]
    left = np.array(
        [
            [sums.measure(own, sums.solve(total - own, support), support) for support in path]
            for own, path in zip(sums.trials, paths, strict=True)
        ]
    ).T.copy()
    level = _choose_level(left)
    chosen = sums.list_supports(total, settings)[level]
    if not chosen:
        return nothing
    weights = scale * sums.solve(total, chosen)[sums.held :] / sizes[chosen]
    told = tuple((names[k], float(weight)) for k, weight in zip(chosen, weights, strict=True))
    kept = tuple(code[k] for k in chosen), tuple(float(sizes[k]) for k in chosen)
    return Sketch(told, squares, scale**2 * left[level], *kept)


def _list_terms(inputs: Sequence[Driver], present: NDArray[np.bool_]) -> Iterator[tuple[str, str, Array]]:
    """Yield the terms that a formula may have: text, Python, and values, (T, K), in the inputs' own units."""
    words = [name_signal(each.name)[0] for each in inputs]
    atoms = [f"[{each}]" if " " in each else each for each in words]
    yield "1", "np.ones_like(x[0])", np.ones(present.shape)
    for degree in range(1, DEGREE + 1):
        for chosen in combinations_with_replacement(range(len(inputs)), degree):
            powers = Counter(atoms[k] for k in chosen).items()
            text = "*".join(f"{atom}^{power}" if power > 1 else atom for atom, power in powers)
            yield text, " * ".join(f"x[{k}]" for k in chosen), np.prod([inputs[k].values for k in chosen], axis=0)
    for place, each in [(place, each) for place, each in enumerate(inputs) if each.rate]:
        yield f"{atoms[place]}*|{words[place]}|", f"x[{place}] * np.abs(x[{place}])", each.values * np.abs(each.values)
        width = TURNING * float(each.values[present].std())
        text, turn = f"tanh({atoms[place]}/{width:.2g})", f"np.tanh(x[{place}] / {width!r})"
        direction = np.tanh(each.values / width)
        yield text, turn, direction
        for other in [k for k in range(len(inputs)) if k != place]:
            yield f"{text}*{atoms[other]}", f"{turn} * x[{other}]", direction * inputs[other].values


@dataclass(frozen=True)
class _Sums:
    """Sums over each trial of products of P slopes, F terms and the residual, (K, P + F + 1, P + F + 1)."""

    trials: Array
    held: int

    def solve(self, sums: Array, support: Sequence[int]) -> Array:
        """Return the weights of all slopes, under their priors, and of some terms."""
        kept = [*range(self.held), *(self.held + k for k in support)]
        ridge = np.diag([1.0] * self.held + [1e-9 * float(np.trace(sums))] * len(support))
        return np.asarray(np.linalg.solve(sums[np.ix_(kept, kept)] + ridge, sums[kept, -1]), dtype=np.float64)

    def measure(self, sums: Array, weights: Array, support: Sequence[int]) -> float:
        """Return the sum of squares that weights leave."""
        kept = [*range(self.held), *(self.held + k for k in support), -1]
        signed = np.append(-weights, 1.0)
        return max(float(signed @ sums[np.ix_(kept, kept)] @ signed), 0.0)

    def list_supports(self, sums: Array, settings: DescriptionSettings) -> list[list[int]]:
        """Return the terms of formulas of growing length; the first has none."""
        held, least_own = self.held, settings.least_own
        beside = sums[:held, held:]
        among = sums[:held, :held] + np.eye(held)
        rest = sums[held:, held:] - beside.T @ np.linalg.solve(among, beside)  # what slopes do not imitate
        confounded = np.diag(rest) < least_own * np.maximum(np.diag(sums)[held:], 1e-300)
        confounded[-1] = False
        rest = np.where(confounded | confounded[:, None], 0.0, rest)
        return [[], *_add_stepwise(rest, settings.most_terms, least_own)]


def _add_stepwise(sums: Array, most: int, least_own: float) -> list[list[int]]:
    """Return the terms added one by one, each the one that takes most of the residual beside those before."""
    rest, own = sums.copy(), np.diag(sums)[:-1]
    supports: list[list[int]] = []
    chosen: list[int] = []
    for _ in range(most):
        free = np.diag(rest)[:-1]
        possible = (free > least_own * own) & (own > 0.0)
        if possible.any():
            gain = np.where(possible, rest[:-1, -1] ** 2 / np.where(possible, free, 1.0), -1.0)
            best = int(np.argmax(gain))
            chosen = [*chosen, best]
            rest -= np.outer(rest[:, best], rest[best]) / rest[best, best]
        supports.append(chosen)
    return supports


def _choose_level(left: Array) -> int:
    """Return the first level, of (L, K) squares left, that is within one standard error of the least."""
    best = int(np.argmin(left.sum(axis=1)))
    worse = left - left[best]
    error = worse.std(axis=1, ddof=1) * np.sqrt(left.shape[1])
    return int(np.argmax(worse.sum(axis=1) <= error))
