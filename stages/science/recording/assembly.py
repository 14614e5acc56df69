"""Recordings of muscles made whole: muscles with data, one part for each trial, columns that follow from others.

Adopted samples and the muscles' descriptions flow in; samples with every reading flow out, with notes on what was left
out or derived.
"""

from collections.abc import Sequence
from difflib import get_close_matches

import numpy as np
import pandas as pd

from stages.science.plant.exoskeleton import VelocityFilter
from stages.science.recording.columns import RecordingError, name_rows
from stages.science.signals.filtering import differentiate, window_length
from stages.science.signals.trajectories import Array

Notes = list[tuple[str, str]]
"""What a note is about, and the note."""

READINGS = (
    "pressure_command_kpa",
    "pressure_kpa",
    "contraction",
    "contraction_velocity_per_s",
    "force_n",
    "joint_angle_rad",
    "joint_velocity_rad_per_s",
)
"""What is measured in a sample."""
INDISPENSABLE = ("pressure_kpa", "force_n")
"""Readings without which a muscle tells nothing."""


def choose_muscles(
    samples: pd.DataFrame, muscles: pd.DataFrame, described_in: str, notes: Notes
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return samples and descriptions of the muscles that have data; samples by trial, muscle and time.

    The muscles are under `MUSCLE_COLUMNS`, in the order wanted; the notes receive those that are left out. A
    `RecordingError` tells a muscle that is not described, or that none has data.
    """
    known = list(muscles["muscle"])
    strange = ~samples["muscle"].isin(known)
    if strange.any():
        name = str(samples.loc[strange, "muscle"].iloc[0])
        near = get_close_matches(name, known, n=1) or known
        raise RecordingError(
            f"column muscle: {described_in} has no muscle '{name}' of {name_rows(strange)}; it has {', '.join(near)}"
        )
    used = []
    for name in known:
        rows = samples[samples["muscle"] == name]
        empty = [each for each in INDISPENSABLE if rows[each].isna().all()]
        if empty:
            lacks = "rows" if rows.empty else f"values in column {' and '.join(empty)}"
            notes.append((name, f"left out: no {lacks}"))
        else:
            used.append(name)
    if not used:
        both = " and ".join(INDISPENSABLE)
        raise RecordingError(f"columns {both}: expected values of both for some muscle, got none")
    chosen = order_rows(samples[samples["muscle"].isin(used)], used)
    return chosen, muscles.set_index("muscle").loc[used].reset_index()


def note_missing(samples: pd.DataFrame, names: Sequence[str]) -> Notes:
    """Return notes on columns of which some values are missing, with how many."""
    counts = samples[[name for name in names if name in samples]].isna().sum()
    return [
        (str(name), f"{count} of {len(samples)} values are missing ({100.0 * count / len(samples):.2g} %)")
        for name, count in counts.items()
        if 0 < count < len(samples)
    ]


def order_rows(samples: pd.DataFrame, muscles: Sequence[str]) -> pd.DataFrame:
    """Return samples by trial, by muscle in a given order, and by time."""
    place = samples["muscle"].map({name: index for index, name in enumerate(muscles)})
    return samples.assign(place=place).sort_values(["trial", "place", "time_s"], kind="stable").drop(columns="place")


def read_parts(samples: pd.DataFrame, without: str) -> pd.Series:
    """Return each trial's part, `without` where the file has none; a `RecordingError` tells a trial of two."""
    if "part" not in samples:
        return pd.Series(without, index=samples["trial"].unique())
    parts = samples.groupby("trial")["part"]
    mixed = parts.transform("nunique") > 1
    if mixed.any():
        raise RecordingError(f"column part: expected one for each trial, got more for that of {name_rows(mixed)}")
    return parts.first()


def complete(
    samples: pd.DataFrame, muscles: pd.DataFrame, rate_hz: float, window: VelocityFilter, notes: Notes
) -> pd.DataFrame:
    """Return the samples with all readings, derived where that is possible and empty where it is not.

    The samples are on a uniform clock, the muscles under `MUSCLE_COLUMNS`; velocities are derived in the window. The
    notes receive what was derived or is missing; a `RecordingError` tells that there is neither contraction nor angle.
    """
    if "contraction" not in samples:
        if "joint_angle_rad" not in samples:
            raise RecordingError(
                "no column contraction and no joint_angle_rad, of which one is needed; say which with "
                "columns.contraction=NAME or columns.joint_angle_rad=NAME"
            )
        own = muscles.set_index("muscle").loc[samples["muscle"]]
        per_rad = (own["sign"] * own["moment_arm_m"] / own["rest_length_m"]).to_numpy()
        angle = samples["joint_angle_rad"].to_numpy()
        samples = samples.assign(contraction=own["contraction_at_angle_0"].to_numpy() + per_rad * angle)
        notes.append(("contraction", "derived from joint_angle_rad by a constant moment arm"))
    if "contraction_velocity_per_s" not in samples:
        velocity = derive_velocity(samples, "contraction", ["trial", "muscle"], rate_hz, window)
        samples = samples.assign(contraction_velocity_per_s=velocity)
        notes.append(("contraction_velocity_per_s", "derived from contraction, filtered"))
    if "pressure_command_kpa" not in samples or samples["pressure_command_kpa"].isna().all():
        notes.append(("pressure_command_kpa", "missing: how pressure follows its command cannot be judged"))
    return samples.assign(**{name: np.nan for name in READINGS if name not in samples})


def derive_velocity(frame: pd.DataFrame, name: str, stream: list[str], rate_hz: float, window: VelocityFilter) -> Array:
    """Return the filtered derivative of a column, per s, in each unbroken stretch of each stream of a uniform clock.

    It is that of `differentiate`; a stretch shorter than the window has none.
    """
    values = frame[name].to_numpy(dtype=float)
    velocity = np.full(len(values), np.nan)
    shortest = window_length(rate_hz, window.window_s, window.order)
    number = frame.groupby(stream, sort=False).ngroup().to_numpy()
    for rows in np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1]):
        for present in np.ma.flatnotmasked_contiguous(np.ma.masked_invalid(values[rows])):
            stretch = rows[present]
            if len(stretch) >= shortest:
                velocity[stretch] = differentiate(values[stretch], rate_hz, window.window_s, window.order)
    return velocity
