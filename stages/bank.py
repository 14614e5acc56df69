"""Records an experimenter's natural movements under varied pressures: the bank that interactions are chosen from.

In: the rig. Out: `bank`, with force, which only the evaluation may read.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt, model_validator

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.errors import suggest
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.plant import Exoskeleton
from stages.rig import MEASUREMENT_COLUMNS, Rig, Trial, tidy
from stages.signals import pressure_profiles

BANK = Table(
    "bank",
    "A sample of a muscle in a movement of the bank",
    {"trajectory": column(int, "movement of the bank", low=0), **MEASUREMENT_COLUMNS},
    key=("trajectory", "muscle", "time_s"),
)


class Range(Section):
    """Lowest and highest value."""

    low: NonNegativeFloat
    high: NonNegativeFloat

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"expected low <= high, got {self.low} and {self.high}")
        return self


class Pressure(Section):
    """How the robot's pressure commands vary while the experimenter moves."""

    range_kpa: dict[str, Range]
    hold_s: Range
    transition_s: Range
    step_share: Annotated[float, Field(ge=0, le=1)]


class Bank(Section):
    """Config group ``bank``."""

    seed: NonNegativeInt
    trajectories: PositiveInt
    pressure: Pressure


class Config(Section):
    """What this stage reads."""

    bank: Bank
    exoskeleton: Exoskeleton
    rig: Target

    @model_validator(mode="after")
    def _range_every_muscle(self) -> Self:
        missing = [name for name in self.exoskeleton.muscle_names if name not in self.bank.pressure.range_kpa]
        if missing:
            raise ValueError(
                f"bank.pressure.range_kpa: expected a range for every muscle, none for {', '.join(missing)}"
            )
        for name in self.bank.pressure.range_kpa:
            if name not in self.exoskeleton.muscle_names:
                hint = suggest(name, self.exoskeleton.muscle_names)
                raise ValueError(f"bank.pressure.range_kpa: no muscle '{name}'; {hint}")
        return self


@stage(BANK)
def bank(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record an experimenter's natural movements under varied pressures, with force."""
    with ctx.rig as rig, ctx.progress("movements", cfg.bank.trajectories) as advance:
        for trajectory in range(cfg.bank.trajectories):
            ctx.record.part((trajectory,), partial(record_movement, cfg, ctx, rig, trajectory))
            advance(f"movement {trajectory}")
    return ctx.record.collect()


def record_movement(cfg: Config, ctx: Context, rig: Rig, trajectory: int) -> dict[str, pd.DataFrame]:
    """Record one free movement."""
    generator = ctx.generator(trajectory)
    trial = Trial("free", "experimenter", draw_pressures(cfg.bank.pressure, rig, generator), label=f"bank {trajectory}")
    recording = rig.execute(trial, generator)
    return {BANK.name: pd.DataFrame({"trajectory": trajectory, **tidy(recording, rig)})}


def draw_pressures(pressure: Pressure, rig: Rig, generator: np.random.Generator) -> NDArray[np.float64]:
    """Draw each muscle's pressure command (T, M), kPa."""
    ranges = [pressure.range_kpa[name] for name in rig.muscles]
    return pressure_profiles(
        generator,
        [each.low for each in ranges],
        [each.high for each in ranges],
        rig.samples,
        rig.sampling_rate_hz,
        hold_s=(pressure.hold_s.low, pressure.hold_s.high),
        transition_s=(pressure.transition_s.low, pressure.transition_s.high),
        step_share=pressure.step_share,
    )
