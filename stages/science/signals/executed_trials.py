"""Executed trials of a study, joined and numbered: tables of the initial and of the designed ones flow in."""

import pandas as pd


def join_executed(initial: pd.DataFrame, designed: pd.DataFrame | None) -> pd.DataFrame:
    """Return the rows of a study's executed trials, numbered from 0 in a column `trial`: initial ones, then designed.

    Rows are those of `hardware_recordings`, and of `active_recordings` where there are some: of these, the trials of
    the first arm, which is the design's. Other columns that the two do not share are left out.
    """
    trials = initial.groupby(["participant", "experiment", "position"], sort=False).ngroup()
    frames = [initial.assign(trial=trials)]
    if designed is not None and len(designed):
        own = designed[designed["arm"] == designed["arm"].iloc[0]]
        further = own.groupby(["participant", "experiment", "trial"], sort=False).ngroup()
        frames.append(own.assign(trial=trials.max() + 1 + further))
    return pd.concat(frames, join="inner", ignore_index=True)
