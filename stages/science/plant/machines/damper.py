"""A damper that a drive hardens, magnetorheological or with a valve: position, speed and drive to force.

The nominal law is viscous, with a viscosity linear in the drive, beside the spring of an accumulator: the Bingham
plastic (Spencer, Dyke, Sain and Carlson 1997) less its yield force, which is an effect.
"""

from typing import ClassVar, Literal

from pydantic import Field

from stages.science.plant.product_plant import ProductPlant


class Damper(ProductPlant):
    """Everything that simulating such a damper takes."""

    QUANTITIES: ClassVar = {
        "along": ("length", "angle"),
        "speed": ("velocity", "angular velocity"),
        "drive": ("current", "voltage"),
        "output": ("force", "torque"),
    }

    TELLING: ClassVar = ("drive",)

    kind: Literal["damper"]
    drive: str | None = Field(description="current or voltage that hardens it; null = it was constant")


PLANT = Damper
