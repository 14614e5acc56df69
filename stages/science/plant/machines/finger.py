"""A soft finger or another bending actuator: one pressure, or two that act against each other, to an angle.

The angle is a cubic in the difference of pressures, since the walls stiffen as they bend (Polygerinos et al. 2015).
That the elastomer follows late is an effect.
"""

from typing import ClassVar, Literal

from stages.science.plant.product_plant import ProductPlant


class Finger(ProductPlant):
    """Everything that simulating such a finger takes."""

    QUANTITIES: ClassVar = {"along": ("pressure",), "against": ("pressure",), "output": ("angle",)}

    kind: Literal["finger"]


PLANT = Finger
