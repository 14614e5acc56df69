"""From recorded samples back to a trial that replays them.

A movement's long table flows in; the `Trial` that displays its joint angles and plays its pressure commands flows out,
or what was measured when a rig executed it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from stages.science.rig.contract import Rig, Watch, tidy
from stages.science.rig.trial import Proposal, Trial
from stages.science.signals.trajectories import Array


def tracked_trial(
    samples: pd.DataFrame,
    rig: Rig,
    participant: str,
    label: str,
    number: int | None = None,
    proposal: Proposal | None = None,
) -> Trial:
    """Return the trial in which a participant tracks a recorded movement under its recorded pressures.

    Rows and errors are as of `arrange`, with the columns pressure_command_kpa and joint_angle_rad (of the muscle's
    joint).
    """
    command, angle = (arrange(samples, name, rig) for name in ("pressure_command_kpa", "joint_angle_rad"))
    first_muscle = [list(rig.muscle_joints).index(joint) for joint in rig.joints]
    return Trial("tracked", participant, command, angle[:, first_muscle], label, number, proposal)


def arrange(samples: pd.DataFrame, column: str, rig: Rig) -> Array:
    """Return a column of one movement's rows, told apart by time_s and muscle, by time and muscle of the rig (T, M).

    Raises
    ------
    ValueError
        When a muscle of the rig is not in the samples.
    """
    known = set(samples["muscle"].unique())
    missing = [name for name in rig.muscles if name not in known]
    if missing:
        raise ValueError(
            f"expected samples of every muscle of the rig ({', '.join(rig.muscles)}), got none of {missing}"
        )
    arranged: Array = samples.pivot(index="time_s", columns="muscle", values=column)[list(rig.muscles)].to_numpy()
    return arranged


def track(
    references: pd.DataFrame,
    trajectory: int,
    rig: Rig,
    participant: str,
    label: str,
    generator: np.random.Generator,
    watch: Watch | None = None,
    number: int | None = None,
    proposal: Proposal | None = None,
) -> pd.DataFrame:
    """Let a participant track a movement, and return what was measured, in the columns of `RECORDING_COLUMNS`.

    References are rows of all movements, with a column trajectory beside those that `tracked_trial` takes. Errors are
    as of it and of `Rig.execute`.
    """
    samples = references[references["trajectory"] == trajectory]
    trial = tracked_trial(samples, rig, participant, label, number, proposal)
    return pd.DataFrame(tidy(rig.execute(trial, generator, watch), rig))


def exchange_columns(
    movements: pd.DataFrame,
    trajectory: int,
    sources: Mapping[str, int],
    columns: Sequence[str] = ("pressure_command_kpa",),
) -> pd.DataFrame:
    """Return a movement's rows with some muscles' columns from other movements, sample by sample.

    Movements are as the references of `track`; `sources` names the movement by muscle, and a muscle that is not in it
    keeps its own.
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
