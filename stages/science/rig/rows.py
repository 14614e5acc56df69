"""From long rows back to a recording: what `tidy` made of one.

Rows of one trial flow in, one for each muscle and time; the `Recording` flows out.
"""

from typing import Any

import numpy as np
import pandas as pd

from stages.science.rig.contract import RECORDING_COLUMNS, Rig
from stages.science.rig.trial import PER_SAMPLE, Recording
from stages.science.signals.columns import Column

PUNCTUAL: dict[str, Any] = {
    "status": "ok",
    "clipped_by": "",
    "late_s": 0.0,
    "reference_shown_s": np.nan,
    "measured_shown_s": np.nan,
}
"""How samples were taken, of which a file need not tell."""


def assume_conduct(frame: pd.DataFrame) -> pd.DataFrame:
    """Return rows that are punctual, as measured and applied as asked, where a file does not tell."""
    told = frame.assign(**{name: value for name, value in PUNCTUAL.items() if name not in frame})
    return told.assign(clipped_by=told["clipped_by"].astype(object).fillna(""))


def check_values(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of `RECORDING_COLUMNS`, each of its type.

    Raises
    ------
    ValueError
        Naming the column, what was expected of it, and the first value that is otherwise.
    """
    import pandera.pandas as pa  # slow to import, and most rigs read no rows

    def declare(each: Column) -> pa.Column:
        limits = ((pa.Check.ge, each["low"]), (pa.Check.le, each["high"]), (pa.Check.isin, each["among"]))
        checks = [check(limit) for check, limit in limits if limit is not None]
        return pa.Column(each["dtype"], checks, nullable=each["nullable"])

    columns = {name: declare(each) for name, each in RECORDING_COLUMNS.items()}
    try:
        checked: pd.DataFrame = pa.DataFrameSchema(columns, strict="filter", coerce=True).validate(frame, lazy=True)
    except pa.errors.SchemaErrors as errors:
        case = errors.failure_cases.iloc[0]
        raise ValueError(f"column {case['column']}: expected {case['check']}, got {case['failure_case']}") from None
    return checked


def gather(frame: pd.DataFrame, rig: Rig) -> Recording:
    """Return the recording whose long rows these are, of every muscle at the same times, in any order.

    A joint's columns are those of its first muscle.
    """
    place = frame["muscle"].map({name: index for index, name in enumerate(rig.muscles)}).to_numpy()
    times = frame["time_s"].to_numpy(dtype=float)
    order = np.lexsort((times, place)).reshape(len(rig.muscles), -1).T
    first_muscle = [list(rig.muscle_joints).index(joint) for joint in rig.joints]
    arrays = {name: frame[name].to_numpy()[order] for name in list(RECORDING_COLUMNS)[2:]}
    arrays = {name: each[:, first_muscle] if name.startswith("joint") else each for name, each in arrays.items()}
    arrays |= {name: arrays[name][:, 0] for name in PER_SAMPLE[1:]}
    return Recording(time_s=times[order[:, 0]], **arrays)
