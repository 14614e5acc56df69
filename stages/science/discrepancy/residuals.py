"""Residuals as figures show them: averaged over the state plane, and along loops by direction of motion.

Output channels after the nominal fit flow in; tidy rows of averages flow out. Standard errors are over trials.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.discrepancy.fitted_channel import FittedChannel
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

LOOP_BINS, PLANE_BINS = 14, 28
LEAST_SHARE = 0.002
"""Least share of the samples in a bin whose average is shown."""


def average_plane(states: Sequence[FittedChannel]) -> pd.DataFrame:
    """Return the mean residual over two signals, over the noise floor.

    Columns are ``channel muscle along x_label y_label x y over_floor``: the second signal's name, what axes say, and
    the bins' centres.
    """
    frames = []
    for state in states:
        output, present, own = state.output, state.output.present, state.output.list_own()
        across, along = (own[name] for name in output.plane)
        x, y = across.shown[present], along.shown[present]
        edges = [equal_edges(x, PLANE_BINS), _compressed_edges(y) if along.rate else equal_edges(y, PLANE_BINS)]
        counts = np.histogram2d(x, y, bins=edges)[0]
        sums = np.histogram2d(x, y, bins=edges, weights=state.nominal.fit.residual[present])[0]
        column, row = np.nonzero(counts >= max(LEAST_SHARE * 0.1 * x.size, 3.0))
        centres = [0.5 * (each[1:] + each[:-1]) for each in edges]
        told: dict[str, Any] = {"channel": output.channel, "muscle": output.element, "along": along.name}
        told |= {"x_label": across.label, "y_label": along.label}
        told |= {"x": centres[0][column], "y": centres[1][row]}
        frames.append(pd.DataFrame({**told, "over_floor": sums[column, row] / counts[column, row] / state.floor}))
    return pd.concat(frames, ignore_index=True)


def average_loops(states: Sequence[FittedChannel]) -> pd.DataFrame:
    """Return the mean residual along a signal, apart for the two directions of motion.

    Columns are ``direction x mean error channel muscle unit rate x_label``: the standard error over trials, the signal
    that tells the direction, and what an axis of the other one says.
    """
    frames = []
    for state in states:
        output, own = state.output, state.output.list_own()
        variable, rate = (own[name] for name in output.loop)
        rows = average_by_direction(variable.shown, rate.shown, state.nominal.fit.residual, output)
        told = {"channel": output.channel, "muscle": output.element, "unit": output.unit}
        told |= {"rate": rate.name, "x_label": variable.label}
        frames.append(rows.assign(**told))
    return pd.concat(frames, ignore_index=True)


def average_by_direction(variable: Array, rate: Array | None, values: Array, output: OutputChannel) -> pd.DataFrame:
    """Return the mean of `values` in bins of `variable`, (T, K) ndarrays, apart by `split_by_direction`.

    Columns are ``direction x mean error``, with the standard error over trials.
    """
    edges = equal_edges(variable[output.present], LOOP_BINS)
    centres, frames = 0.5 * (edges[1:] + edges[:-1]), []
    for direction, mask in split_by_direction(rate, output.present).items():
        mean, error, count = average_in_bins(variable, values, mask, edges)
        kept = count >= max(LEAST_SHARE * output.present.sum(), 3.0)
        rows = {"direction": direction, "x": centres[kept], "mean": mean[kept], "error": error[kept]}
        frames.append(pd.DataFrame(rows))
    return pd.concat(frames, ignore_index=True)


def split_by_direction(rate: Array | None, present: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Return the samples with each direction of the last movement, (T, K): ``rising`` and ``falling``, or ``both``.

    Rates below a twentieth of usual ones are no movement, as noise has a sign too; without a rate, all count together.
    """
    if rate is None:
        return {"both": present}
    usual = np.abs(rate[present])
    moving = 0.05 * float(np.quantile(usual, 0.95)) if usual.size else 0.0
    sign = np.where(np.abs(rate) > moving, np.sign(rate), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(rate))[:, None], 0), axis=0)
    held = np.take_along_axis(sign, last, axis=0)
    return {"rising": present & (held > 0.0), "falling": present & (held < 0.0)}


def average_in_bins(
    variable: Array, values: Array, mask: NDArray[np.bool_], edges: Array
) -> tuple[Array, Array, Array]:
    """Return mean, standard error over trials, and samples of each bin; a trial weighs by its samples there."""
    bins = len(edges) - 1
    place = np.clip(np.searchsorted(edges, variable, side="right") - 1, 0, bins - 1)
    trials = values.shape[1]
    outputs = (place + bins * np.arange(trials)[None, :])[mask]
    counts = np.bincount(outputs, minlength=bins * trials).reshape(trials, bins)
    sums = np.bincount(outputs, weights=values[mask], minlength=bins * trials).reshape(trials, bins)
    count = counts.sum(axis=0)
    mean = sums.sum(axis=0) / np.maximum(count, 1)
    seen = np.maximum((counts > 0).sum(axis=0), 2)
    spread = (sums - counts * mean) ** 2
    error = np.sqrt(spread.sum(axis=0) * seen / (seen - 1)) / np.maximum(count, 1)
    return mean, error, count


def equal_edges(values: Array, bins: int) -> Array:
    """Return the edges of bins of one width over nearly all of the values, (bins + 1,) ndarray."""
    low, high = np.quantile(values, [0.005, 0.995]) if values.size else (0.0, 1.0)
    return np.linspace(low, high if high > low else low + 1.0, bins + 1)


def _compressed_edges(values: Array) -> Array:
    """Return bin edges on an inverse hyperbolic sine scale, even for slow rates and wide for fast ones."""
    usual = np.abs(values[values != 0.0])
    scale = float(np.median(usual)) if usual.size else 1.0
    return np.asarray(scale * np.sinh(equal_edges(np.arcsinh(values / scale), PLANE_BINS)))
