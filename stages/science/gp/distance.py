"""All that predictions need of the distances between points and data, by two ways of equal results.

`Expanded` multiplies matrices with the square (x - x*)^2 expanded, which is fast and loses digits where data lie many
lengths apart or noise is low; `keeps_digits` says whether it does. `Direct` takes each difference.
Inputs are centred and in units of the kernel's lengths throughout; with k = k(X, x*), b = C^-1 k and a = C^-1 (y - m):

    k                                         covariance
    sum_n a_n k_n (x_n - x*)^2 - k' c_d       slope of the mean by the logarithm of each length, c_d = C^-1 K_d a
    |L' (b o (x - x*))|^2                     spread of the variance, per input
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from stages.science.gp.factor import Factor
from stages.science.gp.kernel import Array

FindRows = Callable[[], tuple[Array, Array]]

LOST_DIGITS = 2e5
"""Largest squared radius x sf / sn for `Expanded`: rounding of V stays at about 1e-10 sf^2."""


SMALLEST_BLOCK = 8
BLOCKS = 6
"""More leave more zeros out, in products too thin to be quick."""


class Triangle:
    """Products of M (N, N) triangular matrices, all lower or all upper, with columns, most of the zeros left out.

    `height` is that of the tallest block, in which the rows of all matrices stand below each other.
    """

    def __init__(self, *matrices: Array, lower: bool):
        n = len(matrices[0])
        step = max(SMALLEST_BLOCK, -(-n // BLOCKS))
        self._count, self._blocks = len(matrices), []
        for start in range(0, n, step):
            stop = min(start + step, n)
            rows, columns = slice(start, stop), slice(0, stop) if lower else slice(start, n)
            self._blocks.append((rows, columns, np.vstack([each[rows, columns] for each in matrices])))
        self.height = max(len(block) for _, _, block in self._blocks)

    def multiply(self, right: Array, out: Array) -> Array:
        """Return the only matrix times (N, B) columns."""
        for rows, columns, block in self._blocks:
            np.matmul(block, right[columns], out=out[rows])
        return out

    def square(self, right: Array, spare: Array) -> Array:
        """Return the squared norms of each matrix times each of (N, B) columns, (M, B); spare is (height, B)."""
        total = np.zeros((self._count, right.shape[1]))
        for _, columns, block in self._blocks:
            product = np.matmul(block, right[columns], out=spare[: len(block)])
            shaped = product.reshape(self._count, -1, right.shape[1])
            total += np.einsum("mnb,mnb->mb", shaped, shaped)
        return total


def keeps_digits(scaled: Array, signal_variance: float, noise_variance: float) -> bool:
    """Return whether expanding the square of (N, D) data, in units of the lengths, loses few digits."""
    radius = float(np.einsum("nd,nd->n", scaled, scaled).max())
    return radius * np.sqrt(signal_variance) <= LOST_DIGITS * np.sqrt(min(noise_variance, signal_variance))


class Expanded:
    """Distances from (N, D) centred data, in units of the lengths, to points by matrix products, `size` at a time.

    The factor is that of the noisy covariance. `find_rows` returns what slopes alone need: rows, (1 + E, N), which are
    a and what else is to be multiplied with k, and corrections, (D, N), which are c_d.
    """

    def __init__(self, scaled: Array, signal_variance: float, factor: Factor, find_rows: FindRows, size: int):
        n, d = scaled.shape
        half_norms = 0.5 * np.einsum("nd,nd->n", scaled, scaled)
        self._left = np.column_stack([scaled, np.log(signal_variance) - half_norms, np.ones(n)])
        self._right = np.ones((d + 2, size))
        self._scaled = np.ascontiguousarray(scaled.T)
        self._minus_twice = -2.0 * self._scaled
        self._factor, self._find_rows = factor, find_rows
        self._covariance = np.empty((n, size))

    @cached_property
    def _rows(self) -> Array:
        rows, corrections = self._find_rows()
        weighted = rows[0] * self._scaled
        return np.vstack([rows, -2.0 * weighted, weighted * self._scaled - corrections])

    @cached_property
    def _stack(self) -> Triangle:
        return Triangle(*(self._factor.lower.T * column for column in self._scaled), lower=False)

    @cached_property
    def _product(self) -> Array:
        return np.empty((self._stack.height, self._right.shape[1]))

    def covariance(self, points: Array) -> Array:
        """Return k, (N, B), of (D, B) points; the array is reused by the next call."""
        d, count = points.shape
        right, k = self._right[:, :count], self._covariance[:, :count]
        right[:d] = points
        np.einsum("db,db->b", points, points, out=right[d + 1])
        right[d + 1] *= -0.5
        np.matmul(self._left, right, out=k)
        return np.exp(k, out=k)

    def mean_slopes(self, points: Array, k: Array) -> tuple[Array, Array]:
        """Return rows k, (1 + E, B), with a'k first, and the mean's slopes, (D, B); call after `covariance`."""
        d = len(points)
        linear = self._rows @ k
        slopes = points * linear[0]
        slopes += linear[-2 * d : -d]
        slopes *= points
        slopes += linear[-d:]
        return linear[: -2 * d], slopes

    def variance_spread(self, points: Array, k: Array, b: Array, norms: Array) -> Array:
        """Return |L' (b o (x - x*))|^2, (D, B); call after `covariance`; b is overwritten; norms are k'b, (B,)."""
        spread = self._stack.square(b, self._product[:, : b.shape[1]])
        np.multiply(b, k, out=b)
        crossed = points * norms
        crossed += self._minus_twice @ b
        crossed *= points
        spread += crossed
        return np.maximum(spread, 0.0, out=spread)


class Direct:
    """Distances by differences; takes and returns what `Expanded` does."""

    def __init__(self, scaled: Array, signal_variance: float, factor: Factor, find_rows: FindRows, size: int):
        n, d = scaled.shape
        self._scaled, self._find_rows = scaled, find_rows
        self._log_signal = np.log(signal_variance)
        self._upper = Triangle(factor.lower.T, lower=False)
        self._covariance = np.empty((n, size))
        self._differences = np.empty((d, n, size))
        self._spare = np.empty((n, size))
        self._product = np.empty((self._upper.height, size))

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        return self._find_rows()

    def covariance(self, points: Array) -> Array:
        """Return k, (N, B)."""
        count = points.shape[1]
        k, spare = self._covariance[:, :count], self._spare[:, :count]
        k[:] = self._log_signal
        for column, point, difference in zip(self._scaled.T, points, self._differences[:, :, :count], strict=True):
            np.subtract(column[:, None], point, out=difference)
            np.multiply(difference, difference, out=spare)
            spare *= 0.5
            k -= spare
        return np.exp(k, out=k)

    def mean_slopes(self, points: Array, k: Array) -> tuple[Array, Array]:
        """Return rows k, (1 + E, B), and the mean's slopes, (D, B)."""
        rows, corrections = self._linear
        spare, slopes = self._spare[:, : k.shape[1]], -(corrections @ k)
        for i, difference in enumerate(self._differences[:, :, : k.shape[1]]):
            np.multiply(difference, k, out=spare)
            spare *= difference
            slopes[i] += rows[0] @ spare
        return rows @ k, slopes

    def variance_spread(self, points: Array, k: Array, b: Array, norms: Array) -> Array:
        """Return the spread of the variance, (D, B)."""
        count = b.shape[1]
        spare, spread = self._spare[:, :count], np.empty_like(points)
        for i, difference in enumerate(self._differences[:, :, :count]):
            np.multiply(difference, b, out=spare)
            spread[i] = self._upper.square(spare, self._product[:, :count])[0]
        return spread
