"""Products of triangular matrices with many columns, in blocks that leave most of the zeros out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.gp.kernel import Array

SMALLEST_BLOCK = 32
BLOCKS = 3
"""More leave more zeros out, in products too thin to be quick."""


@dataclass(frozen=True)
class Triangle:
    """Triangular matrices of one shape, stacked block by block.

    Parameters
    ----------
    blocks : sequence of (slice, slice, (M * rows, columns) float array)
        Rows of the product, columns that are not zero there, and those parts of the M matrices, one below the other.
    count : int
        M.
    """

    blocks: Sequence[tuple[slice, slice, Array]]
    count: int

    @classmethod
    def stack(cls, matrices: Sequence[Array], lower: bool) -> Triangle:
        """Stack (N, N) matrices that are all lower or all upper triangular, in at most `BLOCKS` blocks."""
        n = len(matrices[0])
        step = max(SMALLEST_BLOCK, -(-n // BLOCKS))
        blocks = []
        for start in range(0, n, step):
            stop = min(start + step, n)
            rows, columns = slice(start, stop), slice(0, stop) if lower else slice(start, n)
            blocks.append((rows, columns, np.vstack([each[rows, columns] for each in matrices])))
        return cls(blocks, len(matrices))

    @property
    def height(self) -> int:
        """Rows of the tallest block."""
        return max(len(block) for _, _, block in self.blocks)

    def multiply(self, right: Array, out: Array) -> Array:
        """Return the only matrix times (N, B) columns."""
        for rows, columns, block in self.blocks:
            np.matmul(block, right[columns], out=out[rows])
        return out

    def square(self, right: Array, spare: Array) -> Array:
        """Return the squared norms of each matrix times each of (N, B) columns, (M, B).

        Parameters
        ----------
        right : (N, B) float array
            Columns.
        spare : (height, B) float array
            Working memory.
        """
        total = np.zeros((self.count, right.shape[1]))
        for _, columns, block in self.blocks:
            product = np.matmul(block, right[columns], out=spare[: len(block)])
            shaped = product.reshape(self.count, -1, right.shape[1])
            total += np.einsum("mnb,mnb->mb", shaped, shaped)
        return total
