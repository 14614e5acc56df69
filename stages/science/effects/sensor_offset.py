"""A sensor that shows something at nothing: the zero of a load cell or of a pressure sensor.

A load cell's zero is one of the nominal constants, which take it up. A pressure sensor's shows in the pressure, where
the regulator's zero takes it up, and in the force, where the pressure that acts is not the one shown.
"""

from dataclasses import replace

from stages.science.effects import name_terms
from stages.science.plant.effect import ChainEffect, DynamicEffect, Parameter

EFFECT = ChainEffect(
    name="sensor_offset",
    form="force",
    site="sensor",
    signal="sensed_force_n",
    parameters=(Parameter("share", "1", -0.3, 0.3, 0.0, 0.02, "offset over the largest force", (0.02, -0.02)),),
    source="JCGM 200, International vocabulary of metrology (2012), 4.20 and 4.28: instrumental bias and zero error",
    signature="force errs by the same amount always",
    split_by="the load cell unloaded, before and after the session",
    apply=lambda signal, state, parameters: signal + parameters["share"] * state.muscles.full_force_n,
)

OSCILLATOR = DynamicEffect(
    name="sensor_offset",
    form="motion",
    site="motion",
    parameters=(Parameter("share", "1", -1.0, 1.0, 0.0, 0.1, "offset in scales of motion", (0.05,)),),
    source=EFFECT.source,
    signature="the response errs by the same amount at all times",
    split_by="a reading at rest without input",
    terms=name_terms(sensor_offset="share"),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        parameters=(
            Parameter("offset_kpa", "kPa", -100.0, 100.0, 0.0, 5.0, "what it shows at no pressure", (8.0, -8.0)),
        ),
        signature="pressure errs by the same amount always, and force as if pressure were another",
        split_by="the muscle vented, before and after the session",
        apply=lambda signal, state, parameters: signal + parameters["offset_kpa"],
    ),
    OSCILLATOR,
)
