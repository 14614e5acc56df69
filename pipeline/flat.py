"""Configurations as flat mappings of dotted keys: nested values flow in, what tells runs apart flows out."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

ABSENT = "absent"
INCIDENTAL = ("plan", "workers", "figures", "outputs", "sweep", "on_failure", "on_finished", "interface", "tracking")
"""Keys that change no result; nor does the section that ``interface`` names."""
SHOWN = ("workflow.headline", "workflow.metrics", "workflow.curves", "workflow.quoted")
"""Sections that say how a run is told, not what it computes."""


def flatten(values: Any, path: str = "") -> dict[str, str]:
    """Return each value as it stands in YAML, by its dotted key; an item of a list of sections has its number in it."""
    if isinstance(values, Mapping) and values:
        pairs: Iterable[tuple[Any, Any]] = values.items()
    elif isinstance(values, list) and any(isinstance(each, Mapping) for each in values):
        pairs = enumerate(values)
    else:
        return {path: values if isinstance(values, str) else json.dumps(values, ensure_ascii=False, default=str)}
    return {
        key: text
        for name, value in pairs
        for key, text in flatten(value, f"{path}.{name}" if path else str(name)).items()
    }


def walk(values: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of a section (a mapping or a model) or list and of all within, the outermost first."""
    yield path, values
    if isinstance(values, BaseModel | Mapping | list | tuple):
        pairs = enumerate(values) if isinstance(values, list | tuple) else dict(values).items()
        for name, each in pairs:
            yield from walk(each, f"{path}.{name}" if path else str(name))


def is_incidental(key: str) -> bool:
    """Return whether runs that differ in a key compute the same nevertheless."""
    parts = key.split(".")
    return parts[0] in (*INCIDENTAL, "stages") or ".".join(parts[:2]) in SHOWN


def is_seed(key: str) -> bool:
    """Return whether a key says which repeat of the same a run is."""
    return key.rpartition(".")[2].endswith("seed")


def list_differences(runs: Sequence[Mapping[str, str]]) -> list[str]:
    """Return the keys that have not the same value in all runs, in the order in which they come."""
    keys = dict.fromkeys(key for each in runs for key in each)
    return [key for key in keys if len({each.get(key) for each in runs}) > 1]
