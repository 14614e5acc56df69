"""The two channels of a muscle: pressure from the command, and force from the measured pressure and contraction.

Each is fed with measured signals from upstream, so that a fault shows where it arises. Recorded trials of one muscle
flow in; outputs flow out.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.exact_values import find_count, find_levels
from stages.science.output_channels.output_channel import Counts, DetectionSettings, Driver, OutputChannel, Placed
from stages.science.plant.actuator_path import Acting, ActuatorPath, predict_force, predict_pressure
from stages.science.plant.effect import ChainEffect, NamedEffect, Parameter, find_effect, list_effects, list_forms
from stages.science.plant.learned_map import DRIVES, SESSION_TIME, TIME
from stages.science.plant.muscle import MuscleConstants, braid_coefficients
from stages.science.signals.filtering import decimate, white_share
from stages.science.signals.histories import HISTORIES
from stages.science.signals.trajectories import Array

EXACT = "saturation"
"""Effect whose level exactly repeated values show."""
QUANTISATION = "quantisation"
"""Effect whose counts the values show. It is not fitted: it has no derivatives, and what it takes away is noise."""
MOTION, COMMAND = "motion", "pressure_command_kpa"
"""What drives a muscle: how its joint moves, from the lowest angle to the highest, and its command."""
PRESSURE_SITES, FORCE_SITES = ("command", "valve"), ("pressure", "muscle", "transmission")


@dataclass(frozen=True)
class Build:
    """What is known of a muscle before anything is fitted."""

    name: str
    area_n_per_kpa: float
    max_pressure_kpa: float
    contraction_at_angle_0: float
    contraction_per_rad: float
    torque_arm_m: float


PRESSURES = ("smooth_pressure_kpa", "slow_pressure_kpa")
SIGNALS = ("command_kpa", "pressure_kpa", *PRESSURES, "contraction", "velocity_per_s", "force_n")


@dataclass(frozen=True)
class Records:
    """Trials of one muscle as measured, gaps bridged; (T, K) arrays, and (K,) for the trials' starts."""

    step_s: float
    start_s: Array
    """Start of each trial in the session, s."""
    command_kpa: Array
    pressure_kpa: Array
    contraction: Array
    velocity_per_s: Array
    force_n: Array
    smooth_pressure_kpa: Array
    """Pressure without most of its sensor's noise."""
    slow_pressure_kpa: Array
    """The same over a wider window, of which no average has much of the former's noise."""
    known: Mapping[str, NDArray[np.bool_]]
    """By signal, where it was measured."""
    others: Mapping[str, Array]
    """Signals of other muscles and joints."""
    averaged: int
    readings: Mapping[str, Array]
    """By signal, what its sensor showed, each sample of the recording, (S, K); NaN where nothing."""
    written_kpa: Array
    """Command at each sample of the recording, (S, K), `averaged` of which make one here."""

    def take(self, trials: Sequence[int]) -> Self:
        """Return some of the trials."""
        chosen = list(trials)
        taken: dict[str, Any] = {name: np.ascontiguousarray(getattr(self, name)[:, chosen]) for name in SIGNALS}
        taken["written_kpa"] = np.ascontiguousarray(self.written_kpa[:, chosen])
        for name in ("known", "others", "readings"):
            taken[name] = {signal: values[:, chosen] for signal, values in getattr(self, name).items()}
        return replace(self, start_s=self.start_s[chosen], **taken)


