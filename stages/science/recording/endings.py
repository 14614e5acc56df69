"""Parts of a recording side by side, told by the ends of their names: uEst, yEst, uVal, yVal become u, y and a part.

Names flow in, and later a frame for each end; one frame with a column ``part`` flows out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from stages.science.recording.columns import RecordingError


def name_parts(names: Sequence[str], header: Sequence[str], endings: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return for each end the file's columns and the names without it, of those names that are wanted.

    A column without any of the ends belongs to all parts.

    Raises
    ------
    RecordingError
        When no wanted name ends so in the file.
    """
    found = {}
    for end in endings:
        own = {f"{name}{end}": name for name in names if f"{name}{end}" in header}
        if not own:
            raise RecordingError(
                f"measurement.part_endings: expected columns such as {names[0]}{end}, got none that is mapped and ends "
                f"in {end}; there are: {', '.join(header)}"
            )
        found[end] = own | {name: name for name in names if name in header and name not in own.values()}
    return found


def join_parts(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all parts, each with its end as ``part``; empty rows at a part's end are left out."""
    told = []
    for end, frame in frames.items():
        present = frame.notna().any(axis=1).to_numpy()
        last = len(frame) - int(present[::-1].argmax()) if present.any() else 0
        told.append(frame.iloc[:last].assign(part=end.strip("_- .")))
    return pd.concat(told, ignore_index=True)
