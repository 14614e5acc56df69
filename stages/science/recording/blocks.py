"""Records of any machine: what belongs together in time, cut into blocks that serve as trials.

A tidy frame with signals side by side flows in; records in long form and their blocks flow out.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.recording.assembly import Notes
from stages.science.recording.clock import regularise
from stages.science.recording.rates import equalise, find_rates

Array = NDArray[np.int64]

MANY = 6
"""Records of a part from which each is a trial: blocks of one share its zero and gain, so that they are no trials of
their own. With fewer, no two-sided test of signs at 95 % can be significant (2 / 2**5 > 0.05)."""

AT_START = 10.0
"""Steps from the first sample within which time begins anew if it goes back there."""

WHOLE, PROPOSED = "given", "proposed"
"""Part of a record in a file that has no parts."""


def split_records(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame with ``record`` and ``part`` in every row.

    A record is a value of ``record`` where there is such a column, and else a run of rows of one ``part`` in which time
    does not begin anew: what follows in another part begins anew. The second run of a part is another record. Records
    that are counted anew in each part are named after both.
    """
    part = frame["part"] if "part" in frame else pd.Series(WHOLE, index=frame.index)
    if "record" in frame:
        anew = part.groupby(frame["record"]).nunique().gt(1).any()
        return frame.assign(record=part + " " + frame["record"] if anew else frame["record"], part=part)
    begins = part.ne(part.shift()) | begins_anew(frame)
    run = begins.groupby(part).cumsum()
    return frame.assign(record=part.where(run == 1, part + "_" + run.astype(str)), part=part)


def begins_anew(frame: pd.DataFrame) -> NDArray[np.bool_]:
    """Return in which rows time begins anew: goes back to where it began, or on by more than all that was recorded.

    So it does where a logger was started again. Where it goes back to elsewhere, rows are out of order.
    """
    if "time_s" not in frame or len(frame) < 3:
        return np.zeros(len(frame), dtype=bool)
    time = frame["time_s"].to_numpy(dtype=float)
    steps = np.diff(time, prepend=time[0])
    usual = float(np.nanmedian(steps[1:]))
    back = (steps < 0.0) & (time - time[0] <= AT_START * usual)
    return np.asarray(back | ((steps > len(time) * usual) & (usual > 0.0)))


def number_blocks(frame: pd.DataFrame, blocks: int) -> Array:
    """Return for each row the number of its block, counted through all records, whose rows are in the order of time.

    The blocks of each part are shared among its records by their lengths, at least one for each; of `MANY` records,
    each is one. Those of a record differ by a sample at most; a record with fewer samples has as many blocks.
    """
    records = frame.groupby("record", sort=False)
    sizes, parts = records.size(), records["part"].first()
    shares = blocks * sizes / sizes.groupby(parts).transform("sum")
    several = sizes.groupby(parts).transform("size") < MANY
    counts = np.clip(np.rint(shares.where(several, 1.0)), 1, sizes).astype(int)
    within = [np.arange(size) * count // size for size, count in zip(sizes, counts, strict=True)]
    first = np.cumsum([0, *(each[-1] + 1 for each in within[:-1])])
    return np.concatenate([each + start for each, start in zip(within, first, strict=True)])


def arrange_records(
    frame: pd.DataFrame,
    signals: Sequence[str],
    blocks: int,
    stated_hz: float | None,
    largest_jitter: float,
    notes: Notes,
) -> tuple[pd.DataFrame, float]:
    """Return records on one clock, cut into blocks, and samples per second.

    The frame is from `split_records`, its clocks from `even_out`; a sample has a row with ``record``, ``part``,
    ``trial``, ``time_s`` and the signals. The notes receive what was resampled, and how many rows were missing; a
    `RecordingError` tells a clock that is not uniform.
    """
    parts = frame.groupby("record", sort=False)["part"].first()
    rates = find_rates(frame, stated_hz)
    columns = ["record", "time_s", *signals]
    placed = [
        regularise(rows[columns], "record", [], float(rate), largest_jitter)[0]
        for rate, rows in frame.groupby(frame["record"].map(rates), sort=False)
    ]
    together = pd.concat(placed, ignore_index=True)
    had, has = frame["record"].value_counts(sort=False), together["record"].value_counts(sort=False)
    notes += [
        (f"record {name}", f"{has[name] - had[name]} of its {has[name]} rows were missing: samples without values")
        for name in had.index
        if has[name] > had[name]
    ]
    order = together["record"].map({name: k for k, name in enumerate(parts.index)})
    together = together.iloc[order.argsort(kind="stable")].reset_index(drop=True)
    told, rate = equalise(together, rates, signals, largest_jitter, notes)
    told = told.assign(part=told["record"].map(parts))
    return told.assign(trial=number_blocks(told, blocks)), rate


def list_blocks(frame: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Return a row for each ``trial`` of `number_blocks`: part, record, start in it (s), samples, and duration (s)."""
    blocks = frame.groupby("trial", sort=False)
    listed = blocks.agg(part=("part", "first"), record=("record", "first"), start_s=("time_s", "min")).reset_index()
    samples = blocks.size().to_numpy()
    return listed.assign(samples=samples, duration_s=samples / rate_hz)
