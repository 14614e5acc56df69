"""Which way to bend a movement of the bank so that its execution tells more, by what models would see of it.

A movement as it is commanded and as the bank recorded it flows in, and what samples of a muscle tell; the changes of
its reference and pressure commands flow out. A joint's muscles are told by its angle and their own pressures alone, so
that each joint is bent by itself. Force plays no part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stages.science.muscle_models.inputs import ModelSettings
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
    """A muscle in a movement of the bank: its command (T,), kPa, and standardised inputs (n, D) as recorded.

    The inputs are of each so-many-th sample, and samples are `step_s` apart; the model says what they are.
    """

    contraction_per_rad: float
    command_kpa: Array
    scaling: Scaling
    recorded: Array
    step_s: float
    model: ModelSettings

    def foresee(self, change_rad: Array, command_kpa: Array) -> Array:
        """Return the inputs (n, D) with the joint's reference changed (T,), rad, under another command (T,), kPa.

        Joint and pressure are taken to follow what is changed at once.
        """
        old, contracted = self._own, self.contraction_per_rad * change_rad[:: self._every]
        new = old | {
            PRESSURE: old[PRESSURE] + (command_kpa - self.command_kpa)[:: self._every],
            CONTRACTION: old[CONTRACTION] + contracted,
            VELOCITY: old[VELOCITY] + np.gradient(contracted, self._step_s),
        }
        new |= {name: old[name] + each - self._followed[name] for name, each in self._follow(new).items()}
        restored = np.stack([new[name] for name in self.scaling.inputs], axis=1)
        return (restored - self.scaling.input_centre) / self.scaling.input_scale

    @property
    def _every(self) -> int:
        return -(-len(self.command_kpa) // len(self.recorded))

    @property
    def _step_s(self) -> float:
        return self._every * self.step_s

    @cached_property
    def _own(self) -> dict[str, Array]:
        return dict(zip(self.scaling.inputs, self.scaling.restore_inputs(self.recorded).T, strict=True))

    @cached_property
    def _followed(self) -> dict[str, Array]:
        return self._follow(self._own)

    def _follow(self, signals: Mapping[str, Array]) -> dict[str, Array]:
        asked = [(each.column, each.follow) for each in self.model.features if each.follow is not None]
        return {name: follow(signals, self._step_s, self.model.constants) for name, follow in asked}


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
    sampling_rate_hz: float
    muscles: MuscleSet
    model: ModelSettings
    weigh: Weigh

    def run(
        self,
        rows: pd.DataFrame,
        recorded: Sequence[Array],
        coefficients: int,
        evaluations: int,
        generator: np.random.Generator,
    ) -> tuple[dict[str, Array], float]:
        """Return the changes of a movement, and the utility that they add.

        Parameters
        ----------
        rows : DataFrame
            References and commands of the movement, as of `track`.
        recorded : sequence over M muscles of (n, D) float arrays
            Standardised inputs of every so-many-th sample, as the bank recorded them.
        coefficients, evaluations : int
            Of each joint and muscle, at least four; bent movements that are scored.
        generator : Generator
            Draws what is tried.
        """
        changes: dict[str, Array] = {}
        gained = 0.0
        for joint in dict.fromkeys(self.bending.joints.values()):
            names = [name for name, its in self.bending.joints.items() if its == joint]
            moved = {
                name: Movement(
                    self.contraction_per_rad[name],
                    rows.loc[rows["muscle"] == name, "pressure_command_kpa"].to_numpy(),
                    self.muscles.scalings[place],
                    recorded[place],
                    1.0 / self.sampling_rate_hz,
                    self.model,
                )
                for name, place in zip(names, map(self.muscles.names.index, names), strict=True)
            }
            angle = rows.loc[rows["muscle"] == names[0], "joint_angle_rad"].to_numpy()
            its, more = self._bend_joint(joint, angle, moved, coefficients, evaluations, generator)
            changes |= its
            gained += more
        return changes, gained

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

        def score(name: str, angle: Array, command: Array) -> float:
            return self.weigh(self.muscles.names.index(name), moved[name].foresee(angle - angle_rad, command))

        reference, pressures = begin(joint), {name: begin(name) for name in moved}
        bent_rad, commands = angle_rad, {name: each.command_kpa for name, each in moved.items()}
        told = {name: score(name, bent_rad, command) for name, command in commands.items()}
        begun = sum(told.values())
        for turn in range(1, evaluations):
            if turn % 2:
                change = reference.draw(generator)
                angle = self.bending.bend_angle(joint, angle_rad, change)
                its = {name: score(name, angle, command) for name, command in commands.items()}
                better = sum(its.values()) > sum(told.values())
                reference.judge(better)
                if better:
                    reference.change, bent_rad, told = change, angle, its
                continue
            for name, part in pressures.items():
                change = part.draw(generator)
                command = self.bending.bend_command(name, moved[name].command_kpa, change)
                more = score(name, bent_rad, command)
                part.judge(more > told[name])
                if more > told[name]:
                    part.change, told[name], commands[name] = change, more, command
        changes = {joint: reference.change} | {name: each.change for name, each in pressures.items()}
        return {name: each for name, each in changes.items() if each.any()}, sum(told.values()) - begun
