"""Records of any machine: what belongs together in time, cut into blocks that serve as trials.

A tidy frame with signals side by side flows in; records in long form and their blocks flow out.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.int64]

WHOLE = "given"
"""Part of a record in a file that has no parts."""


def split_records(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame with ``record`` and ``part`` in every row.

    A record is a value of ``record`` where there is such a column, and else a run of rows of one ``part``: what follows
    in another part begins anew. The second run of a part is another record.
    """
    part = frame["part"] if "part" in frame else pd.Series(WHOLE, index=frame.index)
    if "record" in frame:
        return frame.assign(part=part)
    begins = part.ne(part.shift())
    run = begins.groupby(part).cumsum()
    return frame.assign(record=part.where(run == 1, part + "_" + run.astype(str)), part=part)


def number_blocks(frame: pd.DataFrame, blocks: int) -> Array:
    """Return for each row the number of its block, counted through all records.

    Parameters
    ----------
    frame : DataFrame
        With ``record``, the rows of each together and in the order of time.
    blocks : int
        Of each record, which differ by a sample at most; a record with fewer samples has as many blocks.
    """
    sizes = [int(size) for size in frame.groupby("record", sort=False).size()]
    within = [np.arange(size) * min(blocks, size) // size for size in sizes]
    first = np.cumsum([0, *(each[-1] + 1 for each in within[:-1])])
    return np.concatenate([each + start for each, start in zip(within, first, strict=True)])


def list_blocks(frame: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Return a row for each block: trial, part, record, start in it (s), samples, and duration (s).

    Parameters
    ----------
    frame : DataFrame
        With ``trial`` from `number_blocks`, ``part``, ``record`` and ``time_s``.
    rate_hz : float
        Samples per second.
    """
    blocks = frame.groupby("trial", sort=False)
    listed = blocks.agg(part=("part", "first"), record=("record", "first"), start_s=("time_s", "min")).reset_index()
    samples = blocks.size().to_numpy()
    return listed.assign(samples=samples, duration_s=samples / rate_hz)
