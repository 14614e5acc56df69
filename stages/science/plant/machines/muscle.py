"""A pneumatic muscle on a test bench: pressure, and length or contraction, to force; isometric, isotonic or free.

The force is linear in pressure and quadratic in length, as in the braid's law (Chou and Hannaford 1996) with tapering
ends (Tondu and Lopez 2000); the tube's own force is quadratic in length. Without a length the muscle is isometric, and
is moved along the pressure.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from stages.science.plant.product_plant import ProductPlant


class Muscle(ProductPlant):
    """Everything that simulating such a muscle takes."""

    QUANTITIES: ClassVar = {"pressure": ("pressure",), "length": ("ratio", "length"), "output": ("force",)}

    kind: Literal["muscle"]
    pressure: str
    length: str | None = Field(description="length, position or contraction; null = it is fixed")

    @model_validator(mode="before")
    @classmethod
    def _move_along_pressure(cls, section: Any) -> Any:
        if not isinstance(section, Mapping) or section.get("along") is not None:
            return section
        return {**section, "along": section.get("length") or section.get("pressure")}


PLANT = Muscle
