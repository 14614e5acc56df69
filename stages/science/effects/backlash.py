"""Play between cable and joint: a pulley on its key, a joint in its hinge; the muscle stands still after a reversal.

The contraction of the muscle follows that of the geometry by a play operator.
"""

from stages.science.plant.effect import ChainEffect, Parameter
from stages.science.signals.operators import follow_play

EFFECT = ChainEffect(
    name="backlash",
    form="play",
    site="transmission",
    signal="contraction",
    parameters=(Parameter("play", "1", 0.0, 0.1, 0.01, 0.01, "play over rest length", (0.005, 0.02)),),
    source="Nordin, Gutman, Controlling mechanical systems with backlash: a survey, Automatica 38 (2002)",
    signature="force stands for a short way after every reversal, more where it depends more on contraction",
    split_by="slow reversals at two pressures: the way after a reversal stays the same",
    apply=lambda signal, state, parameters: follow_play(signal, 0.5 * parameters["play"]),
)
