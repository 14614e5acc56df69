"""Static laws other than the ideal braid's, by key.

Flows in: a key and a generator. Flows out: a law with the constants of one session's four muscles, matched to the data
sheet's forces and ranges; no law is an ideal braid with a polynomial added.
"""

from collections.abc import Callable

import numpy as np

from stages.benchmark.blinded_rig.laws.exponential import build_exponential
from stages.benchmark.blinded_rig.laws.stretch import build_stretch
from stages.benchmark.blinded_rig.laws.table import build_table
from stages.benchmark.blinded_rig.laws.virtual_work import build_virtual_work
from stages.benchmark.blinded_rig.machine import StaticLaw

BRAID = "braid"
LAWS: dict[str, Callable[[np.random.Generator], StaticLaw]] = {
    "exponential": build_exponential,
    "virtual_work": build_virtual_work,
    "table": build_table,
    "stretch": build_stretch,
}


def build_law(key: str, rng: np.random.Generator) -> StaticLaw | None:
    """Return the law of one session; None for the ideal braid, which the machine itself computes.

    Raises
    ------
    ValueError
        A key that names no law.
    """
    if key == BRAID:
        return None
    if key not in LAWS:
        raise ValueError(f"unknown law {key!r}; there are: {BRAID}, {', '.join(LAWS)}")
    return LAWS[key](rng)
