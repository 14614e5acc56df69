"""A soft finger or another bending actuator: one pressure, or two that act against each other, to an angle.

The angle is a cubic in the difference of pressures, since the bellows stiffen as they bend (Polygerinos and others 2015);
that the elastomer follows late is an effect.
"""

from typing import ClassVar, Literal

from stages.science.plant.machines.static_map import StaticMap


class Finger(StaticMap):
    """Everything that simulating such a finger takes."""

    QUANTITIES: ClassVar = {"along": ("pressure",), "against": ("pressure",), "output": ("angle",)}

    kind: Literal["finger"]


PLANT = Finger
