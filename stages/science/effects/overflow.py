"""Overflow of a tank: what is pumped in above its rim runs over, and a share of it into the tank below.

The magnitude is the inverse of the rim's height: at zero the rim is infinitely high.
"""

from stages.science.effects import name_terms
from stages.science.plant.effect import DynamicEffect, Parameter

RIMS = (0.35, 0.5, 0.7, 1.0, 1.4)

EFFECT = DynamicEffect(
    name="overflow",
    form="rim",
    site="tank",
    parameters=(
        Parameter("scale_over_rim", "1", 0.0, 10.0, 0.5, 1.0, "level's scale over the rim's height", RIMS),
        Parameter("share_down", "1", 0.0, 1.0, 0.5, 0.5, "share of what runs over that the lower tank gets", (0.5,)),
    ),
    source=(
        "Schoukens, Noel, Three benchmarks addressing open challenges in nonlinear system identification, IFAC "
        "PapersOnLine 50-1 (2017): cascaded tanks with overflow"
    ),
    signature="the level rises quicker than it should after the input was high for long, and falls earlier",
    split_by="a slow rise of the input beyond the overflow: the upper level stops",
    terms=name_terms(scale_over_rim="scale_over_rim", share_down="share_down"),
    scales=False,
)
