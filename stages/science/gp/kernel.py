"""The squared-exponential kernel with a length for each input, and the hyperparameter vector.

k(x, x') = sf^2 exp(-1/2 sum_d (x_d - x'_d)^2 / l_d^2), with theta = [log l_1 .. log l_D, log sf, log sn, (mean)].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEANS = ("zero", "constant")


@dataclass(frozen=True)
class Hyperparameters:
    """A hyperparameter vector, read: (D,) lengths, sf^2, sn^2, and the mean, 0 without a constant one."""

    lengths: Array
    signal_variance: float
    noise_variance: float
    mean: float

    @classmethod
    def read(cls, theta: Array, dimensions: int) -> Hyperparameters:
        """Read a vector of D + 2 or, with a constant mean, D + 3 entries."""
        signal_variance, noise_variance = (float(np.exp(2 * each)) for each in theta[dimensions : dimensions + 2])
        mean = float(theta[dimensions + 2]) if theta.size > dimensions + 2 else 0.0
        return cls(np.exp(theta[:dimensions]), signal_variance, noise_variance, mean)


def count_hyperparameters(dimensions: int, mean: str) -> int:
    """Return the length of theta; a `ValueError` tells a mean that is neither zero nor constant."""
    if mean not in MEANS:
        raise ValueError(f"mean: expected one of {', '.join(MEANS)}, got {mean!r}")
    return dimensions + 2 + (mean == "constant")


def squared_differences(inputs: Array) -> Array:
    """Return (D, N, N) squared differences of each input between all rows."""
    columns = inputs.T
    return (columns[:, :, None] - columns[:, None, :]) ** 2


def covariance_among(squares: Array, hyperparameters: Hyperparameters) -> Array:
    """Return the (N, N) covariance among rows from their (D, N, N) squared differences."""
    weights = -0.5 / hyperparameters.lengths[None] ** 2
    exponent: Array = np.dot(weights, squares.reshape(len(squares), -1)).reshape(squares.shape[1:])
    np.exp(exponent, out=exponent)
    exponent *= hyperparameters.signal_variance
    return exponent
