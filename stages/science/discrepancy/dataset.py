"""A measured dataset as the workflow looks at it: its output channels, and what each trial is for.

Tables of what was measured flow in, with the configured plant; a `Dataset` flows out, whatever the machine.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import pandas as pd

from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.parts import FITTED, VERIFICATION
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.whole_record_channel import FEWEST, build_whole_records
from stages.science.plant.learned_map import SESSION_TIME, TIME
from stages.science.plant.machine import list_kinds
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import NOTHING, RecordPlant
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import NOMINAL
from stages.science.recording.units import ENDS


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
        told = replace(tables, measured_muscles=_begin_with(plant, tables.measured_muscles, settings))
        return Dataset(plant, build_muscle_channels(told, settings), trials, parts)
    gaps = {name: trial_parts[name].to_numpy() for name in ("left_before", "left_after")}
    blocks = tables.measured_trials.assign(**gaps)
    output = build_whole_records(tables.measured_signals, blocks, plant, settings.detection)
    dataset = Dataset(output.plant, [output], trials, parts)
    for name, places in (("fitted", dataset.fitted), ("test", dataset.test)):
        judged = int(output.present[:, places].sum())
        if judged < FEWEST:
            raise ValueError(
                f"signal {output.channel}: expected {FEWEST} samples or more in the {name} trials, got {judged} of "
                f"{int(output.present.sum())} in all; choose other parts, as parts.last_share=0.4"
            )
    return dataset


def _begin_with(plant: Plant, muscles: pd.DataFrame, settings: DiscrepancySettings) -> pd.DataFrame:
    """Return a row for each muscle in which constants that what was measured does not tell are the plant's.

    They are those of `NOMINAL`, and others whose tolerance names no value to start from.
    """
    tolerances = [each for channel in settings.tolerances.values() for each in channel.items()]
    names = [*NOMINAL, *(name for name, each in tolerances if each.start is None and name not in NOMINAL)]
    rows = muscles.to_dict("records")
    for row in rows:
        for name in [each for each in names if pd.isna(row.get(each))]:
            row[name] = getattr(plant.find_model(row["muscle"], row["type"]), name)
    return pd.DataFrame(rows, columns=list(dict.fromkeys([*muscles.columns, *names])))


def check_plant(plant: Plant | RecordPlant, kind: str, known: Sequence[str]) -> None:
    """Check that a plant simulates such a recording, and that what it names was measured.

    The recording is of ``muscles`` or ``records``; `known` are the names of its signals.

    Raises
    ------
    ValueError
        When it does not, naming what names the signal.
    """
    if isinstance(plant, RecordPlant) != (kind == "records"):
        hint = "plant=nominal, or measurement=records" if kind == "muscles" else f"plant={' or '.join(list_kinds())}"
        raise ValueError(f"plant: expected one that simulates {kind}, got another kind of machine; set {hint}")
    if not isinstance(plant, RecordPlant):
        return
    for index, learned in enumerate(plant.learned):
        for what, got, own in (("channel", learned.channel, plant.output), ("element", learned.element, plant.element)):
            if got != own:
                raise ValueError(f"plant.learned.{index}.{what}: expected {own}, which the plant tells, got {got}")
        for name in (each.name.rpartition(" ")[2] for each in learned.inputs):
            if name not in (*known, TIME, SESSION_TIME) and any(name.endswith(f"_{unit}") for unit in ENDS):
                raise ValueError(
                    f"signal {name}, which the learned map plant.learned.{index} is told from: expected it to be "
                    f"measured; known are {', '.join(known) or 'none'}; add +columns.{name}=COLUMN, or take all maps "
                    "out with plant.learned=[]"
                )
    for name in (*plant.inputs, plant.output):
        if name not in (*known, NOTHING):
            settings = dict(_list_settings(plant.model_dump(), name, "plant"))
            raise ValueError(
                f"signal {name}, named by {' and '.join(settings)}: expected it to be measured; known are "
                f"{', '.join(known) or 'none'}; type {_suggest_setting(settings, plant, known)}, or add "
                f"+columns.{name}=COLUMN"
            )


def _suggest_setting(settings: Mapping[str, Any], plant: RecordPlant, known: Sequence[str]) -> str:
    """Return the setting that names another signal: the one that is left, if it is one."""
    left = [each for each in known if each not in (*plant.inputs, plant.output)]
    missing = [each for each in (*plant.inputs, plant.output) if each not in known]
    other = left[0] if len(left) == len(missing) == 1 else "NAME"
    key = next((each for each in settings if not each.startswith("plant.constants.")), next(iter(settings)))
    value = settings[key]
    if isinstance(value, str):
        return f"{key}={other}"
    return f"'{key}=[{','.join(other if each in missing else each for each in value)}]'"


def _list_settings(section: Any, name: str, key: str) -> Iterator[tuple[str, Any]]:
    """Yield the keys and values of a configuration whose value is a name, or a list with it."""
    if isinstance(section, Mapping):
        for own, value in section.items():
            yield from _list_settings(value, name, f"{key}.{own}")
    elif section == name or (isinstance(section, list) and name in section):
        yield key, section
