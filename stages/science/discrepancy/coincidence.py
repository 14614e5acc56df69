"""How often a map without a name would look as much like an effect as the one that was found does.

A wrong law is hardly ever the only error: an effect that is there and a small law error beside it make a map that
predicts better than the effect alone. Fits flow in; a probability flows out.
"""

import numpy as np

from stages.science.discrepancy.fitted_channel import Fitted
from stages.science.output_channels.families import Blocks
from stages.science.signals.trajectories import Array

SMALLEST = 1e-9
"""Length of a direction over the longest, below which it is rounding."""


def measure_likeness(nothing: Fitted, mapped: Fitted, fitted: Fitted) -> float:
    """Return the share of the squares that a static map takes away which an effect takes away alone."""
    closed = float(nothing.raw.sum() - mapped.raw.sum())
    return float(nothing.raw.sum() - fitted.raw.sum()) / closed if closed > 0.0 else 0.0


def weigh_coincidence(nothing: Fitted, fitted: Fitted, blocks: Blocks, likeness: float, least: float) -> float:
    """Return the log probability, at least that of `least`, that a map drawn from a wide prior is as like an effect.

    All is seen beside the free nominal constants, which take their part of either. The effect is one of the tangent
    plane of its parameters; the share of a map's squares that lies in this plane exceeds `likeness` where a quadratic
    form of normal weights is positive.
    """
    columns, tried = blocks
    free, known = nothing.fit.free, len(nothing.fit.values)
    present = nothing.fit.model.output.present
    constants = _span(nothing.fit.slopes[:, :, free][present])
    drawn = columns.values[present] * np.concatenate([block[-1] for block in tried])
    drawn = drawn - constants @ (constants.T @ drawn)
    effect = fitted.fit.slopes[:, :, known:][present]
    along = _span(effect - constants @ (constants.T @ effect)).T @ drawn
    form = along.T @ along - likeness * (drawn.T @ drawn)
    return max(_log_chance_positive(np.linalg.eigvalsh(form)), float(np.log(least)))


def _span(columns: Array) -> Array:
    """Return orthonormal columns, (N, R), that span others, (N, P)."""
    lengths = np.linalg.norm(columns, axis=0)
    left, sizes, _ = np.linalg.svd(columns / np.maximum(lengths, 1e-300), full_matrices=False)
    spanned: Array = left[:, sizes > SMALLEST * max(float(sizes.max(initial=0.0)), SMALLEST)]
    return spanned


def _log_chance_positive(weights: Array) -> float:
    """Return the log probability that a weighted sum of squares of standard normal numbers is positive.

    Notes
    -----
    Saddlepoint approximation: Kuonen, Saddlepoint approximations for distributions of quadratic forms in normal
    variables, Biometrika 86 (1999).
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    weights = weights[np.abs(weights) > SMALLEST * np.abs(weights).max(initial=0.0)]
    if not (weights > 0.0).any():
        return -np.inf
    if weights.sum() >= 0.0 or not (weights < 0.0).any():
        return 0.0
    scaled = weights / weights.max()
    at = brentq(lambda t: float((scaled / (1.0 - 2.0 * t * scaled)).sum()), 0.0, 0.5 * (1.0 - 1e-12))
    rest = 1.0 - 2.0 * at * scaled
    root = float(np.sqrt(np.log(rest).sum()))
    curved = at * float(np.sqrt(2.0 * ((scaled / rest) ** 2).sum()))
    return float(norm.logsf(root + np.log(curved / root) / root))
