"""The tables that hold a measured dataset, as one value."""

from dataclasses import dataclass

import pandas as pd


@dataclass(frozen=True)
class MeasuredTables:
    """What was measured; each field is named as its table."""

    measured: pd.DataFrame
    """A row per trial, muscle and time; empty for records of another machine."""
    measured_signals: pd.DataFrame
    """A row per record, signal and time; empty for muscles."""
    measured_trials: pd.DataFrame
    measured_muscles: pd.DataFrame
    """A row for each trial, and for each muscle."""
    measured_session: pd.DataFrame
    """One row: source, kind, sampling rate, site of the load cell."""
