"""Families of functions without a physical name, as competitors of named effects.

An output flows in; out flow the columns of a static map or of a memory of its measured signals, and, for a fit, the
family that left-out trials chose. A wrong law is a static map: products of powers carry its bulk, two Gaussian
processes of different widths the rest.
"""

from collections.abc import Sequence
from functools import cache
from itertools import combinations_with_replacement

import numpy as np

from stages.science.output_channels.features import list_aside, list_memory
from stages.science.output_channels.fitting import Family, Fit
from stages.science.output_channels.grams import Collector, Columns, Grams
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.trial_noise import TrialNoise
from stages.science.signals.trajectories import Array

DEGREES = {1: 6, 2: 5}
"""Largest degree of the products by the number of signals; 3 for more."""
LOW, PRODUCTS = 3, 0.1
"""Degree up to which products are taken before higher ones, and the standard deviation of their weights over the
channel's range; powers of one signal alone are taken first."""
SMOOTH, ROUGH = (1.0, 16), (0.35, 40)
"""Width of a Gaussian process in standard deviations of the signals, and number of its inducing points."""
NOTHING = 1e-6
SCALES = (NOTHING, 0.001, 0.003, 0.01, 0.03)
"""Standard deviations of weights, over the channel's range, of which left-out trials choose."""
NEAR = 0.2
"""Standard deviations of the constants, over those of their priors, while a family is chosen beside straight lines."""
FARTHEST = 2000
"""Number of samples from which inducing points are taken, at most."""


Blocks = tuple[Columns, list[list[Array]]]
"""Columns of a family and for each of its blocks the standard deviations of its weights to choose from."""


def build_static_map(output: OutputChannel) -> Blocks:
    """Return a static map of an output's own signals, rates excepted, as the output responds to it.

    Inducing points: Quinonero-Candela and Rasmussen, A unifying view of sparse approximate Gaussian process
    regression, Journal of Machine Learning Research 6 (2005).
    """
    signals = [each.values for each in output.drivers() if each.own and not each.rate]
    inputs = np.stack([(each - each.mean()) / max(float(each.std()), 1e-12) for each in signals], axis=2)
    most = DEGREES.get(len(signals), 3)
    chosen = [
        places for degree in range(1, most + 1) for places in combinations_with_replacement(range(len(signals)), degree)
    ]
    products = [np.prod([inputs[:, :, place] for place in places], axis=0) for places in chosen]
    blocks = [np.stack([each / max(float(each.std()), 1e-12) for each in products], axis=2)]
    blocks += [_expand(inputs, *each) for each in (SMOOTH, ROUGH)]
    several = [
        *(np.array([{*places} == {signal} for places in chosen]) for signal in range(len(signals))),
        np.array([len(places) <= LOW for places in chosen]),
        np.ones(len(chosen), dtype=bool),
    ]
    powers = [np.full(len(chosen), NOTHING), *(np.where(each, PRODUCTS, NOTHING) for each in several)]
    tried = [powers, *([np.full(each.shape[2], scale) for scale in SCALES] for each in blocks[1:])]
    return _respond(output, np.concatenate(blocks, axis=2), tried)


def build_memory(output: OutputChannel) -> Blocks:
    """Return a memory of an output's own signals, and other measured ones as they are, as the output responds."""
    blocks = list_memory(output), list_aside(output)
    tried = [[np.full(block.shape[2], each) for each in (*SCALES, 0.1)] for block in blocks]
    return _respond(output, np.concatenate(blocks, axis=2), tried)


def join(*families: Blocks) -> Blocks:
    """Return the sum of families."""
    together = np.concatenate([each.values for each, _ in families], axis=2)
    return Columns(together), [block for _, each in families for block in each]


