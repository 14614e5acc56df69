"""Records of any machine: what belongs together in time, cut into blocks that serve as trials.

A tidy frame with signals side by side flows in; records in long form and their blocks flow out.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

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
    record = part.where(run == 1, part + "_" + run.astype(str))
    return frame.assign(record=record, part=part)


def cut_blocks(samples: int, blocks: int) -> np.ndarray:
    """Return for each sample of a record the number of its block, from 0; blocks differ by a sample at most."""
    return np.arange(samples) * min(blocks, samples) // samples
