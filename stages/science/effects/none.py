"""No effect at all, so that its absence is a choice like any other."""

from __future__ import annotations

from collections.abc import Mapping

from stages.science.plant.effect import ChainEffect, State
from stages.science.signals.trajectories import Array


def apply(signal: Array, state: State, parameters: Mapping[str, float]) -> Array:
    """Return the signal as it is."""
    return signal


EFFECT = ChainEffect(
    name="none",
    form="identity",
    site="muscle",
    signal="force_n",
    parameters=(),
    source="nothing",
    signature="nothing beyond noise and wander",
    split_by="no experiment",
    relatives=(),
    apply=apply,
)

FORMS = (EFFECT,)
