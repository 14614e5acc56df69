"""The chain of one muscle after another: command, valve, pressure, tension, cable, sensors.

Arrays over time flow in and out; the last axis is always the muscle, and axes between time and muscle (trials, say) are
simulated side by side. Effects are applied at their sites in the order in which the plant lists them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stages.science.plant.actuator_path import Acting, ActuatorPath
from stages.science.plant.effect import ChainEffect
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.muscle import MuscleConstants
from stages.science.plant.plant import Plant, collect_constants
from stages.science.signals.trajectories import Array

BENDING = ("acting_pressure_kpa", "contraction", "force_n", "tension_n")


class Chain:
    """Muscles and valves of an exoskeleton under a plant's constants and effects, in a trial begun at `start_s`, s.

    Raises
    ------
    ValueError
        When the plant does not fit the machine.
    """

    def __init__(self, exoskeleton: Exoskeleton, plant: Plant, start_s: float = 0.0):
        plant.check_against(exoskeleton)
        self.step_s = 1.0 / exoskeleton.sampling_rate_hz
        self.start_s = start_s
        self.constants = collect_constants(exoskeleton, plant)
        self._repeated: dict[int, MuscleConstants] = {}
        self.effects = [
            Acting(entry.effect, entry.parameters, None if on is None else np.isin(exoskeleton.muscle_names, on))
            for entry in plant.effects
            for on in [entry.muscles]
            if isinstance(entry.effect, ChainEffect)
        ]

    @property
    def bends_force(self) -> bool:
        """Whether an effect lets tension at the joint differ from the static law at the valve's pressure."""
        return any(each.effect.signal in BENDING for each in self.effects)

    def pressurise(self, command_kpa: Array) -> Array:
        """Return the pressure at the valves, kPa gauge, that a held command (T, ..., M), kPa gauge, brings."""
        return self._pass(ActuatorPath.pressurise, command_kpa)

    def pull(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> tuple[Array, Array]:
        """Return the tension at the muscle's tip and at the joint's end, N.

        Parameters
        ----------
        pressure_kpa : (T, ..., M) ndarray
            Pressure at the valves, kPa gauge.
        contraction, velocity_per_s : (T, ..., M) ndarray
            Contraction by the joint's geometry, 1, and its rate, 1/s.
        """
        return self._pass(ActuatorPath.pull, pressure_kpa, contraction, velocity_per_s)

    def pull_nominally(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> Array:
        """Return the tension, N, that the static law alone gives; shapes as in `pull`."""
        return self._pass(ActuatorPath.pull_nominally, pressure_kpa, contraction, velocity_per_s)

    def sense_pressure(self, pressure_kpa: Array) -> Array:
        """Return what the pressure sensors show, kPa gauge; shapes as in `pressurise`."""
        return self._pass(ActuatorPath.sense_pressure, pressure_kpa)

    def sense_force(self, force_n: Array, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> Array:
        """Return what the load cells show, N, of the forces on them; shapes as in `pull`."""
        return self._pass(ActuatorPath.sense_force, force_n, pressure_kpa, contraction, velocity_per_s)

    def _pass(self, step: Callable[..., Any], *signals: Array) -> Any:
        """Return what a step of the path makes of signals (T, ..., M), of their shape."""
        muscles, shape = len(self.constants.area_n_per_kpa), signals[0].shape
        if shape[-1] != muscles:
            raise ValueError(f"expected {muscles} muscles on the last axis, got shape {shape}")
        flat = [np.ascontiguousarray(each, dtype=float).reshape(len(each), -1) for each in signals]
        columns = flat[0].shape[1]
        if columns not in self._repeated:
            copies = columns // muscles
            self._repeated[columns] = MuscleConstants(*(np.tile(column, copies) for column in self.constants))
        path = ActuatorPath(self._repeated[columns], self.effects, self.step_s, np.full(columns, self.start_s))
        found = step(path, *flat)
        return tuple(each.reshape(shape) for each in found) if isinstance(found, tuple) else found.reshape(shape)