@dataclass
class MuscleChannel(OutputChannel):
    """A channel of one muscle, named as what is measured of it; the signals needed tell where it is present."""

    needed: ClassVar[tuple[str, ...]]
    build: Build
    records: Records
    constants: tuple[Parameter, ...]
    load_cell_site: Literal["muscle_tip", "joint_end"]
    limits: DetectionSettings
    slow_drivers: bool = False
    levers = (MOTION, COMMAND)

    def __post_init__(self) -> None:
        records = self.records
        self.element, self.step_s, self.start_s = self.build.name, records.step_s, records.start_s
        self.averaged = records.averaged
        self.measured = getattr(records, self.channel)
        self.present = np.logical_and.reduce([records.known[name] for name in self.needed])

    def take(self, trials: Sequence[int]) -> Self:
        """Return the output with some of its trials."""
        return replace(self, records=self.records.take(trials))

    def excite(self, shares: Mapping[str, Array]) -> Self:
        """Return the output in other trials; the pressure follows the command at once."""
        records, count = self.records, shares[MOTION].shape[1]
        felt = self.present & records.known["force_n"]  # without the filling before a trial, in which no force is told
        seen = felt if felt.any() else self.present
        shortening = shares[MOTION] if self.build.contraction_per_rad > 0.0 else 1.0 - shares[MOTION]
        command = _scale(shares[COMMAND], records.command_kpa[seen])
        contraction = _scale(shortening, records.contraction[seen])
        signals: dict[str, Any] = {
            "command_kpa": command,
            **dict.fromkeys(("pressure_kpa", *PRESSURES), command),
            "contraction": contraction,
            "velocity_per_s": np.gradient(contraction, records.step_s, axis=0),
            "force_n": np.zeros_like(command),
        }
        everywhere: Any = np.ones(command.shape, dtype=bool)
        start_s = np.full(count, records.start_s.max() + records.step_s * len(records.command_kpa))
        others = {name: np.full(command.shape, values.mean()) for name, values in records.others.items()}
        told: dict[str, Any] = {"others": others, "known": dict.fromkeys(records.known, everywhere)}
        told["readings"] = {name: signals[name] for name in records.readings}
        told["written_kpa"] = np.repeat(command, records.averaged, axis=0)
        return replace(self, records=replace(records, start_s=start_s, **signals, **told))

    def tell_levers(self) -> dict[str, Array]:
        """Return the contraction that the joint's motion makes, and the command."""
        return {"contraction": self.records.contraction, COMMAND: self.records.command_kpa}

    def can_tell(self, name: str) -> bool:
        """Return whether a chain of muscles knows an input: own signals, what drives others, histories, and time."""
        known = [each.name for each in self.drivers() if each.own]
        known += [each for each in self.records.others if each.endswith(f" {DRIVES[self.channel]}")]
        return name in (TIME, SESSION_TIME) or any(name.removeprefix(f"{each} ") in known for each in HISTORIES)

    def is_driven(self, least_kpa: float) -> bool:
        """Return whether its input varies, a command by more than `least_kpa`, so that there is something to judge."""
        return True

    @abstractmethod
    def name_level(self, level: float, constants: Mapping[str, float]) -> dict[str, float]:
        """Return the level at which this channel is clipped as the parameter of ``saturation``."""

    def starts(self, form: NamedEffect, constants: Mapping[str, float]) -> list[dict[str, float]]:
        """Return starting values of a form; of saturation the level that repeated values show, or none."""
        if form.name == QUANTISATION:
            return []
        if form.name != EXACT:
            return super().starts(form, constants)
        return [] if self._level is None else [self.name_level(self._level, constants)]

    def shows(self, form: NamedEffect) -> bool:
        """Return whether the largest value recurs exactly, and the form cuts off at a level."""
        return form.name == EXACT and self._level is not None

    def find_counts(self, constants: Mapping[str, float]) -> Counts | None:
        """Return the counts that the values of this channel's sensor show, as far as an effect has such."""
        shown = self.records.readings[self.channel]
        step = find_count(shown[np.isfinite(shown)], self.limits)
        if step is None:
            return None
        form = next(each for each in self.forms if each.name == QUANTISATION)
        size, full = form.parameters[0], float(self._collect(constants).full_force_n[0])
        told = step if size.unit == self.unit else step / full
        if told > size.high:
            return None
        second = np.diff(shown, 2, axis=0)  # of white noise, six times its square
        white = float(np.nanmean(second**2)) / 6.0
        return Counts(form, {size.name: told}, step, white * (1.0 - white_share(self.averaged)))

    @cached_property
    def _level(self) -> float | None:
        """Largest value, where it recurs exactly; the smallest value recurs in a muscle at rest too."""
        highest = find_levels(self.records.readings[self.channel], self.limits).highest
        return highest if highest is not None and highest > 0.0 else None

    def _collect(self, constants: Mapping[str, float]) -> MuscleConstants:
        build = vars(self.build)
        a, b = braid_coefficients(constants.get("braid_angle_deg", 25.0))
        full = {"full_force_n": self.build.area_n_per_kpa * self.build.max_pressure_kpa * (a - b)}
        given = {**build, "braid_a": a, "braid_b": b, "area_factor": 1.0, "regulator_gain": 1.0, **full, **constants}
        values = np.array([given.get(name, 0.0) for name in MuscleConstants._fields], dtype=float)
        return MuscleConstants(*np.repeat(values[:, None], len(self.records.start_s), axis=1))


