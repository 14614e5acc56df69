"""Trials with a far larger error than the others, as after a loose cable.

Predictions flow in; trials flow out, with how far they are off.
"""

from __future__ import annotations

import pandas as pd


def find_odd_trials(predictions: pd.DataFrame, least_ratio: float) -> pd.DataFrame:
    """Return the trials whose error is many times the usual one.

    Parameters
    ----------
    predictions : DataFrame
        Columns ``trial muscle channel measured after``.
    least_ratio : float
        Error of a trial over the median of its channel's trials, above which it is odd.

    Returns
    -------
    DataFrame
        Columns ``trial channel muscle ratio``: error over the median over the channel's trials; the worst first.
    """
    square = (predictions["measured"] - predictions["after"]) ** 2
    by_trial = square.groupby([predictions[name] for name in ("channel", "muscle", "trial")]).mean() ** 0.5
    usual = by_trial.groupby(["channel", "muscle"]).transform("median")
    ratio = (by_trial / usual.where(usual > 0.0)).rename("ratio").reset_index()
    return ratio[ratio["ratio"] > least_ratio].sort_values("ratio", ascending=False).reset_index(drop=True)
