"""Records a second bank of free movements, which nothing but the evaluation ever reads.

In: the rig. Out: `unseen_bank`, with the columns of `bank`. Models come from movements of `bank`, so that an error on
it is one on movements that were there to choose from; an error here is one on movements of the same kind that nothing
has seen.
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

UNSEEN_BANK = Table(
    "unseen_bank",
    "A sample of a muscle in a movement that nothing has seen",
    {"trajectory": column(int, "movement of the unseen bank", low=0), **RECORDING_COLUMNS},
    key=("trajectory", "muscle", "time_s"),
)


class CommandsWithinLimits(View):
    """Every pressure level that may be drawn is one that the muscle may be commanded."""

    unseen_bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _keep_limits(self) -> Self:
        ranges = self.unseen_bank.pressure.range_kpa
        check_levels(ranges, self.exoskeleton, self.rig.limits, "unseen_bank.pressure.range_kpa")
        return self


class Seed(View):
    """A bank's own seed."""

    seed: int


class SeedsDiffer(View):
    """The two banks are two draws.

    The stage's name enters its generators too, so that equal seeds would not give equal movements; but who sets them
    equal expects that they do.
    """

    bank: Seed
    unseen_bank: Seed

    @model_validator(mode="after")
    def _draw_anew(self) -> Self:
        if self.unseen_bank.seed == self.bank.seed:
            raise ValueError(
                f"unseen_bank.seed: expected another seed than bank.seed, as its movements are to be new, "
                f"got {self.unseen_bank.seed} for both; set unseen_bank.seed={self.bank.seed + 1}"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (CommandsWithinLimits, SeedsDiffer)

    unseen_bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: Target

    @model_validator(mode="after")
    def _fit_machine(self) -> Self:
        self.unseen_bank.check_against(self.exoskeleton, "unseen_bank")
        return self


@stage(UNSEEN_BANK, stream="unseen_bank")
def unseen_bank(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record a second bank of natural movements, for the evaluation alone."""
    with ctx.rig as rig, ctx.progress("movements", cfg.unseen_bank.trajectories) as advance:
        for trajectory in range(cfg.unseen_bank.trajectories):
            make = partial(record_movement, cfg, ctx, rig, trajectory)
            until_kept(partial(ctx.record.part, (trajectory,), make))
            advance(f"movement {trajectory}")
    return ctx.record.collect()


def record_movement(cfg: Config, ctx: Context, rig: Rig, trajectory: int) -> dict[str, pd.DataFrame]:
    """Record one free movement."""
    watch, label = ctx.record.watch((trajectory,)), f"unseen bank {trajectory}"
    proposal = Proposal(trajectory + 1, cfg.unseen_bank.trajectories, "a natural movement for the evaluation alone")
    columns = cfg.unseen_bank.record(trajectory, rig, ctx.generator(trajectory), label, watch, proposal=proposal)
    return {UNSEEN_BANK.name: pd.DataFrame(columns)}
