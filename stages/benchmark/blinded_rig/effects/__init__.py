"""Every hidden effect by its key."""

from stages.benchmark.blinded_rig.effects import cable, muscle, sensor, valve

EFFECTS = {effect.key: effect for module in (valve, muscle, cable, sensor) for effect in module.EFFECTS}
