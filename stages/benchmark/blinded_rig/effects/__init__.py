"""Every hidden effect by its key: this rig's own, those of the foreign machines, and both."""

from stages.benchmark.blinded_rig.effects import (
    cable,
    channels,
    flow,
    memory,
    muscle,
    oddities,
    relaxation,
    sensor,
    transmission,
    valve,
)

EFFECTS = {effect.key: effect for module in (valve, muscle, cable, sensor) for effect in module.EFFECTS}
FOREIGN_EFFECTS = {
    effect.key: effect
    for module in (relaxation, memory, transmission, channels, flow, oddities)
    for effect in module.EFFECTS
}
ALL_EFFECTS = EFFECTS | FOREIGN_EFFECTS
OUTSIDERS_FOR_BUILDING = tuple(
    key for key, effect in ALL_EFFECTS.items() if effect.outsider and effect.outsider_for == "building"
)
OUTSIDERS_FOR_SCORING = tuple(
    key for key, effect in ALL_EFFECTS.items() if effect.outsider and effect.outsider_for == "scoring"
)
