"""The actuator path: from command to pressure, and from pressure to force, of columns of muscles, trials, or both.

Arrays (T, K) flow in and out. A rig's chain is a path of all its muscles; a fit's is one of a single muscle, its trials
side by side. Effects act at their signals in the order in which they are listed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stages.science.plant.effect import ChainEffect, Signal, State
from stages.science.plant.filters import respond
from stages.science.plant.muscle import MuscleConstants, compute_tension
from stages.science.signals.trajectories import Array

INVERSIONS = 3


@dataclass(frozen=True)
class Acting:
    """An effect with its parameters, and on which muscles of every trial it acts: all, without a mask."""

    effect: ChainEffect
    parameters: Mapping[str, float]
    mask: NDArray[np.bool_] | None = None

    def apply(self, values: Array, state: State) -> Array:
        """Return the mapped signal, (T, K)."""
        if self.mask is None:
            return self.effect.apply(values, state, self.parameters)
        mask = np.tile(self.mask, values.shape[1] // self.mask.size)
        changed = values.copy()
        its = np.ascontiguousarray(values[:, mask])
        changed[:, mask] = self.effect.apply(its, state.select(mask), self.parameters)
        return changed

    def invert(self, values: Array, state: State) -> Array:
        """Return the signal that is mapped to these values.

        Where an effect has no inverse of its own, a few fixed-point passes, exact for offset and drift, and within the
        cube of a small gain error. Counts and a clipped range, which hide what was there, are left as shown.
        """
        if self.effect.invert is not None:
            return self.effect.invert(values, state, self.parameters)
        found = values
        for _ in range(INVERSIONS):
            found = found + (values - self.apply(found, state))
        return found


@dataclass(frozen=True)
class ActuatorPath:
    """K columns of muscle under effects, in order; times in s, `start_s` (K,) of each column's trial in the session."""

    constants: MuscleConstants
    effects: Sequence[Acting]
    step_s: float
    start_s: Array

    def repeat(self, copies: int) -> "ActuatorPath":
        """Return the path of so many copies of all columns, one copy after another."""
        constants = MuscleConstants(*np.tile(self.constants, (1, copies)))
        return ActuatorPath(constants, self.effects, self.step_s, np.tile(self.start_s, copies))

    def pressurise(self, command_kpa: Array) -> Array:
        """Return the pressure at the valves, kPa gauge, that a held command (T, K), kPa gauge, brings."""
        given, tau = _contiguous(command_kpa), self.constants.valve_tau_s
        command = self._apply("pressure_command_kpa", given, lambda: self._upstream(given, given))
        lagged = respond(command, tau, tau, self.step_s)
        pressure = self.constants.regulator_gain * lagged + self.constants.regulator_offset_kpa
        return self._apply("pressure_kpa", pressure, lambda: self._upstream(command, pressure))

    def pull(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> tuple[Array, Array]:
        """Return the tension at the muscle's tip and at the joint's end, N.

        Of the pressure at the valves, kPa gauge, the contraction by the joint's geometry, 1, and its rate, 1/s; all
        arrays (T, K).
        """
        pressure_kpa, contraction, velocity_per_s = map(_contiguous, (pressure_kpa, contraction, velocity_per_s))
        acting, shortened = pressure_kpa, contraction

        def state() -> State:
            return self._state(pressure_kpa, acting, shortened, velocity_per_s)

        acting = self._apply("acting_pressure_kpa", pressure_kpa, state)
        shortened = self._apply("contraction", contraction, state)
        static = compute_tension(acting, shortened, velocity_per_s, self.constants)
        force = self._bend("force_n", static, state)
        return force, self._bend("tension_n", force, state)

    def contract(self, contraction: Array) -> Array:
        """Return the muscle's contraction, 1, of that by the joint's geometry, where neither pressure nor rate tells.

        These are zero for the effects that act on it.
        """
        shown = _contiguous(contraction)
        still = np.zeros_like(shown)
        return self._apply("contraction", shown, lambda: self._state(still, still, shown, still))

    def pull_nominally(self, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> Array:
        """Return the tension, N, that the static law alone gives; see `pull`."""
        return compute_tension(pressure_kpa, contraction, velocity_per_s, self.constants)

    def sense_pressure(self, pressure_kpa: Array) -> Array:
        """Return what the pressure sensor shows, kPa gauge."""
        pressure = _contiguous(pressure_kpa)
        return self._apply("sensed_pressure_kpa", pressure, lambda: self._upstream(pressure, pressure))

    def unsense_pressure(self, shown_kpa: Array) -> Array:
        """Return the pressure, kPa gauge, that the sensor shows so."""
        pressure = _contiguous(shown_kpa)
        for effect in reversed(self.effects):
            if effect.effect.signal == "sensed_pressure_kpa":
                pressure = effect.invert(pressure, self._upstream(pressure, pressure))
        return pressure

    def sense_force(self, force_n: Array, pressure_kpa: Array, contraction: Array, velocity_per_s: Array) -> Array:
        """Return what the load cell shows, N, of the force on it; see `pull`."""
        pressure, contraction, velocity = map(_contiguous, (pressure_kpa, contraction, velocity_per_s))
        shown = _contiguous(force_n) + self.constants.force_offset_n
        return self._apply("sensed_force_n", shown, lambda: self._state(pressure, pressure, contraction, velocity))

    def _apply(self, signal: Signal, values: Array, state: Callable[[], State]) -> Array:
        for effect in self.effects:
            if effect.effect.signal == signal:
                values = effect.apply(values, state())
        return values

    def _bend(self, signal: Signal, tension: Array, state: Callable[[], State]) -> Array:
        bent = self._apply(signal, tension, state)
        return tension if bent is tension else np.maximum(bent, 0.0)

    def _upstream(self, command: Array, pressure: Array) -> State:
        still = np.zeros_like(command)
        return self._state(command, pressure, still, still)

    def _state(self, command: Array, pressure: Array, contraction: Array, velocity: Array) -> State:
        time_s = np.arange(len(command), dtype=float) * self.step_s
        return State(self.step_s, self.constants, command, pressure, contraction, velocity, time_s, self.start_s)


Chosen = Sequence[tuple[ChainEffect, Mapping[str, float]]]


def predict_pressure(
    command_kpa: Array, constants: MuscleConstants, effects: Chosen, step_s: float, start_s: Array
) -> Array:
    """Return the pressure (T, K), kPa gauge, that the sensor shows under a held command (T, K), kPa gauge.

    Effects that act elsewhere change nothing; `start_s` (K,) is when each column's trial began in the session, s.
    """
    path = ActuatorPath(constants, [Acting(*each) for each in effects], step_s, start_s)
    return path.sense_pressure(path.pressurise(command_kpa))


def predict_force(
    pressure_kpa: Array,
    contraction: Array,
    velocity_per_s: Array,
    constants: MuscleConstants,
    effects: Chosen,
    step_s: float,
    start_s: Array,
    load_cell_site: Literal["muscle_tip", "joint_end"],
) -> Array:
    """Return the force (T, K), N, that the load cell shows, its offset included, at measured pressures and motions.

    Pressures are as their sensor shows them, kPa gauge, whose effects are taken back; contractions are by the joint's
    geometry, 1, with their rates, 1/s, (T, K) each; the rest is that of `predict_pressure`.
    """
    path = ActuatorPath(constants, [Acting(*each) for each in effects], step_s, start_s)
    pressure = path.unsense_pressure(pressure_kpa)
    force = path.pull(pressure, contraction, velocity_per_s)[load_cell_site == "joint_end"]
    return path.sense_force(force, pressure, contraction, velocity_per_s)


def _contiguous(values: Array) -> Array:
    return np.require(values, float, ["C", "W"])
