"""The one channel of an oscillator: its motion under a measured input, cut into blocks that serve as trials.

Signals of records and the list of their blocks flow in; a cell flows out. Before every block stands a lead-in: it is
simulated, from rest, and not judged, so that blocks can be taken in any order and choice. A record's own beginning has
no lead-in; there the first samples of the block are not judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.discrepancy.cell import Cell, Driver, Form
from stages.discrepancy.fitting import Model, begin, fit
from stages.discrepancy.noise import Noise
from stages.discrepancy.records import bridge, list_blocks, spread_records
from stages.plant.effect import DynamicEffect, Parameter, list_effects, list_forms
from stages.plant.oscillator import SITE, Oscillator
from stages.plant.second_order import collect_terms, refine, simulate_oscillator
from stages.signals.trajectories import Array


@dataclass(frozen=True)
class OscillatorCell(Cell):
    """Blocks of an oscillator's records.

    Parameters
    ----------
    plant : Oscillator
        Constants with their tolerances; effects that it lists already act.
    step_s : float
        Time between samples, s.
    fine_input : ((L + T - 1) * 2 * substeps + 1, K) ndarray
        Input of L samples of lead-in and T of the block, refined.
    measured : (T, K) ndarray
        Output, gaps bridged.
    present : (T, K) ndarray of bool
        Where the output was measured, and the input throughout a lead-in before.
    start_s : (K,) ndarray
        Start of each block, s.
    """

    plant: Oscillator
    step_s: float
    fine_input: Array
    measured: Array
    present: NDArray[np.bool_]
    start_s: Array
    element: str = SITE

    @property
    def channel(self) -> str:  # type: ignore[override]
        """The output's name, which ends in its unit."""
        return self.plant.output

    @property
    def unit(self) -> str:  # type: ignore[override]
        """The output's unit."""
        return self.plant.constants.output_offset.unit

    @property
    def pace_s(self) -> float:
        """Two natural periods, s, to begin with."""
        return 2.0 / self.plant.constants.natural_frequency_hz.start

    @property
    def constants(self) -> tuple[Parameter, ...]:
        """Gain, natural frequency, damping and offsets."""
        return self.plant.parameters

    @property
    def forms(self) -> tuple[Form, ...]:
        """Effects at an oscillator that its plant does not list yet."""
        effects = [effect for name in list_effects() for effect in list_forms(name)]
        taken = {entry.name for entry in self.plant.effects}
        return tuple(
            Form(each.name, each.form, each.site, each.parameters, each)
            for each in effects
            if isinstance(each, DynamicEffect) and each.site == SITE and each.name not in taken
        )

    def simulate(self, constants: Mapping[str, float], effects: Sequence[tuple[Form, Mapping[str, float]]]) -> Array:
        """Return the output of the blocks, (T, K)."""
        return self._move(constants, effects)[-len(self.measured) :]

    def _move(self, constants: Mapping[str, float], effects: Sequence[tuple[Form, Mapping[str, float]]]) -> Array:
        listed = [(entry.effect, entry.parameters) for entry in self.plant.effects]
        more = [(form.effect, values) for form, values in effects if isinstance(form.effect, DynamicEffect)]
        terms = collect_terms([*listed, *more])
        plant = self.plant
        return simulate_oscillator(self.fine_input, plant.collect(constants), terms, self.step_s, plant.substeps)

    @cached_property
    def _linear(self) -> dict[str, float]:
        """Constants of the linear model, fitted as if the residual were white."""
        plain = Noise(max(0.01 * self.range, 1e-9), 1e-12, 0.03, 1e-12, 1.0)
        model = Model(self)
        return model.name_values(fit(model, plain, begin(model)).values)[0]

    def drivers(self) -> list[Driver]:
        """Return the motion that the input brings by the linear model, its velocity, and the input.

        The measured motion would carry the noise that is to be told from what a model can explain.
        """
        motion = self._move(self._linear, [])
        velocity = np.gradient(motion, self.step_s, axis=0)
        samples = len(self.measured)
        signal = self.fine_input[:: 2 * self.plant.substeps][-samples:]
        return [
            Driver("motion", motion[-samples:]),
            Driver("velocity", velocity[-samples:], rate=True),
            Driver(self.plant.input, signal),
        ]

    def respond(self, features: Array) -> Array:
        """Return features both as they are and as the linear oscillator answers to them, (T, K, 2 F)."""
        from scipy.signal import lfilter

        constants = self._linear
        angle = 2.0 * np.pi * constants["natural_frequency_hz"] * self.step_s
        ratio = min(constants["damping_ratio"], 0.99)
        decay = np.exp(-ratio * angle)
        recursion = [1.0, -2.0 * decay * np.cos(angle * np.sqrt(1.0 - ratio**2)), decay**2]
        answer = lfilter([0.0, 1.0], recursion, features, axis=0)
        return np.concatenate([features, answer / np.maximum(answer.std(axis=(0, 1)), 1e-300)], axis=2)

    def take(self, trials: Sequence[int]) -> Self:
        """Return the cell with some of its blocks, by position."""
        chosen = list(trials)
        return replace(
            self,
            fine_input=np.ascontiguousarray(self.fine_input[:, chosen]),
            measured=np.ascontiguousarray(self.measured[:, chosen]),
            present=np.ascontiguousarray(self.present[:, chosen]),
            start_s=self.start_s[chosen],
        )