class PressureChannel(MuscleChannel):
    """Sensed pressure from the command."""

    channel = "pressure_kpa"
    unit = "kPa"
    needed = ("command_kpa", "pressure_kpa")

    def is_driven(self, least_kpa: float) -> bool:
        """Return whether the command varies by more than `least_kpa`, a sensor's noise."""
        return bool(np.ptp(self.records.command_kpa[self.present]) > least_kpa)

    @property
    def forms(self) -> tuple[NamedEffect, ...]:
        """Effects between command and sensed pressure."""
        return _offer(PRESSURE_SITES, "sensed_pressure_kpa")

    def simulate(self, constants: Mapping[str, float], effects: Placed) -> Array:
        """Return the sensed pressure, kPa: of the command as it was written, then averaged as the recording was."""
        muscles, placed, fine_s = self._collect(constants), _name_effects(effects), self.step_s / self.averaged
        told = predict_pressure(self.records.written_kpa, muscles, placed, fine_s, self.start_s)
        return decimate(told, self.averaged)

    def name_level(self, level: float, constants: Mapping[str, float]) -> dict[str, float]:
        """Return the level of the pressure, inverted."""
        return {"mpa_over_level": 1000.0 / level}

    def drivers(self) -> list[Driver]:
        """Return the command, how it changes, the muscle's motion, and the other muscles' commands."""
        records = self.records
        rate = np.gradient(records.command_kpa, records.step_s, axis=0)
        own = [Driver("pressure_command_kpa", records.command_kpa), Driver("command_rate", rate, rate=True)]
        aside = {name: values for name, values in records.others.items() if "command" in name}
        aside |= {"contraction": records.contraction, "contraction_velocity_per_s": records.velocity_per_s}
        return own + [Driver(name, values, own=False) for name, values in aside.items()]


