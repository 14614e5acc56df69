"""Which machine is simulated: muscles that move joints, or one of another kind, told by the section's key ``kind``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import PlainValidator

from stages.plant.oscillator import Oscillator
from stages.plant.plant import Plant


def read_machine(section: Any) -> Plant | Oscillator:
    """Return a section of the configuration as the model of its kind; muscles have none.

    Raises
    ------
    ValidationError
        When the model refuses it.
    """
    if isinstance(section, Plant | Oscillator):
        return section
    model = Oscillator if isinstance(section, Mapping) and "kind" in section else Plant
    return model.model_validate(section)


Machine = Annotated[Plant | Oscillator, PlainValidator(read_machine)]
