"""Executed trials of a study, joined and numbered: tables of the initial and of the designed ones flow in."""

import pandas as pd


def join_executed(initial: pd.DataFrame, designed: pd.DataFrame | None) -> pd.DataFrame:
    """Return the rows of a study's executed trials, numbered from 0 in a column `trial`: initial ones, then designed.

    Rows are those of `hardware_recordings`, and of `active_recordings` where there are some: of these, the trials of
    the first arm, which is the design's. Other columns that the two do not share are left out.
    """
    parts = [(initial, ["participant", "experiment", "position"])]
    if designed is not None and len(designed):
        own = designed[designed["arm"] == designed["arm"].iloc[0]]
        parts.append((own, ["participant", "experiment", "trial"]))
    frames: list[pd.DataFrame] = []
    for rows, keys in parts:
        before = frames[-1]["trial"].max() + 1 if frames else 0
        frames.append(rows.assign(trial=before + rows.groupby(keys, sort=False).ngroup()))
    shared = [name for name in frames[0] if all(name in each for each in frames)]
    return pd.concat([each[shared] for each in frames], ignore_index=True)
