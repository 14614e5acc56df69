"""Check that the configured plant can simulate what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from stages.science.plant.machine import list_kinds
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant


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
    if isinstance(plant, RecordPlant) != (kind == "records"):
        hint = "plant=nominal, or measurement=records" if kind == "muscles" else f"plant={' or '.join(list_kinds())}"
        raise ValueError(f"plant: expected one that simulates {kind}, got another kind of machine; set {hint}")
    if not isinstance(plant, RecordPlant):
        return
    for name in (*plant.inputs, plant.output):
        if name not in known:
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
