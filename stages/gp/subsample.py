"""The samples of a recording that tell most, picked greedily and re-conditioned after each pick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.gp.marginal import MarginalGP

Array = NDArray[np.float64]


def subsample(model: MarginalGP, inputs: Array, outputs: Array, count: int, utility: str) -> NDArray[np.intp]:
    """Pick samples one by one by their utility, each time given those picked before.

    theta_MAP and S are held; V and its derivatives need no output, the mean's derivatives use the picks' recorded one.

    Parameters
    ----------
    model : MarginalGP
        Before the recording.
    inputs, outputs : (T, D) and (T,) float arrays
        The recording, standardised.
    count : int
        How many to pick.
    utility : str
        A point utility.

    Returns
    -------
    (count,) int array
        Rows of the recording, in the order of picking.

    Raises
    ------
    ValueError
        When there are fewer samples than picks.
    """
    if not 0 <= count <= len(inputs):
        raise ValueError(f"count: expected between 0 and {len(inputs)} picks, got {count}")
    picks: list[int] = []
    for _ in range(count):
        scores = model.utility(inputs, utility)
        scores[picks] = -np.inf
        best = int(np.argmax(scores))
        picks.append(best)
        model = model.grow(inputs[best : best + 1], outputs[best : best + 1])
    return np.array(picks, dtype=np.intp)
