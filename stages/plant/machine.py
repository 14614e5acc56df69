"""Which machine is simulated: muscles that move joints, or one of another kind, told by the section's key ``kind``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import PlainValidator

from stages.plant.declaration import nearest
from stages.plant.oscillator import Oscillator
from stages.plant.plant import Plant
from stages.plant.static_map import StaticMap
from stages.plant.tanks import CascadedTanks

RecordPlant = Oscillator | StaticMap | CascadedTanks
"""Plants that simulate records of signals."""
KINDS: dict[str, type[Oscillator] | type[StaticMap] | type[CascadedTanks]] = {
    "second_order": Oscillator,
    "static_map": StaticMap,
    "cascaded_tanks": CascadedTanks,
}


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
    if kind not in KINDS:
        raise ValueError(f"kind: expected {' or '.join(KINDS)}, got {kind!r}; {nearest(kind, KINDS)}")
    return KINDS[kind].model_validate(section)


Machine = Annotated[Plant | RecordPlant, PlainValidator(read_machine)]
