"""A sensor whose scale is wrong: it shows a multiple of what there is.

A load cell's gain is that of the static law, which takes it up. A pressure sensor's shows in the pressure, where the
regulator's gain takes it up, and in the force through the pressure that acts.
"""

from dataclasses import replace

from stages.science.plant.effect import ChainEffect, Parameter

EFFECT = ChainEffect(
    name="sensor_gain",
    form="force",
    site="sensor",
    signal="sensed_force_n",
    parameters=(Parameter("error", "1", -0.5, 0.5, 0.0, 0.05, "gain less 1", (0.05, -0.05)),),
    source="JCGM 200, International vocabulary of metrology (2012), 4.12 and 4.20: sensitivity and instrumental bias",
    signature="force errs in proportion to itself, always",
    split_by="known weights on the load cell",
    apply=lambda signal, state, parameters: signal * (1.0 + parameters["error"]),
)

FORMS = (
    EFFECT,
    replace(
        EFFECT,
        form="pressure",
        signal="sensed_pressure_kpa",
        signature="pressure errs in proportion to itself, always, and force as if pressure were another",
        split_by="a second pressure gauge",
    ),
)
