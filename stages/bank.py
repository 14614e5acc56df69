"""Records an experimenter's natural movements under varied pressures: the bank that interactions are chosen from.

In: the rig. Out: `bank`, with force, which only the evaluation may read.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, ClassVar, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt, model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.errors import suggest
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.plant import Exoskeleton
from stages.rig import MEASUREMENT_COLUMNS, MOST_ROWS, Rig, Trial, tidy
from stages.rig.limits import Limits
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


class Durations(Range):
    """Shortest and longest duration, s; no longer than a trial may be, an hour."""

    high: Annotated[float, Field(ge=0, le=3600)]


class Pressure(Section):
    """How the robot's pressure commands vary while the experimenter moves."""

    range_kpa: dict[str, Range]
    hold_s: Durations
    transition_s: Durations
    step_share: Annotated[float, Field(ge=0, le=1)]

    @property
    def mean_level_s(self) -> float:
        """Mean time from one level to the next, s; steps take none."""
        transition_s = (1 - self.step_share) * (self.transition_s.low + self.transition_s.high) / 2
        return (self.hold_s.low + self.hold_s.high) / 2 + transition_s


class Bank(Section):
    """Config group ``bank``."""

    seed: NonNegativeInt
    trajectories: PositiveInt
    pressure: Pressure


class RigWithLimits(View):
    """The rig's limits on commands, where it has them."""

    limits: Limits | None = None


class CommandsWithinLimits(View):
    """Every pressure level that may be drawn is one that the muscle may be commanded.

    A rig applies the nearest command that it permits, so that levels beyond its limits would all be one level.
    """

    bank: Bank
    exoskeleton: Exoskeleton
    rig: RigWithLimits

    @model_validator(mode="after")
    def _keep_limits(self) -> Self:
        for muscle in self.exoskeleton.muscles:
            limit = (self.rig.limits or {}).get(muscle.type)
            low, high = (limit.low_kpa, limit.high_kpa) if limit else (0.0, muscle.max_pressure_kpa)
            levels = self.bank.pressure.range_kpa[muscle.name]
            source = f"rig.limits.{muscle.type}" if limit else f"max_pressure_kpa of {muscle.name}"
            path = f"bank.pressure.range_kpa.{muscle.name}"
            if levels.low < low:
                raise ValueError(
                    f"{path}.low: expected at least the {low} kPa of {source}.low_kpa, got {levels.low}; raise it"
                )
            if levels.high > high:
                source = f"{source}.high_kpa" if limit else source
                raise ValueError(
                    f"{path}.high: expected at most the {high} kPa of {source}, got {levels.high}; lower it"
                )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (CommandsWithinLimits,)

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
        for name, levels in self.bank.pressure.range_kpa.items():
            if levels.high == 0:
                raise ValueError(
                    f"bank.pressure.range_kpa.{name}.high: expected more than 0, as a vented muscle does not pull, "
                    "got 0; raise it"
                )
        return self

    @model_validator(mode="after")
    def _sample_every_level(self) -> Self:
        sample_s, level_s = 1 / self.exoskeleton.sampling_rate_hz, self.bank.pressure.mean_level_s
        if level_s < sample_s:
            raise ValueError(
                f"bank.pressure.hold_s: expected levels that, with transition_s, last a sample ({sample_s:.3g} s) on "
                f"average, got {level_s:.3g} s; raise bank.pressure.hold_s.high or bank.pressure.transition_s.high"
            )
        return self

    @model_validator(mode="after")
    def _fit_memory(self) -> Self:
        most = MOST_ROWS // (self.exoskeleton.samples * len(self.exoskeleton.muscles))
        if self.bank.trajectories > most:
            raise ValueError(
                f"bank.trajectories: expected at most {most} movements of {self.exoskeleton.samples} samples and "
                f"{len(self.exoskeleton.muscles)} muscles, as {MOST_ROWS} rows still fit in memory, "
                f"got {self.bank.trajectories}; lower it, exoskeleton.trial_s or exoskeleton.sampling_rate_hz"
            )
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
