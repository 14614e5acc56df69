"""A cylinder: pressures in its chambers, and position, to the force of its rod, with viscous friction.

The law is the balance of forces at the piston (Beater 2007); a cylinder of one acting chamber has no second pressure,
and a spring. Seals rub more strongly under pressure: that is an effect.
"""

from typing import ClassVar, Literal

from pydantic import Field

from stages.science.plant.product_plant import ProductPlant


class Cylinder(ProductPlant):
    """Everything that simulating such a cylinder takes."""

    QUANTITIES: ClassVar = {
        "pressure": ("pressure",),
        "second_pressure": ("pressure",),
        "along": ("length",),
        "speed": ("velocity",),
        "output": ("force",),
    }

    kind: Literal["cylinder"]
    pressure: str = Field(description="pressure that pushes the rod out")
    second_pressure: str | None = Field(description="pressure that pushes it in; null = the chamber is open")


PLANT = Cylinder
