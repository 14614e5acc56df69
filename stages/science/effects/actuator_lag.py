"""An actuator that follows its command late: an amplifier, a winding, a valve or a tube between input and force.

A first-order lag of what drives a motion makes an oscillator a machine of third order. In an element on a bench, what
acts follows what is recorded: the pressure behind a tube, the field behind a current.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import DynamicEffect, ElementEffect, Parameter
from stages.science.plant.filters import lag

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

ELEMENT = ElementEffect(
    name="actuator_lag",
    parameters=(
        Parameter("paces", "1", 0.0, 2.0, 0.0, 0.2, "time constant of what drives, over the pace", (0.03, 0.1, 0.4)),
    ),
    source=EFFECT.source,
    signature="after a step of what drives the element the answer follows late, however it is moved",
    split_by="steps of what drives it, while it is held",
    apply=lambda drive, bench, parameters: lag(drive, parameters["paces"] * bench.time_scale_s, bench.step_s),
    changes="drive",
)

FORMS = (EFFECT, ELEMENT)
