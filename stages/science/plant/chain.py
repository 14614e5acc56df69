"""The actuator path of a whole machine's muscles side by side, from command to sensors."""

import numpy as np

from stages.science.plant.actuator_path import Acting, ActuatorPath
from stages.science.plant.effect import ChainEffect
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.learned_map import act_on_muscle
from stages.science.plant.plant import Plant, collect_constants

BENDING = ("acting_pressure_kpa", "contraction", "force_n", "tension_n")


class Chain(ActuatorPath):
    """Muscles and valves of an exoskeleton under a plant's constants and effects, in a trial begun at `start_s`, s.

    A `ValueError` says that the plant does not fit the machine.
    """

    def __init__(self, exoskeleton: Exoskeleton, plant: Plant, start_s: float = 0.0):
        plant.check_against(exoskeleton)
        names = exoskeleton.muscle_names
        effects = [
            Acting(entry.effect, entry.parameters, None if on is None else np.isin(names, on))
            for entry in plant.effects
            for on in [entry.muscles]
            if isinstance(entry.effect, ChainEffect)
        ]
        effects += [Acting(act_on_muscle(learned, names), {}) for learned in plant.learned]
        constants, step_s = collect_constants(exoskeleton, plant), 1.0 / exoskeleton.sampling_rate_hz
        super().__init__(constants, effects, step_s, np.full(len(names), start_s))

    @property
    def bends_force(self) -> bool:
        """Whether an effect lets tension at the joint differ from the static law at the valve's pressure."""
        return any(each.effect.signal in BENDING for each in self.effects)
