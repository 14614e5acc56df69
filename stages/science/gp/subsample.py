"""The samples of a recording that tell most, picked greedily and re-conditioned after each pick."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP

Displace = Callable[[int, Sequence[int]], int]
"""Returns the row to take in place of a picked one, given the rows taken so far, of which it is none."""


def subsample(
    model: MarginalGP, inputs: Array, outputs: Array, count: int, utility: str, displace: Displace | None = None
) -> NDArray[np.intp]:
    """Pick samples one by one by their utility, each time given those picked before.

    theta_MAP and S are held; V and its derivatives need no output, the mean's derivatives use the picks' recorded one.

    The standardised recording is (T, D) inputs and (T,) outputs. `displace` may take another row in place of each
    pick, which the later picks are then given. Returns the (count,) rows that were taken, in the order of picking. A
    `ValueError` tells too few samples, a shape that does not fit, or a needed value that is not finite.
    """
    inputs, outputs = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    if inputs.ndim != 2 or outputs.shape != inputs.shape[:1]:
        raise ValueError(f"expected inputs (N, D) and outputs (N,), got shapes {inputs.shape} and {outputs.shape}")
    check_count(count, len(inputs))
    picks: list[int] = []
    for _ in range(count):
        scores = model.utility(inputs, utility)
        scores[picks] = -np.inf
        best = int(np.argmax(scores))
        picks.append(best if displace is None else displace(best, picks))
        model = model.grow(inputs[picks[-1:]], outputs[picks[-1:]])
    return np.array(picks, dtype=np.intp)


def check_count(count: int, samples: int) -> None:
    """Refuse, by a `ValueError`, more picks than samples."""
    if not 0 <= count <= samples:
        raise ValueError(f"count: expected between 0 and {samples} picks, got {count}")