class ForceChannel(MuscleChannel):
    """Sensed force from measured pressure and contraction."""

    channel = "force_n"
    unit = "N"
    needed = ("force_n", "pressure_kpa", "contraction", "velocity_per_s")
    plane = ("contraction", "pressure_kpa")
    loop = ("contraction", "contraction_velocity_per_s")

    @property
    def forms(self) -> tuple[NamedEffect, ...]:
        """Effects between pressure, contraction and sensed force; at the muscle's tip no cable's tension is felt."""
        felt = _offer(FORCE_SITES, "sensed_force_n", "contraction")
        if self.load_cell_site == "joint_end":
            return felt
        return tuple(each for each in felt if each.signal != "tension_n")

    def simulate(self, constants: Mapping[str, float], effects: Placed) -> Array:
        """Return the sensed force, N."""
        records, muscles, placed = self.records, self._collect(constants), _name_effects(effects)
        signals = records.smooth_pressure_kpa, records.contraction, records.velocity_per_s
        return predict_force(*signals, muscles, placed, records.step_s, records.start_s, self.load_cell_site)

    def find_past_share(self, form: NamedEffect, values: Mapping[str, float]) -> float:
        """Return the share of a form's force that does not follow from pressure and contraction at the same moment.

        What follows from them is the same, moment by moment, when the motion runs backwards.
        """
        forward = self.take([0])
        turned = {name: getattr(forward.records, name)[::-1] for name in SIGNALS}
        turned["velocity_per_s"] = -turned["velocity_per_s"]
        backward = forward.from_signals(turned)
        constants = {**{each.name: each.prior_mean for each in self.constants}, "damping_n_s": 0.0}
        placed = [(form, values)]
        there, back = (each.simulate(constants, placed) - each.simulate(constants, []) for each in (forward, backward))
        whole = float(np.linalg.norm(there))
        return 0.5 * float(np.linalg.norm(there[::-1] - back)) / whole if whole > 0.0 else 0.0

    def correct(self, effects: Sequence[tuple[str, str, Mapping[str, float]]]) -> Self:
        """Return the output with the true pressure, where the pressure's sensor has an effect."""
        placed = [(find_effect(name, form), values) for name, form, values in effects if name != QUANTISATION]
        sensor = [each for each in placed if getattr(each[0], "signal", "") == "sensed_pressure_kpa"]
        if not sensor:
            return self
        path = self._place(sensor)
        told = self.from_signals({name: path.unsense_pressure(getattr(self.records, name)) for name in PRESSURES})
        return replace(told, slow_drivers=False)

    def calm(self) -> Self:
        """Return the output with the pressure smoothed over the wider window among its drivers."""
        return replace(self, slow_drivers=True)

    def acting(self, effects: Placed) -> Self:
        """Return the output with the contraction that acts, where what shows it has an effect."""
        inner = [each for each in _name_effects(effects) if (each[0].site, each[0].signal) == ("sensor", "contraction")]
        if not inner:
            return self
        return self.from_signals({"contraction": self._place(inner).contract(self.records.contraction)})

    def _place(self, effects: Sequence[tuple[Any, Mapping[str, float]]]) -> ActuatorPath:
        return ActuatorPath(self._collect({}), [Acting(*each) for each in effects], self.step_s, self.start_s)

    def from_signals(self, signals: Mapping[str, Array]) -> Self:
        """Return the output with other signals, (T, K), than those recorded, by their names in its records."""
        own: dict[str, Any] = {name: np.ascontiguousarray(each) for name, each in signals.items()}
        return replace(self, records=replace(self.records, **own))

    def name_level(self, level: float, constants: Mapping[str, float]) -> dict[str, float]:
        """Return the largest force over the level."""
        return {"full_force_over_level": float(self._collect(constants).full_force_n[0]) / level}

    def drivers(self) -> list[Driver]:
        """Return pressure, contraction, their rates, the command, other muscles' pressures and other joints' angles."""
        records = self.records
        pressure = records.slow_pressure_kpa if self.slow_drivers else records.smooth_pressure_kpa
        rate = np.gradient(pressure, records.step_s, axis=0)
        own = [
            Driver("pressure_kpa", pressure),
            Driver("contraction", records.contraction, unit="1"),
            Driver("contraction_velocity_per_s", records.velocity_per_s, rate=True),
            Driver("pressure_rate", rate, rate=True),
        ]
        aside = {name: values for name, values in records.others.items() if "command" not in name}
        aside["pressure_command_kpa"] = records.command_kpa
        aside["contraction_acceleration_per_s2"] = np.gradient(records.velocity_per_s, records.step_s, axis=0)
        for name, values in records.others.items():
            if name.endswith("contraction"):
                aside[f"{name} rate"] = np.gradient(values, records.step_s, axis=0)
        return own + [Driver(name, values, own=False) for name, values in aside.items()]


def _scale(shares: Array, seen: Array) -> Array:
    """Return what runs through these shares of the range of the values seen."""
    return np.asarray(seen.min() + shares * np.ptp(seen))


def _name_effects(effects: Placed) -> list[tuple[ChainEffect, Mapping[str, float]]]:
    return [(cast(ChainEffect, form), values) for form, values in effects if form.name != QUANTISATION]


def _offer(sites: Sequence[str], *sensed: str) -> tuple[ChainEffect, ...]:
    return tuple(
        effect
        for effect in (effect for name in list_effects() for effect in list_forms(name))
        if isinstance(effect, ChainEffect) and effect.parameters
        if effect.site in sites or (effect.site == "sensor" and effect.signal in sensed)
    )
