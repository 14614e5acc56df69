"""From long rows back to what they were made of: a recording, and a trial that replays a movement.

Rows of one trial flow in, one for each muscle and time, and the `Recording` that `tidy` made them of flows out; or a
movement's rows, and the `Trial` that displays its joint angles and plays its pressure commands, or what was measured
when a rig executed it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.rig.contract import RECORDING_COLUMNS, Rig, Watch, tidy
from stages.science.rig.trial import PER_SAMPLE, Proposal, Recording, Trial
from stages.science.signals.trajectories import Array

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

    A `ValueError` names the column, what was expected of it, and the first value that is otherwise.
    """
    import pandera.pandas as pa  # slow to import, and most rigs read no rows

    columns = {}
    for name, each in RECORDING_COLUMNS.items():
        limits = ((pa.Check.ge, each["low"]), (pa.Check.le, each["high"]), (pa.Check.isin, each["among"]))
        checks = [check(limit) for check, limit in limits if limit is not None]
        columns[name] = pa.Column(each["dtype"], checks, nullable=each["nullable"])
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


def replayed_trial(
    samples: pd.DataFrame,
    rig: Rig,
    participant: str,
    label: str,
    number: int | None = None,
    proposal: Proposal | None = None,
) -> Trial:
    """Return the trial in which a participant tracks a recorded movement under its recorded pressures.

    Rows and errors are as of `arrange`, with the columns pressure_command_kpa and joint_angle_rad (of the muscle's
    joint). With ``nobody`` in the machine the robot plays the pressures alone, and no angles are needed.
    """
    command = arrange(samples, "pressure_command_kpa", rig)
    if participant == "nobody":
        return Trial("passive", participant, command, None, label, number, proposal)
    first_muscle = [list(rig.muscle_joints).index(joint) for joint in rig.joints]
    angle = arrange(samples, "joint_angle_rad", rig)[:, first_muscle]
    return Trial("tracked", participant, command, angle, label, number, proposal)


def arrange(samples: pd.DataFrame, column: str, rig: Rig) -> Array:
    """Return a column of one movement's rows, told apart by time_s and muscle, by time and muscle of the rig (T, M).

    A `ValueError` tells that a muscle of the rig is not in the samples.
    """
    known = set(samples["muscle"].unique())
    missing = [name for name in rig.muscles if name not in known]
    if missing:
        raise ValueError(
            f"expected samples of every muscle of the rig ({', '.join(rig.muscles)}), got none of {missing}"
        )
    return np.asarray(samples.pivot(index="time_s", columns="muscle", values=column)[list(rig.muscles)])


def track(
    samples: pd.DataFrame,
    rig: Rig,
    participant: str,
    label: str,
    generator: np.random.Generator,
    watch: Watch | None = None,
    number: int | None = None,
    proposal: Proposal | None = None,
) -> pd.DataFrame:
    """Execute a trial of `replayed_trial`, and return what was measured, in the columns of `RECORDING_COLUMNS`.

    Errors are as of it and of `Rig.execute`.
    """
    trial = replayed_trial(samples, rig, participant, label, number, proposal)
    return pd.DataFrame(tidy(rig.execute(trial, generator, watch), rig))


def exchange_columns(
    movements: pd.DataFrame,
    trajectory: int,
    sources: Mapping[str, int],
    columns: Sequence[str] = ("pressure_command_kpa",),
) -> pd.DataFrame:
    """Return a movement's rows with some muscles' columns from other movements, sample by sample.

    Movements have a column trajectory beside those of `replayed_trial`; `sources` names the movement by muscle, and a
    muscle that is not in it keeps its own.
    """
    rows = movements[movements["trajectory"] == trajectory].copy()
    for muscle, source in sources.items():
        its = movements[(movements["trajectory"] == source) & (movements["muscle"] == muscle)]
        rows.loc[rows["muscle"] == muscle, list(columns)] = its[list(columns)].to_numpy()
    return rows


def describe_sources(sources: Mapping[str, int]) -> str:
    """Return the movements that muscles' pressures are taken from, as ``pam1 3, pam2 17``."""
    return ", ".join(f"{muscle} {source}" for muscle, source in sources.items())


def read_sources(described: str) -> dict[str, int]:
    """Return the movements by muscle that `describe_sources` wrote."""
    pairs = [each.rsplit(" ", 1) for each in described.split(", ") if each]
    return {muscle: int(source) for muscle, source in pairs}
