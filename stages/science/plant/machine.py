"""Which machine is simulated: muscles that move joints, or one of another kind, told by the section's key ``kind``."""

import importlib
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from annotated_types import MinLen
from pydantic import PlainValidator

from stages.science.plant.declaration import list_modules, nearest
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant

MACHINES = "stages.science.plant.machines"


def list_kinds() -> tuple[str, ...]:
    """Return the kinds of machines whose records are simulated: the modules of `MACHINES`."""
    return list_modules(MACHINES)


class SignalKey(NamedTuple):
    """A key of a machine that names signals: how many, whether it may be left out, and by what quantities it is known.

    One that may not be left out may still have to be null, where there is no such signal.
    """

    signals: int
    optional: bool
    quantities: tuple[str, ...]
    nullable: bool = False


def list_signals() -> dict[str, dict[str, SignalKey]]:
    """Return by kind of machine the keys that name its signals, the output last."""
    found = {}
    for kind in list_kinds():
        plant = importlib.import_module(f"{MACHINES}.{kind}").PLANT
        keys = {}
        for key, each in plant.model_fields.items():
            if key == "kind" or (plant.QUANTITIES and key not in plant.QUANTITIES):
                continue
            known = plant.QUANTITIES.get(key, ())
            if each.annotation == list[str]:
                count = next((limit.min_length for limit in each.metadata if isinstance(limit, MinLen)), 1)
                keys[key] = SignalKey(count, False, known)
            elif each.annotation is str or (known and each.annotation == str | None):
                nullable = each.annotation is not str
                keys[key] = SignalKey(1, nullable and key not in plant.TELLING, known, nullable)
        found[kind] = {key: keys[key] for key in sorted(keys, key=lambda each: each == "output")}
    return found


def read_machine(section: Any) -> Plant | RecordPlant:
    """Return a section of the configuration as the model of its kind; muscles have none.

    A `ValidationError` tells what the model refuses, a `ValueError` that there is no such kind, or that its file lacks
    what every machine has to tell.
    """
    if isinstance(section, Plant | RecordPlant):
        return section
    if not isinstance(section, Mapping) or "kind" not in section:
        return Plant.model_validate(section)
    kind = str(section["kind"])
    if kind not in list_kinds():
        raise ValueError(f"kind: expected {' or '.join(list_kinds())}, got {kind!r}; {nearest(kind, list_kinds())}")
    found = getattr(importlib.import_module(f"{MACHINES}.{kind}"), "PLANT", None)
    if not isinstance(found, type) or not issubclass(found, RecordPlant):
        raise ValueError(f"kind: expected {MACHINES}.{kind} to end in PLANT = its class, got {found!r}")
    missing = [*sorted(found.__abstractmethods__), *([] if hasattr(found, "SITE") else ["SITE"])]
    if missing:
        raise ValueError(f"kind: expected {found.__name__} to tell {', '.join(missing)}; docs/extend.md shows how")
    return found.model_validate(section)


Machine = Annotated[Plant | RecordPlant, PlainValidator(read_machine)]
