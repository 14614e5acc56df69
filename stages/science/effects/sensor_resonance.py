"""A sensor that rings: its mass and spring follow what is sensed as a damped oscillator does, such as a soft load cell.

The reading overshoots after quick changes, and what is near the sensor's own frequency is shown too large.
"""

from stages.science.plant.effect import ElementEffect, Parameter
from stages.science.plant.filters import resonate

EFFECT = ElementEffect(
    name="sensor_resonance",
    parameters=(
        Parameter(
            "paces",
            "1",
            0.0,
            0.3,
            0.0,
            0.03,
            "one over the sensor's undamped angular frequency, over the pace",
            (0.005, 0.01, 0.02, 0.04, 0.08, 0.16),
        ),
        Parameter("damping", "1", 0.01, 0.4, 0.1, 0.1, "damping ratio of the sensor", (0.3,)),
    ),
    source="Doebelin, Measurement systems: application and design, 5th edition (2004), chapter 3: instruments",
    signature="an oscillation of one frequency that dies away after each quick change of the answer",
    split_by="a tap on the sensor at rest: it rings at its own frequency",
    apply=lambda answer, bench, parameters: resonate(
        answer, parameters["paces"] * bench.time_scale_s, parameters["damping"], bench.step_s
    ),
    scales=False,
    instead_of="channel_misalignment",
    changes="reading",
)
