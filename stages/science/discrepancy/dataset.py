"""A measured dataset as the workflow looks at it: its output channels, and what each trial is for.

Tables of what was measured flow in, with the configured plant; a `Dataset` flows out, whatever the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.parts import FITTED, VERIFICATION
from stages.science.discrepancy.plant_check import check_plant
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.whole_record_channel import build_whole_records
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant
from stages.science.recording.measured_tables import MeasuredTables


@dataclass(frozen=True)
class DatasetTables(MeasuredTables):
    """What was measured, and what each trial is for; each field is named as its table."""

    trial_parts: pd.DataFrame


@dataclass(frozen=True)
class Dataset:
    """Output channels of what was measured, with all trials, and the plant, what it left open resolved from the data.

    Numbers of the trials, and what each is for (``fitted``, ``verification`` or ``other``), are in the order of the
    outputs' last axis.
    """

    plant: Plant | RecordPlant
    outputs: Sequence[OutputChannel]
    trials: list[int]
    parts: list[str]

    @property
    def fitted(self) -> list[int]:
        """Positions of the fitted trials."""
        return [place for place, part in enumerate(self.parts) if part == FITTED]

    @property
    def test(self) -> list[int]:
        """Positions of the test trials, which are opened once."""
        return [place for place, part in enumerate(self.parts) if part == VERIFICATION]

    @property
    def fitted_trials(self) -> list[int]:
        """Numbers of the fitted trials."""
        return [self.trials[place] for place in self.fitted]

    @cached_property
    def fitted_outputs(self) -> list[OutputChannel]:
        """Output channels with the fitted trials alone."""
        return [output.take(self.fitted) for output in self.outputs]


def build_dataset(
    plant: Plant | RecordPlant, tables: MeasuredTables, trial_parts: pd.DataFrame, settings: DiscrepancySettings
) -> Dataset:
    """Return a dataset of the configured plant; `trial_parts` is from `list_parts`.

    Raises
    ------
    ValueError
        When the plant is not one that simulates such a recording, or when it names a signal that was not recorded.
    """
    kind = str(tables.measured_session["kind"].iloc[0])
    check_plant(plant, kind, list(dict.fromkeys(tables.measured_signals["signal"])))
    trials, parts = trial_parts["trial"].to_list(), trial_parts["part"].to_list()
    if not isinstance(plant, RecordPlant):
        return Dataset(plant, build_muscle_channels(tables, settings), trials, parts)
    gaps = {name: trial_parts[name].to_numpy() for name in ("left_before", "left_after")}
    blocks = tables.measured_trials.assign(**gaps)
    output = build_whole_records(tables.measured_signals, blocks, plant, settings.detection)
    return Dataset(output.plant, [output], trials, parts)
