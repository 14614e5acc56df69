"""The chain of one muscle after another: command, valve, pressure, tension, cable.

Arrays over time flow in and out; the last axis is always the muscle, and axes between time and muscle (trials, say) are
simulated side by side. Effects are applied at their sites in the order in which the plant lists them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stages.plant.effect import ChainEffect, State
from stages.plant.exoskeleton import Exoskeleton
from stages.plant.muscle import MuscleConstants, compute_tension
from stages.plant.plant import AppliedEffect, Plant, collect_constants
from stages.plant.valve import respond
from stages.signals.trajectories import Array


class Chain:
    """Muscles and valves of an exoskeleton under a plant's constants and effects.

    Parameters
    ----------
    exoskeleton : Exoskeleton
        The machine's rows.
    plant : Plant
        Constants and effects.

    Raises
    ------
    ValueError
        When the plant does not fit the machine.
    """

    def __init__(self, exoskeleton: Exoskeleton, plant: Plant):
        plant.check_against(exoskeleton)
        self.step_s = 1.0 / exoskeleton.sampling_rate_hz
        self.constants = collect_constants(exoskeleton, plant)
        self.effects = [_Placed(entry, exoskeleton) for entry in plant.effects if isinstance(entry.effect, ChainEffect)]

    @property
    def bends_force(self) -> bool:
        """Whether an effect lets tension at the joint differ from the static law at the sensed pressure."""
        return any(placed.signal not in ("pressure_command_kpa", "pressure_kpa") for placed in self.effects)

    def pressurise(self, command_kpa: Array) -> Array:
        """Return the pressure at the valves that a held command brings.

        Parameters
        ----------
        command_kpa : (T, ..., M) ndarray
            Commanded pressure, kPa gauge.

        Returns
        -------
        (T, ..., M) ndarray
            Pressure, kPa gauge.
        """
        command = self._flatten(command_kpa)
        muscles = self._repeat(command.shape[1])
        command = self._apply("pressure_command_kpa", command, lambda: self._upstream(muscles, command, command))
        pressure = respond(command, muscles.valve_tau_s, muscles.valve_tau_s, self.step_s)
        pressure = self._apply("pressure_kpa", pressure, lambda: self._upstream(muscles, command, pressure))
        return pressure.reshape(command_kpa.shape)

    def pull(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> tuple[Array, Array]:
        """Return the tension at both ends of the cables.

        Parameters
        ----------
        pressure_kpa : (T, ..., M) ndarray
            Pressure at the valves, kPa gauge.
        contraction, velocity_per_s : (T, ..., M) ndarray
            Contraction by the joint's geometry, 1, and its rate, 1/s.

        Returns
        -------
        tuple of (T, ..., M) ndarray
            Tension at the muscle's tip and at the joint's end, N.
        """
        pressure, contraction, velocity = map(self._flatten, (pressure_kpa, contraction, velocity_per_s))
        muscles = self._repeat(pressure.shape[1])
        state = State(self.step_s, muscles, pressure, pressure, contraction, velocity)
        acting = self._apply("acting_pressure_kpa", pressure, lambda: state)
        stretched = self._apply("contraction", contraction, lambda: state)
        state = State(self.step_s, muscles, pressure, acting, stretched, velocity)
        force = self._bend("force_n", compute_tension(acting, stretched, velocity, muscles), state)
        tension = self._bend("tension_n", force, state)
        return force.reshape(pressure_kpa.shape), tension.reshape(pressure_kpa.shape)

    def pull_nominally(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> Array:
        """Return the tension, N, that the static law alone gives; shapes as in `pull`."""
        pressure, contraction, velocity = map(self._flatten, (pressure_kpa, contraction, velocity_per_s))
        tension = compute_tension(pressure, contraction, velocity, self._repeat(pressure.shape[1]))
        return tension.reshape(pressure_kpa.shape)

    def _apply(self, signal: str, values: Array, state: Callable[[], State]) -> Array:
        for placed in self.effects:
            if placed.signal == signal:
                values = placed.apply(values, state())
        return values

    def _bend(self, signal: str, tension: Array, state: State) -> Array:
        bent = self._apply(signal, tension, lambda: state)
        return tension if bent is tension else np.maximum(bent, 0.0)

    def _upstream(self, muscles: MuscleConstants, command: Array, pressure: Array) -> State:
        return State(self.step_s, muscles, command, pressure, np.zeros_like(command), np.zeros_like(command))

    def _flatten(self, values: Array) -> Array:
        muscles = len(self.constants.area_n_per_kpa)
        if values.shape[-1] != muscles:
            raise ValueError(f"expected {muscles} muscles on the last axis, got shape {values.shape}")
        return np.ascontiguousarray(values, dtype=float).reshape(len(values), -1)

    def _repeat(self, columns: int) -> MuscleConstants:
        copies = columns // len(self.constants.area_n_per_kpa)
        if copies == 1:
            return self.constants
        return MuscleConstants(*(np.tile(column, copies) for column in self.constants))


class _Placed:
    """A chain effect on its muscles."""

    def __init__(self, entry: AppliedEffect, exoskeleton: Exoskeleton):
        assert isinstance(entry.effect, ChainEffect)
        self.effect = entry.effect
        self.signal = self.effect.signal
        self.parameters = entry.parameters
        self.everywhere = entry.muscles is None
        chosen = exoskeleton.muscle_names if entry.muscles is None else entry.muscles
        self.mask = np.array([name in chosen for name in exoskeleton.muscle_names])

    def apply(self, values: Array, state: State) -> Array:
        if self.everywhere:
            return self.effect.apply(values, state, self.parameters)
        mask = np.tile(self.mask, values.shape[1] // self.mask.size)
        part = State(
            state.step_s,
            MuscleConstants(*(column[mask] for column in state.muscles)),
            *(
                np.ascontiguousarray(each[:, mask])
                for each in (state.command_kpa, state.pressure_kpa, state.contraction, state.velocity_per_s)
            ),
        )
        changed = values.copy()
        changed[:, mask] = self.effect.apply(np.ascontiguousarray(values[:, mask]), part, self.parameters)
        return changed
