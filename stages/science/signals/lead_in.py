"""What came before a trial: the lead-in, in which muscles were filled, at times below 0."""

import pandas as pd


def leave_out_lead_in(recordings: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of trials, told apart from their lead-ins by the column time_s, s."""
    return recordings[recordings["time_s"] >= 0.0].reset_index(drop=True)


def measure_lead_in(recordings: pd.DataFrame) -> float:
    """Return how long the longest lead-in of trials is, s; 0 where they have none."""
    return max(-float(recordings["time_s"].min()), 0.0)
