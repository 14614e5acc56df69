"""Which machine is simulated: muscles that move joints, or one of another kind, told by the section's key ``kind``."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any

from annotated_types import MinLen
from pydantic import PlainValidator
from pydantic.fields import FieldInfo

from stages.science.plant.declaration import nearest
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant

MACHINES = "stages.science.plant.machines"


@cache
def list_kinds() -> tuple[str, ...]:
    """Return the kinds of machines whose records are simulated: the modules of `MACHINES`."""
    package = importlib.import_module(MACHINES)
    return tuple(sorted(module.name for module in pkgutil.iter_modules(package.__path__)))


def list_signals() -> dict[str, dict[str, int]]:
    """Return by kind of machine the keys that name its signals, each with how many it names, the output last."""
    found = {}
    for kind in list_kinds():
        fields = importlib.import_module(f"{MACHINES}.{kind}").PLANT.model_fields
        named = {key: 1 for key, each in fields.items() if each.annotation is str and key != "output"}
        lists = {key: _fewest(each) for key, each in fields.items() if each.annotation == list[str]}
        found[kind] = named | lists | {"output": 1}
    return found


def _fewest(field: FieldInfo) -> int:
    return next((each.min_length for each in field.metadata if isinstance(each, MinLen)), 1)


def read_machine(section: Any) -> Plant | RecordPlant:
    """Return a section of the configuration as the model of its kind; muscles have none.

    Raises
    ------
    ValidationError
        When the model refuses it.
    ValueError
        When there is no such kind.
    """
    if isinstance(section, Plant | RecordPlant):
        return section
    if not isinstance(section, Mapping) or "kind" not in section:
        return Plant.model_validate(section)
    kind = str(section["kind"])
    if kind not in list_kinds():
        raise ValueError(f"kind: expected {' or '.join(list_kinds())}, got {kind!r}; {nearest(kind, list_kinds())}")
    return _find_machine(kind).model_validate(section)


def _find_machine(kind: str) -> type[RecordPlant]:
    """Return the class of a kind of machine.

    Raises
    ------
    ValueError
        When its file does not name it, or when it lacks what every machine has to tell.
    """
    found = getattr(importlib.import_module(f"{MACHINES}.{kind}"), "PLANT", None)
    if not isinstance(found, type) or not issubclass(found, RecordPlant):
        raise ValueError(f"kind: expected {MACHINES}.{kind} to end in PLANT = its class, got {found!r}")
    missing = [*sorted(found.__abstractmethods__), *([] if hasattr(found, "SITE") else ["SITE"])]
    if missing:
        raise ValueError(f"kind: expected {found.__name__} to tell {', '.join(missing)}; docs/extend.md shows how")
    return found


Machine = Annotated[Plant | RecordPlant, PlainValidator(read_machine)]
