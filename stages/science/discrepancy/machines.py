"""What differs from machine to machine: the outputs of a recording, and how the amended plant is written.

The tables of what was measured flow in, with the plant that was configured; outputs flow out, and later, from fitted
values, the plant's new configuration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from stages.science.discrepancy.amendment import amend
from stages.science.discrepancy.session import build_channels
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.output_channels.whole_record_channel import WholeRecordChannel, build_whole_records
from stages.science.plant.machine import list_kinds
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant

HELD_BY: dict[str, type] = {"muscles": Plant, "records": RecordPlant}
"""Which plants simulate each kind of recording."""


class Measurements(NamedTuple):
    """The tables of what was measured; of `samples` and `signals` one is empty."""

    samples: pd.DataFrame
    signals: pd.DataFrame
    trials: pd.DataFrame
    muscles: pd.DataFrame
    session: pd.DataFrame

    def keep_apart(self, gaps: pd.DataFrame) -> Measurements:
        """Return the same, with the samples that `leave_gaps` leaves out of each trial."""
        told = {name: gaps[name].to_numpy() for name in ("left_before", "left_after")}
        return self._replace(trials=self.trials.assign(**told))


def list_channels(
    plant: Plant | RecordPlant, measured: Measurements, settings: DiscrepancySettings
) -> Sequence[OutputChannel]:
    """Return the outputs of a recording, whatever the machine.

    Raises
    ------
    ValueError
        When the plant is not one that simulates such a recording, or when it names a signal that was not recorded.
    """
    check_plant(plant, str(measured.session["kind"].iloc[0]), list(dict.fromkeys(measured.signals["signal"])))
    if isinstance(plant, RecordPlant):
        return [build_whole_records(measured.signals, measured.trials, plant)]
    return build_channels(measured.samples, measured.trials, measured.muscles, measured.session, settings)


def check_plant(plant: Plant | RecordPlant, kind: str, known: Sequence[str]) -> None:
    """Check that a plant simulates such a recording, and that what it names was measured.

    Parameters
    ----------
    plant : Plant, or one of records
        What is configured.
    kind : {"muscles", "records"}
        Of the recording.
    known : sequence of str
        Names of the signals of records.

    Raises
    ------
    ValueError
        When it does not, naming what names the signal.
    """
    if not isinstance(plant, HELD_BY[kind]):
        hint = "plant=nominal, or measurement=records" if kind == "muscles" else f"plant={' or '.join(list_kinds())}"
        raise ValueError(f"plant: expected one that simulates {kind}, got another kind of machine; set {hint}")
    if not isinstance(plant, RecordPlant):
        return
    for name in (*plant.inputs, plant.output):
        if name not in known:
            settings = dict(_list_settings(plant.model_dump(), name, "plant"))
            raise ValueError(
                f"signal {name}, named by {' and '.join(settings)}: expected it to be measured; known are "
                f"{', '.join(known) or 'none'}; type {_tell_remedy(settings, name, plant, known)}, or add "
                f"+columns.{name}=COLUMN"
            )


def _tell_remedy(settings: Mapping[str, Any], name: str, plant: RecordPlant, known: Sequence[str]) -> str:
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


def settle(plant: Plant | RecordPlant, outputs: Sequence[OutputChannel]) -> Plant | RecordPlant:
    """Return the plant with what it left to the data to tell, as its outputs have it."""
    return outputs[0].plant if isinstance(outputs[0], WholeRecordChannel) else plant


def write_amended(
    plant: Plant | RecordPlant, values: pd.DataFrame, channels: pd.DataFrame, muscles: pd.DataFrame
) -> dict[str, Any]:
    """Return the configuration of a plant with fitted constants and added effects.

    Parameters
    ----------
    plant : Plant, or one of records
        What was configured, settled.
    values : DataFrame
        Columns ``muscle effect form parameter value``; an empty effect marks a nominal constant.
    channels : DataFrame
        Columns ``muscle channel white``: the white noise of each sensor.
    muscles : DataFrame
        Columns ``muscle type``; empty for a machine without muscles.
    """
    if isinstance(plant, RecordPlant):
        return _amend_records(plant, values).model_dump()
    return amend(plant, values, channels, dict(zip(muscles["muscle"], muscles["type"], strict=True)))


def _amend_records(plant: RecordPlant, values: pd.DataFrame) -> RecordPlant:
    constants = _by_name(values[values["effect"] == ""])
    chosen = [
        (str(name), str(form), _by_name(rows))
        for (name, form), rows in values[values["effect"] != ""].groupby(["effect", "form"], sort=False)
    ]
    return plant.amend(constants, chosen)


def _by_name(rows: pd.DataFrame) -> dict[str, float]:
    return {str(name): float(value) for name, value in zip(rows["parameter"], rows["value"], strict=True)}
