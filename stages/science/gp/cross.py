"""The covariance between a few pseudo-inputs and many data, and its slopes, by two ways of equal results.

`ExpandedCross` multiplies matrices with the square (p - x)^2 expanded; `DirectCross` takes each difference, for data
that lie many lengths apart (see `distance`). All inputs are in units of the kernel's lengths. With pseudo-inputs p and
weights E, both (M, B) over a block of data:

    covariance  sf^2 exp(-1/2 |p - x|^2)
    slopes      sum_n E (p_d - x_nd) of each pseudo-input, and sum_mn E (p_md - x_nd)^2
"""

import numpy as np

from stages.science.gp.distance import keeps_digits
from stages.science.gp.kernel import Array


class ExpandedCross:
    """By matrix products, from (M, D) pseudo-inputs and (D, N) data that are centred alike."""

    def __init__(self, pseudo: Array, columns: Array, signal_variance: float):
        d, n = columns.shape
        self._pseudo = pseudo
        self._rows = np.ones((2 * d + 1, n))
        self._rows[:d] = columns
        np.square(columns, out=self._rows[d : 2 * d])
        constants = np.log(signal_variance) - 0.5 * np.einsum("md,md->m", pseudo, pseudo)
        self._left = np.column_stack([pseudo, np.full(pseudo.shape, -0.5), constants])

    def covariance(self, block: slice, out: Array) -> Array:
        """Return the (M, B) covariance with a block of the data."""
        np.matmul(self._left, self._rows[:, block], out=out)
        return np.exp(out, out=out)

    def slopes(self, block: slice, weights: Array) -> tuple[Array, Array, float]:
        """Return the differences, (M, D), and squares, (D,), under (M, B) weights, and the weights' sum."""
        d = self._pseudo.shape[1]
        moments = weights @ self._rows[:, block].T
        first, second, total = moments[:, :d], moments[:, d:-1], moments[:, -1:]
        differences = self._pseudo * total - first
        return differences, (self._pseudo * (differences - first) + second).sum(axis=0), float(total.sum())


class DirectCross:
    """By differences; takes and returns what `ExpandedCross` does."""

    def __init__(self, pseudo: Array, columns: Array, signal_variance: float):
        self._pseudo, self._columns = pseudo, columns
        self._log_signal = np.log(signal_variance)

    def covariance(self, block: slice, out: Array) -> Array:
        """Return the covariance with a block."""
        out[:] = self._log_signal
        for own, column in zip(self._pseudo.T, self._columns[:, block], strict=True):
            out -= 0.5 * (own[:, None] - column) ** 2
        return np.exp(out, out=out)

    def slopes(self, block: slice, weights: Array) -> tuple[Array, Array, float]:
        """Return the weighted differences and squares, and the sum."""
        differences, squares = np.empty(self._pseudo.shape), np.empty(self._pseudo.shape[1])
        for i, (own, column) in enumerate(zip(self._pseudo.T, self._columns[:, block], strict=True)):
            difference = own[:, None] - column
            differences[:, i] = np.einsum("mn,mn->m", weights, difference)
            squares[i] = np.einsum("mn,mn,mn->", weights, difference, difference)
        return differences, squares, float(weights.sum())


Cross = ExpandedCross | DirectCross


def choose_cross(pseudo: Array, columns: Array, signal_variance: float, noise_variance: float) -> Cross:
    """Return the faster way that keeps the digits beside a noise of sn^2."""
    kept = all(keeps_digits(each, signal_variance, noise_variance) for each in (pseudo, columns.T))
    return (ExpandedCross if kept else DirectCross)(pseudo, columns, signal_variance)
