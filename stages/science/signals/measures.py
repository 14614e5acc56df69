"""How far a prediction is from a measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

LARGEST_VALUE = 1e150
SMALLEST_FORCE = 1e-150
"""Quotients of values between them are finite."""


def rmse(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the root mean square of the difference, in the unit of the data.

    Raises
    ------
    ValueError
        When shapes differ, there is nothing to compare or a value is absurdly large.
    """
    predicted, measured = np.asarray(predicted, dtype=float), np.asarray(measured, dtype=float)
    if predicted.shape != measured.shape or measured.size == 0:
        raise ValueError(
            f"expected predicted and measured of one shape, not empty; got {predicted.shape} and {measured.shape}"
        )
    largest = max(float(np.abs(predicted).max()), float(np.abs(measured).max()))
    if largest > LARGEST_VALUE:
        raise ValueError(f"expected values within {LARGEST_VALUE:g}, got {largest}")
    difference = predicted - measured
    # squares of values near 1 neither overflow nor vanish; a power of two leaves every digit as it is
    exponent = int(np.frexp(np.nan_to_num(np.abs(difference).max()))[1])
    return float(np.ldexp(np.sqrt(np.mean(np.ldexp(difference, -exponent) ** 2)), exponent))


def error_rate(predicted: ArrayLike, measured: ArrayLike) -> float:
    """Return the RMSE of forces, N, divided by the largest measured one (paper, section 5.1).

    Raises
    ------
    ValueError
        When shapes differ, there is nothing to compare, or no measured force is positive.
    """
    error = rmse(predicted, measured)
    largest = float(np.max(measured))
    if not largest > SMALLEST_FORCE:
        raise ValueError(f"expected a positive measured force to divide by, got a maximum of {largest} N")
    return error / largest
