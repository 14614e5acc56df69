"""What follows from what was measured: contraction from the joint's angle, velocity from contraction.

Tidy rows of muscles over time flow in; the missing columns flow out. Gaps stay gaps.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stages.science.signals.filtering import differentiate, window_length
from stages.science.signals.trajectories import Array


def derive_contraction(frame: pd.DataFrame, muscles: pd.DataFrame) -> Array:
    """Return contraction, ratio of rest length, from the joint's angle by a constant moment arm.

    Parameters
    ----------
    frame : DataFrame
        With ``muscle`` and ``joint_angle_rad``.
    muscles : DataFrame
        Geometry of each, under `MUSCLE_COLUMNS`.
    """
    geometry = muscles.set_index("muscle").loc[frame["muscle"]]
    per_rad = (geometry["sign"] * geometry["moment_arm_m"] / geometry["rest_length_m"]).to_numpy()
    return geometry["contraction_at_angle_0"].to_numpy() + per_rad * frame["joint_angle_rad"].to_numpy()


def derive_velocity(
    frame: pd.DataFrame, name: str, stream: list[str], rate_hz: float, window_s: float, order: int
) -> Array:
    """Return the filtered derivative of a column, per s, in each unbroken stretch of each stream.

    Parameters
    ----------
    frame : DataFrame
        On a uniform clock, with the column.
    name : str
        The column to differentiate.
    stream : list of str
        Columns that tell streams apart.
    rate_hz, window_s, order : float, float, int
        As of `differentiate`; a stretch shorter than the window has no derivative.
    """
    values = frame[name].to_numpy(dtype=float)
    velocity = np.full(len(values), np.nan)
    shortest = window_length(rate_hz, window_s, order)
    number = frame.groupby(stream, sort=False).ngroup().to_numpy()
    for rows in np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1]):
        for present in np.ma.flatnotmasked_contiguous(np.ma.masked_invalid(values[rows])):
            stretch = rows[present]
            if len(stretch) >= shortest:
                velocity[stretch] = differentiate(values[stretch], rate_hz, window_s, order)
    return velocity
