"""Values that a sensor shows again and again, exactly: the level at which it ends."""

from __future__ import annotations

from stages.discrepancy.cell import Cell

LEAST_SHARE, LEAST_COUNT = 0.005, 20
"""Share and number of samples at exactly the largest value from which it is taken for a level."""


def find_level(cell: Cell) -> float | None:
    """Return the level at which a channel is clipped, in its unit, or None.

    Noise makes every value of a sensor differ from the next; where the largest comes again and again it is the end of
    the scale.
    """
    values = cell.measured[cell.present]
    if not values.size or cell.range == 0.0:
        return None
    largest = float(values.max())
    count = int((values >= largest - 1e-9 * cell.range).sum())
    return largest if count >= max(LEAST_COUNT, LEAST_SHARE * values.size) else None
