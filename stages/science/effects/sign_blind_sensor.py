"""A sensor that shows how much, but not which way: it reads the magnitude, as a pulse counter does of a speed."""

from stages.science.effects import name_terms
from stages.science.plant.effect import DynamicEffect, Parameter

EFFECT = DynamicEffect(
    name="sign_blind_sensor",
    form="motion",
    site="motion",
    parameters=(Parameter("share", "1", 0.0, 1.1, 0.0, 1.0, "of a reading below zero that is shown above it", (1.0,)),),
    source=(
        "Wigren, Schoukens, Coupled electric drives data set and reference models, Uppsala University report 2017-024 "
        "(2017): a pulse counter that is insensitive to the sign of the speed"
    ),
    signature="the response turns back at zero wherever it should go below",
    split_by="a slow motion through zero, watched with the eye",
    terms=name_terms(folded="share"),
    scales=False,
    unsigned=True,
)
