"""Trials of muscles and whole datasets as tables.

Tidy samples and what describes the machine flow in; a row for each trial, and `MeasuredTables` flow out.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from stages.science.recording.assembly import order_rows
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import Session, read_session

SESSION_COLUMNS = ["source", "kind", "sampling_rate_hz", "load_cell_site", "timing", "trials", "muscles"]
"""Columns of a session's one row: name, what was recorded, samples per second (Hz), where tension is measured, which
sample a command acts on, and how many trials and muscles there are."""


def tabulate_session(samples: pd.DataFrame, meta: Mapping[str, Any], source: str) -> MeasuredTables:
    """Return a session's tables; that of signals is empty.

    Parameters
    ----------
    samples : DataFrame
        A row per trial, time and muscle, without gaps in time.
    meta : mapping
        What meta.json holds.
    source : str
        Name of the session.

    Raises
    ------
    RecordingError
        When meta lacks something.
    """
    session = read_session(meta)
    muscles, rate = session.describe(), session.sampling_rate_hz
    measured = order_rows(samples, list(muscles["muscle"])).reset_index(drop=True)
    trials = list_trials(samples, rate)
    trials = trials.assign(part="", start_s=session.starts_of(trials["trial"].tolist()))
    row = (source, "muscles", rate, session.load_cell_site, session.timing, len(trials), len(muscles))
    session_row = pd.DataFrame([row], columns=SESSION_COLUMNS)
    return MeasuredTables(measured, pd.DataFrame(columns=["signal"]), trials, muscles, session_row)


def list_trials(samples: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Return number, samples and duration of each trial of muscles."""
    count = samples.groupby("trial")["time_s"].nunique()
    trials = pd.DataFrame({"trial": count.index, "record": "", "samples": count.to_numpy()})
    return trials.assign(duration_s=count.to_numpy() / rate_hz)


def find_starts(session: Session | None, starts: pd.Series) -> list[float]:
    """Return when each trial started in the session, s; nan where neither meta.json nor the clock says."""
    if session is not None and session.trial_start_s is not None:
        return session.starts_of([int(each) for each in starts.index])
    return [float(each) if starts.any() else np.nan for each in starts]
