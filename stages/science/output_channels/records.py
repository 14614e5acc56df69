"""Records of signals as arrays, from which the output channel of a machine without muscles is built.

Tidy signals flow in; by record, arrays without gaps and where they were measured flow out.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.signals.trajectories import Array

SHARPENED = 24.0
"""Second difference of the means over the extra bias of triangular weights on a curved signal."""


def spread_records(signals: pd.DataFrame, names: Sequence[str]) -> tuple[dict[str, pd.DataFrame], float]:
    """Return each record's signals, a column each, by evenly spaced times; and the time between samples, s.

    Records are in the order in which they come. A `ValueError` tells a named signal that is missing or has no values.
    """
    wide = signals.pivot(index=["record", "time_s"], columns="signal", values="value")
    for name in names:
        if name not in wide or not wide[name].notna().any():
            raise ValueError(f"signal {name}: expected values, got none; known are {', '.join(map(str, wide.columns))}")
    records = {str(name): wide.loc[name] for name in signals["record"].unique()}
    return records, float(np.median(np.diff(next(iter(records.values())).index)))


def bridge(column: pd.Series) -> Array:
    """Return values with gaps bridged by straight lines and ends held."""
    values = column.to_numpy(dtype=float)
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known]) if len(known) else np.zeros(len(values))


def bridge_short(column: pd.Series, longest: int) -> pd.Series:
    """Return evenly sampled values with gaps of at most `longest` samples interpolated linearly."""
    missing = column.isna()
    lengths = missing.groupby((~missing).cumsum()).transform("sum")
    return column.interpolate(limit_area="inside").mask(missing & (lengths > longest))


def thin_out(rows: pd.DataFrame, stride: int, pushing: Sequence[str] = ()) -> pd.DataFrame:
    """Return means of each `stride` samples of a record, at the time of the first; missing where one is missing.

    A motion adds the noise of signals that are `pushing` it up twice, so that not only how much they push matters but
    when: their means are weighted by triangles, which keep both.
    """
    if stride == 1:
        return rows
    whole = len(rows) // stride * stride
    values = rows.to_numpy(dtype=float)[:whole]
    means = values.reshape(-1, stride, rows.shape[1]).mean(axis=1)
    for place in (rows.columns.get_loc(name) for name in pushing):
        means[:, place] = _weigh_by_triangles(values[:, place], stride)
    return pd.DataFrame(means, index=rows.index[:whole:stride], columns=rows.columns)


def _weigh_by_triangles(values: Array, stride: int) -> Array:
    """Return means of each `stride` values, weighted by triangles that reach to the middles of the neighbours.

    Put back on straight lines between the middles, they have the sum and the first moment of the values themselves.
    """
    middle = 0.5 * (stride - 1)
    places = np.arange(int(np.ceil(middle)), len(values) - stride + int(middle) + 1)
    left, share = np.divmod((places - middle) / stride, 1.0)
    left = left.astype(int)
    count = len(values) // stride
    pushed, weight = np.zeros(count + 1), np.zeros(count + 1)
    for at, part in ((left, 1.0 - share), (left + 1, share)):
        pushed += np.bincount(at, part * values[places], count + 1)
        weight += np.bincount(at, part, count + 1)
    means = pushed[:count] / weight[:count]
    means[1:-1] -= np.diff(means, 2) / SHARPENED
    return means
