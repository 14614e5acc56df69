"""Records an experimenter's natural movements under varied pressures: the bank that interactions are chosen from.

In: the rig. Out: `bank`, with force, which only the evaluation may read.
"""

from __future__ import annotations

from functools import partial
from typing import ClassVar, Self

import pandas as pd
from pydantic import model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import RECORDING_COLUMNS, Rig
from stages.science.rig.excitation import FreeMovements, RigWithLimits, check_levels
from stages.science.rig.trial import Proposal

BANK = Table(
    "bank",
    "A sample of a muscle in a movement of the bank",
    {"trajectory": column(int, "movement of the bank", low=0), **RECORDING_COLUMNS},
    key=("trajectory", "muscle", "time_s"),
)


class CommandsWithinLimits(View):
    """Every pressure level that may be drawn is one that the muscle may be commanded."""

    bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _keep_limits(self) -> Self:
        ranges = self.bank.pressure.range_kpa
        check_levels(ranges, self.exoskeleton, self.rig.limits, "bank.pressure.range_kpa")
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (CommandsWithinLimits,)

    bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: Target

    @model_validator(mode="after")
    def _fit_machine(self) -> Self:
        self.bank.check_against(self.exoskeleton, "bank")
        return self


@stage(BANK, stream="bank")
def bank(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record an experimenter's natural movements under varied pressures, with force."""
    with ctx.rig as rig, ctx.progress("movements", cfg.bank.trajectories) as advance:
        for trajectory in range(cfg.bank.trajectories):
            make = partial(record_movement, cfg, ctx, rig, trajectory)
            until_kept(partial(ctx.record.part, (trajectory,), make))
            advance(f"movement {trajectory}")
    return ctx.record.collect()


def record_movement(cfg: Config, ctx: Context, rig: Rig, trajectory: int) -> dict[str, pd.DataFrame]:
    """Record one free movement."""
    watch = ctx.record.watch((trajectory,))
    proposal = Proposal(trajectory + 1, cfg.bank.trajectories, "a natural movement for the bank")
    columns = cfg.bank.record(
        trajectory, rig, ctx.generator(trajectory), f"bank {trajectory}", watch, trajectory, proposal
    )
    return {BANK.name: pd.DataFrame(columns)}
