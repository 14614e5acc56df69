"""How far a prediction is from a measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def rmse(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the root mean square of the difference, in the unit of the data.

    Raises
    ------
    ValueError
        When shapes differ or there is nothing to compare.
    """
    predicted, measured = np.asarray(predicted, dtype=float), np.asarray(measured, dtype=float)
    if predicted.shape != measured.shape or measured.size == 0:
        raise ValueError(
            f"expected predicted and measured of one shape, not empty; got {predicted.shape} and {measured.shape}"
        )
    return float(np.sqrt(np.mean((predicted - measured) ** 2)))


def error_rate(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the RMSE divided by the largest measured force (paper, section 5.1).

    Parameters
    ----------
    predicted, measured : array_like of one shape
        Forces, N.

    Raises
    ------
    ValueError
        When shapes differ, there is nothing to compare, or no measured force is positive.
    """
    error = rmse(predicted, measured)
    largest = float(np.max(measured))
    if not largest > 0.0:
        raise ValueError(f"expected a positive measured force to divide by, got a maximum of {largest} N")
    return error / largest
