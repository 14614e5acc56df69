"""An actuator that follows its command late: an amplifier, a winding or a valve between the input and the force.

A first-order lag of what drives a motion makes an oscillator a machine of third order.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import DynamicEffect, Parameter

EFFECT = DynamicEffect(
    name="actuator_lag",
    form="motion",
    site="motion",
    parameters=(Parameter("paces", "1", 0.0, 20.0, 0.0, 0.5, "time constant of the drive, paces", (0.3, 1.0, 3.0)),),
    source="Franklin, Powell, Emami-Naeini, Feedback control of dynamic systems, 7th edition (2015): motors",
    signature="the response to a step of the input begins flat, and the slow part of the motion lags most",
    split_by="a chirp of the input: a lag loses amplitude as the frequency grows, a delay does not",
    terms=name_terms(drive_lag="paces"),
)
