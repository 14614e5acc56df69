"""Which way to bend a movement of the bank so that its execution tells more, by what models would see of it.

A movement as it is commanded and as the bank recorded it flows in, and what samples of a muscle tell; the changes of
its reference and pressure commands flow out. A joint's muscles are told by its angle and their own pressures alone, so
that each joint is bent by itself. Force plays no part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stages.science.muscle_models.inputs import FEATURE_COLUMNS, ModelSettings
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.bending import Bending, round_coefficients
from stages.science.signals.scaling import MODEL_INPUTS, Scaling
from stages.science.signals.trajectories import Array

PRESSURE, CONTRACTION, VELOCITY = MODEL_INPUTS
FIRST_STEP = 0.2
"""First steps of the search over the bank's range, 1; Rechenberg's rule adapts them."""
GROWTH = 1.5
"""By which a step grows where a change tells more; it shrinks by the fourth root where not: one in five is to tell more
(Rechenberg, Evolutionsstrategie, 1973)."""

Weigh = Callable[[int, Array], float]
"""What a muscle's model, by its place, would learn from a movement's standardised inputs (n, D)."""


@dataclass(frozen=True)
class Movement:
    """A muscle in a movement of the bank: its command (T,), kPa, and what was recorded of every so-many-th sample.

    These are the n samples' measured signals and features by column, each in its unit, and `step_s` apart.
    """

    contraction_per_rad: float
    command_kpa: Array
    recorded: Mapping[str, Array]
    every: int
    step_s: float
    scaling: Scaling
    model: ModelSettings

    def foresee(self, change_rad: Array, command_kpa: Array) -> Array:
        """Return standardised inputs (n, D) with the reference changed (T,), rad, under another command (T,), kPa.

        Joint and pressure are taken to follow what is changed at once.
        """
        old, contracted = self.recorded, self.contraction_per_rad * change_rad[:: self.every]
        new = {
            PRESSURE: old[PRESSURE] + (command_kpa - self.command_kpa)[:: self.every],
            CONTRACTION: old[CONTRACTION] + contracted,
            VELOCITY: old[VELOCITY] + np.gradient(contracted, self.step_s),
        }
        new |= {name: old[name] + each - self._followed[name] for name, each in self._follow(new).items()}
        restored = np.stack([new[name] for name in self.scaling.inputs], axis=1)
        return (restored - self.scaling.input_centre) / self.scaling.input_scale

    @cached_property
    def _followed(self) -> dict[str, Array]:
        return self._follow(self.recorded)

    def _follow(self, signals: Mapping[str, Array]) -> dict[str, Array]:
        """Return the features of the past that signals make."""
        asked = [(each.column, each.follow) for each in self.model.features if each.follow is not None]
        return {name: follow(signals, self.step_s, self.model.constants) for name, follow in asked}


@dataclass
class _Part:
    """A joint's angle, rad, or a muscle's pressure, kPa: its change (K,), and how far the search steps from it."""

    change: Array
    step: float

    def draw(self, generator: np.random.Generator) -> Array:
        return round_coefficients(self.change + self.step * generator.standard_normal(self.change.size))

    def judge(self, better: bool) -> None:
        self.step *= GROWTH if better else GROWTH**-0.25


@dataclass(frozen=True)
class Search:
    """A (1+1) evolution strategy for each joint: its reference and its muscles' pressures are changed in turn.

    Each muscle's pressure is changed by itself. Of two changes that tell the same the first one is kept.
    """

    bending: Bending
    contraction_per_rad: Mapping[str, float]
    muscles: MuscleSet
    model: ModelSettings
    weigh: Weigh

    def run(
        self,
        rows: pd.DataFrame,
        recorded: pd.DataFrame,
        coefficients: int,
        evaluations: int,
        generator: np.random.Generator,
    ) -> tuple[dict[str, Array], float]:
        """Return the changes of a movement, and the utility that they add.

        Parameters
        ----------
        rows : DataFrame
            References and commands of the movement: muscle, time_s, pressure_command_kpa, joint_angle_rad.
        recorded : DataFrame
            What the bank recorded of every so-many-th of these samples: muscle, time_s, `MODEL_INPUTS` and features.
        coefficients, evaluations : int
            Of each joint and muscle, at least four; bent movements that are scored.
        generator : Generator
            Draws what is tried.
        """
        changes: dict[str, Array] = {}
        gained = 0.0
        for joint in dict.fromkeys(self.bending.joints.values()):
            names = [name for name, its in self.bending.joints.items() if its == joint]
            moved = {name: self._gather(name, rows, recorded) for name in names}
            angle = rows.loc[rows["muscle"] == names[0], "joint_angle_rad"].to_numpy()
            its, more = self._bend_joint(joint, angle, moved, coefficients, evaluations, generator)
            changes |= its
            gained += more
        return changes, gained

    def _gather(self, muscle: str, rows: pd.DataFrame, recorded: pd.DataFrame) -> Movement:
        own, its = (each[each["muscle"] == muscle] for each in (rows, recorded))
        every = int(np.searchsorted(own["time_s"], its["time_s"].iloc[1]))
        step_s = float(its["time_s"].iloc[1] - its["time_s"].iloc[0])
        signals = {name: its[name].to_numpy() for name in (*MODEL_INPUTS, *FEATURE_COLUMNS) if name in its}
        scaling = self.muscles.scalings[self.muscles.names.index(muscle)]
        per_rad, command = self.contraction_per_rad[muscle], own["pressure_command_kpa"].to_numpy()
        return Movement(per_rad, command, signals, every, step_s, scaling, self.model)

    def _bend_joint(
        self,
        joint: str,
        angle_rad: Array,
        moved: Mapping[str, Movement],
        coefficients: int,
        evaluations: int,
        generator: np.random.Generator,
    ) -> tuple[dict[str, Array], float]:
        def begin(name: str) -> _Part:
            return _Part(np.zeros(coefficients), FIRST_STEP * self.bending.bounds[name].span)

        def score(name: str, angle: Array, command_kpa: Array) -> float:
            return self.weigh(self.muscles.names.index(name), moved[name].foresee(angle - angle_rad, command_kpa))

        reference, pressures = begin(joint), {name: begin(name) for name in moved}
        kept, commands = angle_rad, {name: each.command_kpa for name, each in moved.items()}
        told = {name: score(name, kept, commands[name]) for name in moved}
        begun = sum(told.values())
        for turn in range(1, evaluations):
            if turn % 2:
                change = reference.draw(generator)
                bent = self.bending.bend_angle(joint, angle_rad, change)
                its = {name: score(name, bent, commands[name]) for name in moved}
                better = sum(its.values()) > sum(told.values())
                reference.judge(better)
                if better:
                    reference.change, kept, told = change, bent, its
                continue
            for name, part in pressures.items():
                change = part.draw(generator)
                command = self.bending.bend_command(name, moved[name].command_kpa, change)
                more = score(name, kept, command)
                part.judge(more > told[name])
                if more > told[name]:
                    part.change, told[name], commands[name] = change, more, command
        changes = {joint: reference.change} | {name: each.change for name, each in pressures.items()}
        return {name: each for name, each in changes.items() if each.any()}, sum(told.values()) - begun
