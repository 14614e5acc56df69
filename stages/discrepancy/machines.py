"""What differs from machine to machine: the cells of a recording, and how the amended plant is written.

The tables of what was measured flow in, with the plant that was configured; cells flow out, and later, from fitted
values, the plant's new configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import pandas as pd

from stages.discrepancy.amendment import amend
from stages.discrepancy.cell import Cell
from stages.discrepancy.oscillator_cell import build_oscillator
from stages.discrepancy.session import build_cells
from stages.discrepancy.settings import DiscrepancySettings
from stages.plant.oscillator import Oscillator, find_oscillator_effect
from stages.plant.plant import Plant

HELD_BY = {"muscles": Plant, "records": Oscillator}
"""Which plant simulates each kind of recording."""


class Measurements(NamedTuple):
    """The tables of what was measured; of `samples` and `signals` one is empty."""

    samples: pd.DataFrame
    signals: pd.DataFrame
    trials: pd.DataFrame
    muscles: pd.DataFrame
    session: pd.DataFrame


def list_cells(plant: Plant | Oscillator, measured: Measurements, settings: DiscrepancySettings) -> Sequence[Cell]:
    """Return the cells of a recording, whatever the machine.

    Raises
    ------
    ValueError
        When the plant is not one that simulates such a recording, or when it names a signal that was not recorded.
    """
    kind = str(measured.session["kind"].iloc[0])
    if not isinstance(plant, HELD_BY[kind]):
        hint = "plant=nominal, or measurement=records" if kind == "muscles" else "plant=second_order"
        raise ValueError(f"plant: expected one that simulates {kind}, got another kind of machine; set {hint}")
    if isinstance(plant, Oscillator):
        return [build_oscillator(measured.signals, measured.trials, plant)]
    return build_cells(measured.samples, measured.trials, measured.muscles, measured.session, settings)


def write_amended(
    plant: Plant | Oscillator, values: pd.DataFrame, channels: pd.DataFrame, muscles: pd.DataFrame
) -> dict[str, Any]:
    """Return the configuration of a plant with fitted constants and added effects.

    Parameters
    ----------
    plant : Plant or Oscillator
        What was configured.
    values : DataFrame
        Columns ``muscle effect form parameter value``; an empty effect marks a nominal constant.
    channels : DataFrame
        Columns ``muscle channel white``: the white noise of each sensor.
    muscles : DataFrame
        Columns ``muscle type``; empty for a machine without muscles.
    """
    if isinstance(plant, Oscillator):
        return _amend_oscillator(plant, values).model_dump()
    return amend(plant, values, channels, dict(zip(muscles["muscle"], muscles["type"], strict=True)))


def _amend_oscillator(plant: Oscillator, values: pd.DataFrame) -> Oscillator:
    chosen = values[values["effect"] != ""].groupby(["effect", "form"], sort=False)
    added = [(find_oscillator_effect(str(name), str(form)), _by_name(rows)) for (name, form), rows in chosen]
    return plant.amend(_by_name(values[values["effect"] == ""]), added)


def _by_name(rows: pd.DataFrame) -> dict[str, float]:
    return {str(name): float(value) for name, value in zip(rows["parameter"], rows["value"], strict=True)}