def build_oscillator(signals: pd.DataFrame, trials: pd.DataFrame, plant: Oscillator) -> OscillatorCell:
    """Return the cell of an oscillator's records.

    Parameters
    ----------
    signals : DataFrame
        Columns ``record``, ``time_s``, ``signal`` and ``value``; times evenly spaced within a record.
    trials : DataFrame
        Columns ``record``, ``start_s`` and ``samples``: the blocks, in the order of the arrays' last axis.
    plant : Oscillator
        Names the two signals.

    Raises
    ------
    ValueError
        When one of the signals is missing or has no values.
    """
    samples = int(trials["samples"].max())
    records, step_s = spread_records(signals, (plant.input, plant.output))
    lead = round(plant.lead_in_s / step_s)
    refined = {name: _refine_record(rows, plant, lead) for name, rows in records.items()}
    blocks = [
        _cut(records[record], *refined[record], plant, round(start / step_s), lead, (before, count - after), samples)
        for record, start, count, before, after in list_blocks(trials)
    ]
    stacked = [np.stack(column, axis=1) for column in zip(*blocks, strict=True)]
    return OscillatorCell(plant, step_s, stacked[0], stacked[1], stacked[2], trials["start_s"].to_numpy(dtype=float))


def _refine_record(rows: pd.DataFrame, plant: Oscillator, lead: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return a record's refined input, and where it is known throughout a lead-in before."""
    known = rows[plant.input].notna().to_numpy()
    missing = np.concatenate([np.ones(lead), ~known])
    total = np.concatenate([[0.0], np.cumsum(missing)])
    clear = total[lead + 1 :] - total[: len(known)] == 0.0
    return refine(bridge(rows[plant.input])[:, None], plant.substeps, plant.between_samples)[:, 0], clear


def _cut(
    rows: pd.DataFrame,
    fine: Array,
    clear: NDArray[np.bool_],
    plant: Oscillator,
    first: int,
    lead: int,
    judged: tuple[int, int],
    samples: int,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return one block's refined input with its lead-in, its output, and where that is judged; ends are held."""
    step = 2 * plant.substeps
    at = np.arange((first - lead) * step, (first + samples - 1) * step + 1)
    places = np.arange(first, first + samples)
    inside = (places >= first + judged[0]) & (places < first + judged[1]) & (places < len(rows))
    places = np.minimum(places, len(rows) - 1)
    output = rows[plant.output].to_numpy(dtype=float)
    present = inside & clear[places] & np.isfinite(output[places])
    return fine[np.clip(at, 0, len(fine) - 1)], bridge(rows[plant.output])[places], present