def _respond(output: OutputChannel, columns: Array, tried: list[list[Array]]) -> Blocks:
    """Return a family as the output responds to it; where it answers with several signals to each, block by block."""
    answered = np.where(output.present[:, :, None], output.respond(output.range * columns), 0.0)
    several = answered.shape[2] // columns.shape[2]
    ends = np.cumsum([len(block[0]) for block in tried])
    by_answer = answered.reshape(*answered.shape[:2], several, columns.shape[2])
    blocks = [each.reshape(*each.shape[:2], -1) for each in np.split(by_answer, ends[:-1], axis=3)]
    return Columns(np.concatenate(blocks, axis=2)), [[np.tile(each, several) for each in block] for block in tried]


def _expand(inputs: Array, width: float, points: int) -> Array:
    """Return functions whose sum with weights of one deviation is a Gaussian process of that, at inducing points."""
    from scipy.linalg import solve_triangular

    flat = inputs.reshape(-1, inputs.shape[2])
    centres = _spread_out(flat[:: max(len(flat) // FARTHEST, 1)], points)
    apart = (((each[:, None] - centres[None]) ** 2).sum(axis=2) for each in (centres, flat))
    among, beside = (np.exp(-0.5 * each / width**2) for each in apart)
    factor = np.linalg.cholesky(among + 1e-6 * np.eye(len(centres)))
    columns: Array = solve_triangular(factor, beside.T, lower=True).T
    return columns.reshape(*inputs.shape[:2], len(centres))


def _spread_out(places: Array, points: int) -> Array:
    """Return points each of which is as far as possible from those before (Gonzalez 1985)."""
    chosen = [places[np.argmin((places**2).sum(axis=1))]]
    apart = ((places - chosen[0]) ** 2).sum(axis=1)
    while len(chosen) < points and apart.max() > 1e-6:
        chosen.append(places[np.argmax(apart)])
        apart = np.minimum(apart, ((places - chosen[-1]) ** 2).sum(axis=1))
    return np.array(chosen)


def choose_family(fit: Fit, noise: Noise | TrialNoise, columns: Columns, tried: Sequence[Sequence[Array]]) -> Family:
    """Return a family beside a fit, with the priors by which left-out trials are predicted best.

    It is fitted beside a model without one under the noise of its channel, and judged by the shape of trials left out.
    `tried` are the standard deviations of the weights of each of its blocks, (F_b,), which are chosen block by block,
    twice.
    """
    output, free = fit.model.output, np.flatnonzero(fit.free)
    together = np.concatenate([fit.slopes[:, :, free], fit.residual[:, :, None]], axis=2)
    collector = Collector(output, noise, columns, output.measured - fit.residual)
    whole, shape = (collector.collect(together, each) for each in (noise, None))
    mean, prior_sd = fit.model.prior
    pull = np.append(((mean - fit.values) / prior_sd**2)[free], np.zeros(columns.values.shape[2]))
    total, cross = whole.slopes.sum(axis=0), whole.cross.sum(axis=0) + pull

    @cache
    def predict(*places: int) -> float:
        sd = [block[place] for block, place in zip(tried, places, strict=True)]
        scale = np.concatenate([NEAR * prior_sd[free], *sd])
        kept = np.append(np.ones(len(free), dtype=bool), np.concatenate(sd) > NOTHING).nonzero()[0]
        scale, some = scale[kept], np.ix_(np.arange(output.trials), kept, kept)
        curved = (total[kept[:, None], kept] - whole.slopes[some]) * scale * scale[:, None] + np.eye(len(scale))
        target = ((cross - whole.cross)[:, kept] * scale)[:, :, None]
        weights = np.linalg.solve(curved, target)[:, :, 0] * scale
        own = Grams(shape.slopes[some], shape.cross[:, kept], shape.square, shape.samples)
        return float(own.left_out(weights).sum())

    chosen = [0] * len(tried)
    for block in [*range(len(tried)), *range(len(tried) - 1)]:
        before, after = chosen[:block], chosen[block + 1 :]
        chosen[block] = min(range(len(tried[block])), key=lambda place: predict(*before, place, *after))
    return Family(columns, np.concatenate([block[place] for block, place in zip(tried, chosen, strict=True)]))
