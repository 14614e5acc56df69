"""The interval of a mean: spread and number of values flow in, a width flows out."""

from __future__ import annotations

import math

CONFIDENCE = 0.95


def half_width(spread: float, count: int) -> float:
    """Return half of the 95 % interval (t) of a mean, from the SD and number of its values; nan for fewer than two."""
    from scipy.special import stdtrit

    if count < 2:
        return float("nan")
    return float(stdtrit(count - 1, (1 + CONFIDENCE) / 2) * spread / math.sqrt(count))
