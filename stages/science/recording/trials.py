"""Trials of muscles: how long each is, and when it began.

Tidy samples flow in, with what a session tells of itself; a row for each trial flows out.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stages.science.recording.muscles import Session


def list_trials(samples: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Return number, samples and duration of each trial of muscles."""
    count = samples.groupby("trial")["time_s"].nunique()
    return pd.DataFrame(
        {"trial": count.index, "record": "", "samples": count.to_numpy(), "duration_s": count.to_numpy() / rate_hz}
    )


def find_starts(session: Session | None, starts: pd.Series) -> list[float]:
    """Return when each trial started in the session, s; nan where neither meta.json nor the clock says."""
    if session is not None and session.trial_start_s is not None:
        return session.starts_of([int(each) for each in starts.index])
    return [float(each) if starts.any() else np.nan for each in starts]
