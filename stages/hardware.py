"""Executes a given list of trials on the rig; here those that give each experiment its initial data.

In: `initial_trials`, `references`. Out: `hardware_recordings`, one part per trial.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import pandas as pd

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.rig import MEASUREMENT_COLUMNS, Rig, tidy, tracked_trial

HARDWARE_RECORDINGS = Table(
    "hardware_recordings",
    "A sample of a muscle in an executed trial",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "position": column(int, "order of execution", low=1),
        "trajectory": column(int, "movement of the bank that was tracked", low=0),
        **MEASUREMENT_COLUMNS,
    },
    key=("participant", "experiment", "position", "muscle", "time_s"),
)


class Config(Section):
    """What this stage reads."""

    rig: Target
    seed: int


@stage(HARDWARE_RECORDINGS)
def hardware(
    cfg: Config, initial_trials: pd.DataFrame, references: pd.DataFrame, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Execute each experiment's initial trials."""
    with ctx.rig as rig, ctx.progress("trials", len(initial_trials)) as advance:
        for row in rows_of(initial_trials):
            key = (row["participant"], row["experiment"], row["position"])
            ctx.record.part(key, partial(execute, row, references, rig, ctx.generator(*key)))
            advance(f"{row['participant']} experiment {row['experiment']}")
    return ctx.record.collect()


def execute(row: dict[str, Any], references: pd.DataFrame, rig: Rig, generator: Any) -> dict[str, pd.DataFrame]:
    """Execute one row of the list."""
    samples = references[references["trajectory"] == row["trajectory"]]
    label = f"{row['participant']} experiment {row['experiment']} initial {row['position']}"
    recording = rig.execute(tracked_trial(samples, rig, row["participant"], label), generator)
    frame = pd.DataFrame(tidy(recording, rig)).assign(**row)
    return {HARDWARE_RECORDINGS.name: frame[list(HARDWARE_RECORDINGS.columns)]}


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a frame's rows as plain mappings."""
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]
