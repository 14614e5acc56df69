"""No effect at all, so that its absence is a choice like any other."""

from stages.science.plant.effect import ChainEffect

EFFECT = ChainEffect(
    name="none",
    form="identity",
    site="muscle",
    signal="force_n",
    parameters=(),
    source="nothing",
    signature="nothing beyond noise and wander",
    split_by="no experiment",
    apply=lambda signal, state, parameters: signal,
)
