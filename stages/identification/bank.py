"""Records natural movements under varied pressures: the bank that interactions are chosen from, and an unseen one.

In: the rig. Out: `bank`, with force, which only the evaluation may read, and `unseen_bank`, which nothing else reads.
Models come from movements of `bank`; an error on `unseen_bank` is one on movements of the same kind that nothing has
seen.
"""

from functools import partial
from typing import Any, ClassVar, Self

import pandas as pd
from pydantic import model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import RECORDING_COLUMNS, Rig
from stages.science.rig.excitation import FreeMovements, RigWithLimits
from stages.science.rig.trial import Proposal

BANK, UNSEEN_BANK = (
    Table(
        name,
        f"A sample of a muscle in a movement {which}",
        {"trajectory": column(int, f"movement of the {name.replace('_', ' ')}", low=0), **RECORDING_COLUMNS},
        key=("trajectory", "muscle", "time_s"),
    )
    for name, which in (("bank", "of the bank"), ("unseen_bank", "that nothing has seen"))
)


class BankFits(View):
    """The bank suits machine and memory, and every pressure level that may be drawn is one that may be commanded."""

    bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _fit(self) -> Self:
        self.bank.check_against(self.exoskeleton, "bank", self.rig.limits)
        return self


class UnseenBankFits(View):
    """The same of the unseen bank, and the two banks are two draws.

    The stage's name enters its generators too, so that equal seeds would not give equal movements; but who sets them
    equal expects that they do.
    """

    bank: dict[str, Any]
    unseen_bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _fit(self) -> Self:
        self.unseen_bank.check_against(self.exoskeleton, "unseen_bank", self.rig.limits)
        if self.unseen_bank.seed == self.bank["seed"]:
            raise ValueError(
                f"unseen_bank.seed: expected another seed than bank.seed, as its movements are to be new, "
                f"got {self.unseen_bank.seed} for both; set unseen_bank.seed={self.unseen_bank.seed + 1}"
            )
        return self


class Config(Section):
    """What `bank` reads."""

    checks: ClassVar = (BankFits,)

    bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: Target


class UnseenConfig(Section):
    """What `unseen_bank` reads."""

    checks: ClassVar = (UnseenBankFits,)

    unseen_bank: FreeMovements
    exoskeleton: Exoskeleton
    rig: Target


@stage(BANK, stream="bank", extent=("bank.trajectories",))
def bank(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record an experimenter's natural movements under varied pressures, with force."""
    return record_movements(BANK, cfg.bank, "for the bank", ctx)


@stage(UNSEEN_BANK, stream="unseen_bank", extent=("unseen_bank.trajectories",))
def unseen_bank(cfg: UnseenConfig, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record a second bank of natural movements, for the evaluation alone."""
    return record_movements(UNSEEN_BANK, cfg.unseen_bank, "for the evaluation alone", ctx)


def record_movements(table: Table, section: FreeMovements, purpose: str, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record every free movement of a bank, for a purpose that whoever attends is told; a part each."""
    with ctx.device as rig, ctx.progress("movements", section.trajectories) as advance:
        for trajectory in range(section.trajectories):
            make = partial(record_movement, table, section, purpose, ctx, rig, trajectory)
            until_kept(partial(ctx.record.part, (trajectory,), make))
            advance(f"movement {trajectory}")
    return ctx.record.collect()


def record_movement(
    table: Table, section: FreeMovements, purpose: str, ctx: Context, rig: Rig, trajectory: int
) -> dict[str, pd.DataFrame]:
    """Record one free movement; those of the bank have a number, by which a replay can find them."""
    watch, label = ctx.record.watch((trajectory,)), f"{table.name.replace('_', ' ')} {trajectory}"
    reason = f"{section.find_kind(trajectory).instruction} {purpose}"
    proposal, number = Proposal(trajectory + 1, section.trajectories, reason), trajectory if table is BANK else None
    columns = section.record(trajectory, rig, ctx.generator(trajectory), label, watch, number, proposal)
    return {table.name: pd.DataFrame(columns)}
