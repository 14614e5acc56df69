"""What the models are wanted for: the inputs over which the interaction design is to make them sure.

In: `candidates`, and the rig where the task is movements that are not in the bank. Out: `task` (inputs, without force)
and `task_movements` (recordings, with force, which only the evaluation may read; empty where the task is the bank).
"""

from functools import partial
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.errors import ConfigError, suggest
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.muscle_models.inputs import ModelSettings, describe_features
from stages.science.muscle_models.samples import place_evenly
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import MEASUREMENT_COLUMNS, RECORDING_COLUMNS, Rig
from stages.science.rig.excitation import FreeMovements, RigWithLimits
from stages.science.rig.limits import ordered
from stages.science.rig.trial import Proposal
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import MODEL_INPUTS

TASK = Table(
    "task",
    "A sample of a muscle that its model is wanted for, without force",
    {
        "sample": column(int, "of this muscle, from 0", low=0),
        "muscle": MEASUREMENT_COLUMNS["muscle"],
        **{name: MEASUREMENT_COLUMNS[name] for name in MODEL_INPUTS},
        **describe_features(),
    },
    key=("muscle", "sample"),
)
TASK_MOVEMENTS = Table(
    "task_movements",
    "A sample of a muscle in a movement that the models are wanted for",
    {
        "trajectory": column(int, "movement of the task", low=0),
        "wanted": column(bool, "whether the sample lies within the bounds of the task's region"),
        **RECORDING_COLUMNS,
    },
    key=("trajectory", "muscle", "time_s"),
)


class Interval(Section):
    """Lowest and highest value of an input."""

    low: float
    high: float

    _order = ordered("low", "high", strictly=False)


class Task(FreeMovements):
    """Config group ``task``: what the models are wanted for, and the movements that are recorded for it, if any."""

    of: Literal["bank", "movements"]
    samples: Annotated[int, Field(ge=1, le=5000)]
    region: dict[str, dict[str, Interval]]


class TaskFits(View):
    """The task's movements suit machine, limits and memory, and its region bounds inputs of muscles' models."""

    task: Task
    model: ModelSettings
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _fit(self) -> Self:
        self.task.check_against(self.exoskeleton, "task", self.rig.limits)
        muscles, inputs = self.exoskeleton.muscle_names, [each.column for each in self.model.features]
        for muscle, bounds in self.task.region.items():
            if muscle not in muscles:
                raise ValueError(f"task.region: no muscle '{muscle}'; {suggest(muscle, muscles)}")
            for name in bounds:
                if name not in inputs:
                    raise ValueError(f"task.region.{muscle}: the model has no input '{name}'; {suggest(name, inputs)}")
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (TaskFits,)

    task: Task
    model: ModelSettings
    exoskeleton: Exoskeleton
    rig: Target


@stage(TASK, TASK_MOVEMENTS, stream="task", extent=("task.trajectories",))
def task(cfg: Config, candidates: pd.DataFrame, ctx: Context) -> dict[str, pd.DataFrame]:
    """Gather the inputs that models are wanted for, from the bank or from movements recorded for it."""
    recordings = record_task(cfg, ctx) if cfg.task.of == "movements" else None
    known = candidates if recordings is None else leave_out_lead_in(cfg.model.extend(recordings, ["trajectory"]))
    return {
        TASK.name: select_samples(known, cfg.task),
        TASK_MOVEMENTS.name: pd.DataFrame(columns=list(TASK_MOVEMENTS.columns)) if recordings is None else recordings,
    }


def record_task(cfg: Config, ctx: Context) -> pd.DataFrame:
    """Record the movements that models are wanted for, a part each."""
    section = cfg.task
    with ctx.device as rig, ctx.progress("movements", section.trajectories) as advance:
        for trajectory in range(section.trajectories):
            until_kept(partial(ctx.record.part, (trajectory,), partial(record_movement, cfg, trajectory, rig, ctx)))
            advance(f"task {trajectory}")
    return ctx.record.collect()[TASK_MOVEMENTS.name]


def record_movement(cfg: Config, trajectory: int, rig: Rig, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record one movement of the task."""
    section = cfg.task
    reason = f"{section.find_kind(trajectory).instruction}, as the models are wanted for"
    proposal = Proposal(trajectory + 1, section.trajectories, reason)
    watch, label = ctx.record.watch((trajectory,)), f"task {trajectory}"
    columns = section.record(trajectory, rig, ctx.generator(trajectory), label, watch, None, proposal)
    recorded = pd.DataFrame(columns)
    wanted = mark_wanted(cfg.model.extend(recorded, ["trajectory"]), section)
    return {TASK_MOVEMENTS.name: recorded.assign(wanted=wanted)[list(TASK_MOVEMENTS.columns)]}


def mark_wanted(known: pd.DataFrame, section: Task) -> NDArray[np.bool_]:
    """Return which samples lie within the bounds of the task's region."""
    wanted = np.ones(len(known), dtype=bool)
    for muscle, bounds in section.region.items():
        for name, each in bounds.items():
            wanted &= ((known["muscle"] != muscle) | known[name].between(each.low, each.high)).to_numpy()
    return wanted


def select_samples(known: pd.DataFrame, section: Task) -> pd.DataFrame:
    """Return so many samples of each muscle, evenly spread over those within its region; refuse one without samples."""
    frames, wanted = [], mark_wanted(known, section)
    for muscle, rows in known.groupby("muscle", sort=False):
        within = known[wanted & (known["muscle"] == muscle).to_numpy()]
        if within.empty:
            ranges = [
                f"{name} {rows[name].min():.3g} to {rows[name].max():.3g}" for name in section.region[str(muscle)]
            ]
            raise ConfigError(
                f"task.region.{muscle}: expected bounds that hold a sample of the task, which has "
                f"{', '.join(ranges)}, got none of "
                f"{len(rows)}; change them"
            )
        chosen = within.iloc[place_evenly(min(section.samples, len(within)), len(within))]
        frames.append(chosen.assign(sample=range(len(chosen))))
    return TASK.select(pd.concat(frames, ignore_index=True))
