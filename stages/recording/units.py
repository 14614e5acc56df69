"""Units in which others record, and their factors to this project's.

A column's name and a unit flow in; the factor flows out. The end of a column's name says its own unit.
"""

from __future__ import annotations

import math

FACTORS: dict[str, dict[str, float]] = {
    "rad_per_s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "m_per_s": {"m/s": 1.0, "mm/s": 1e-3},
    "per_s": {"1/s": 1.0, "percent/s": 0.01},
    "kpa": {
        "kPa": 1.0,
        "Pa": 1e-3,
        "hPa": 0.1,
        "MPa": 1e3,
        "mbar": 0.1,
        "bar": 100.0,
        "psi": 6.894757293168361,
    },
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "n": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665},
    "s": {"s": 1.0, "us": 1e-6, "ms": 1e-3, "min": 60.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254},
    "v": {"V": 1.0, "mV": 1e-3},
    "ratio": {"ratio": 1.0, "percent": 0.01},
}
"""By the end of a column's name: each unit's multiple of the first. Pressures are gauge pressures in all of them."""

WITHOUT_END = "ratio"
"""What a column is whose name ends in no unit."""


def known_units(name: str) -> dict[str, float]:
    """Return the units in which a column may be recorded, its own first, each with the factor to its own."""
    ends = [end for end in FACTORS if name == end or name.endswith(f"_{end}")]
    return FACTORS[max(ends, key=len, default=WITHOUT_END)]


def own_unit(name: str) -> str:
    """Return the unit that a column's name states."""
    return next(iter(known_units(name)))
