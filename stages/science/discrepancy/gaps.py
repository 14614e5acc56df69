"""How large a gap is, where it lies and how sure that is: the table of regimes.

Fits, and what a flexible model leaves, flow in; rows flow out. The unit of every test is the trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stages.science.discrepancy.fitted_channel import FittedChannel
from stages.science.discrepancy.regimes import find_regimes, split_bands
from stages.science.discrepancy.settings import RegimeSettings
from stages.science.signals.trajectories import Array
from stages.science.statistics.sign_flips import compare_signs, least_p


def locate(
    states: Sequence[FittedChannel], settings: RegimeSettings, generator: np.random.Generator
) -> list[dict[str, Any]]:
    """Return a row for each channel, element and regime.

    Parameters
    ----------
    states : sequence of FittedChannel
        Prepared outputs.
    settings : RegimeSettings
        Regimes of motion and time.
    generator : numpy.random.Generator
        For tests with many trials.

    Notes
    -----
    Compared are, trial by trial, the nominal model's squared residual and what a flexible model leaves of that trial
    when it is left out; p-values are corrected for all rows by Benjamini and Yekutieli (Ann. Stat. 29, 2001), which
    bears that rows depend on each other.
    """
    from statsmodels.stats.multitest import multipletests

    rows: list[dict[str, Any]] = []
    for state in states:
        rows += _locate_in(state, settings, generator)
    if rows:
        adjusted = multipletests([row["p_value"] for row in rows], method="fdr_by")[1]
        for row, p in zip(rows, adjusted, strict=True):
            row["p_adjusted"] = float(p)
    return rows


def _locate_in(state: FittedChannel, settings: RegimeSettings, generator: np.random.Generator) -> list[dict[str, Any]]:
    output, nominal = state.output, state.nominal.fit.residual
    least = np.where(output.present, state.leftover.residual, 0.0)
    excess = nominal**2 - least**2
    whole = float(excess.sum())
    regimes = {"everywhere": output.present, **find_regimes(output, settings.around_reversal)}
    columns, rows = [], []
    quantile = settings.largest_quantile

    def share(squares: Array) -> float:
        return float(squares.sum() / whole) if whole > 0.0 else 0.0

    for name, mask in regimes.items():
        inside = mask.sum(axis=0)
        columns.append(np.where(inside > 0, (excess * mask).sum(axis=0) / np.maximum(inside, 1), np.nan))
        rows.append(_describe(state, name, mask, nominal, least, share(excess * mask), quantile))
    bands = [split_bands(each, settings.band_edges, output.step_s, output.time_scale_s) for each in (nominal, least)]
    for name, part in bands[0].items():
        rest = bands[1][name]
        band = np.where(output.present, part**2 - rest**2, 0.0)
        columns.append(band.mean(axis=0))
        rows.append(_describe(state, name, output.present, part, rest, share(band * output.present), quantile))
    p = compare_signs(np.column_stack(columns), generator)
    floor = least_p(output.trials)
    return [{**row, "p_value": float(each), "p_least": floor} for row, each in zip(rows, p, strict=True)]


def _describe(
    state: FittedChannel, name: str, mask: Any, gap: Array, least: Array, share_of_gap: float, quantile: float
) -> dict[str, Any]:
    count = int(mask.sum())
    return {
        "channel": state.output.channel,
        "muscle": state.output.element,
        "regime": name,
        "samples": count,
        "share_of_time": count / max(int(state.output.present.sum()), 1),
        "gap": float(np.sqrt((gap**2 * mask).sum() / max(count, 1))),
        "noise_floor": float(np.sqrt((least**2 * mask).sum() / max(count, 1))),
        "largest": float(np.quantile(np.abs(gap[mask]), quantile)) if count else 0.0,
        "share_of_gap": share_of_gap,
    }


def upper_ratio(state: FittedChannel, weights: Array, level: float) -> float:
    """Return the one-sided upper limit of an output's gap over the floor, over resampled trials (B, K)."""
    gap = weights @ state.current.raw
    floor = weights @ np.minimum(state.leftover.raw, state.current.raw)
    return float(np.quantile(np.sqrt(gap / np.maximum(floor, 1e-300)), level))
