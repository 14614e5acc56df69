"""Bands about the amended simulation: how far a measurement may be from it, and the share of samples that they hold.

A fit with all trials, of which some were fitted, and trials drawn again flow in; standard deviations flow out, those of
the simulation, by its fitted values, and of what it leaves apart.
"""

from typing import NamedTuple, Self

import numpy as np
from scipy.stats import norm

from stages.science.discrepancy.resampling import find_interval
from stages.science.output_channels.fitting import Fit
from stages.science.output_channels.flexible import Mask
from stages.science.signals.trajectories import Array


class Band(NamedTuple):
    """Standard deviations in the channel's unit.

    `simulated`, (T, K): of the simulation, as its constants and effects are not known better; `left`: of what it leaves
    of trials left out of the fit, noise and what no map explains.
    """

    simulated: Array
    left: float

    def reach(self, level: float) -> Array:
        """Return half the width of the band of a level, (T, K), of a normal distribution."""
        half: Array = norm.ppf(0.5 + 0.5 * level) * np.hypot(self.simulated, self.left)
        return half

    def beside(self, left: float) -> Self:
        """Return the band beside a map that leaves so much of trials left out.

        Values wander from trial to trial by what the simulation leaves, and as much less as the map takes of it.
        """
        return self._replace(simulated=self.simulated * min(left / max(self.left, 1e-300), 1.0), left=left)


def find_band(still: Fit, learnt: Mask, weights: Array) -> Band:
    """Return the band of a fit, of which the trials in `learnt`, (K,), were fitted, by weights of these, (B, F).

    Values are drawn as in `Fit.drawn_values`, and each fitted trial is left out in turn.
    """
    drawn = np.zeros((len(weights), len(learnt)))
    drawn[:, learnt] = weights
    alone = np.repeat(learnt.astype(float)[None], learnt.sum(), axis=0)
    alone[:, learnt] -= np.eye(learnt.sum())
    given = still.change_without(learnt.astype(float)[None])
    changes = still.change_without(np.concatenate([drawn, alone])) - given
    spread, moved = changes[: len(drawn)], changes[len(drawn) :]
    simulated = np.sqrt(np.einsum("tkp,pq,tkq->tk", still.slopes, np.atleast_2d(np.cov(spread.T)), still.slopes))
    left = still.residual[:, learnt] - np.einsum("tkp,kp->tk", still.slopes[:, learnt], moved)
    samples = max(int(still.model.output.present[:, learnt].sum()), 1)
    return Band(simulated, float(np.sqrt((left**2).sum() / samples)))


def measure_coverage(inside: Array, counts: Array, weights: Array, level: float) -> dict[str, float | None]:
    """Return the share of samples that bands hold, with its interval over trials drawn by weights, (B, K).

    `inside` and `counts`, (K,), are samples of each trial within its bands, and all of them; one trial has no interval.
    """
    ends = find_interval((weights @ inside) / np.maximum(weights @ counts, 1.0), level).tolist()
    low, high = ends if len(inside) > 1 else (None, None)
    return {"level": level, "coverage": float(inside.sum() / max(counts.sum(), 1.0)), "low": low, "high": high}
