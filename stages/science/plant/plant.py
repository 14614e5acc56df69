"""The plant's configuration: nominal constants of muscles and sensors, and a list of named effects.

A section of YAML flows in; checked values come out. A muscle's constants stand under its type, or under its own name
where it differs from its type.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field, model_serializer, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.effect import (
    DynamicEffect,
    Effect,
    ElementEffect,
    Parameter,
    find_effect,
    list_forms,
    name_module,
)
from stages.science.plant.exoskeleton import Exoskeleton, Muscle
from stages.science.plant.muscle import MuscleConstants, braid_coefficients


class MuscleModel(Declared):
    """Nominal constants of a muscle with its valve and sensors.

    The bounds are an order of magnitude beyond any muscle of the data sheets; past them tensions leave every sensor.
    """

    valve_tau_s: float = Field(ge=0.0, le=60.0, description="time constant of valve and hose, s")
    braid_angle_deg: float = Field(gt=5.0, lt=54.0, description="braid angle at rest, degrees")
    contraction_factor: float = Field(gt=0.0, le=5.0, description="factor on contraction for tapering ends, 1")
    passive_linear_n: float = Field(ge=-1e6, le=1e6, description="rubber's push per contraction, N")
    passive_quadratic_n: float = Field(ge=-1e6, le=1e6, description="rubber's push per squared contraction, N")
    damping_n_s: float = Field(ge=0.0, le=1e5, description="tension lost per contraction velocity, N s")
    pressure_noise_kpa: float = Field(ge=0.0, le=100.0, description="standard deviation of the pressure sensor, kPa")
    force_noise_n: float = Field(ge=0.0, le=1000.0, description="standard deviation of the load cell, N")
    area_factor: float = Field(ge=0.5, le=2.0, description="effective over nominal area, 1")
    regulator_gain: float = Field(ge=0.5, le=2.0, description="settled pressure per command, 1")
    regulator_offset_kpa: float = Field(ge=-100.0, le=100.0, description="settled pressure at no command, kPa")
    force_offset_n: float = Field(ge=-1000.0, le=1000.0, description="load cell's reading at no tension, N")


class Encoder(Declared):
    """Joint angle sensor; past half a radian it tells nothing of a joint."""

    noise_rad: float = Field(ge=0.0, le=0.5, description="standard deviation before rounding, rad")
    resolution_rad: float = Field(ge=0.0, le=0.5, description="one count, rad; 0 for none")


class AppliedEffect(Declared):
    """One entry of the plant's list: an effect by name, where it is, and its parameters, written flat in YAML.

    `form` is the first that the entry's place (muscles or joints) admits, where the entry does not say.
    """

    name: str
    form: str
    muscles: list[str] | None
    joints: list[str] | None
    parameters: dict[str, float]

    @model_validator(mode="before")
    @classmethod
    def _read(cls, entry: Any) -> Any:
        if not isinstance(entry, Mapping):
            return entry
        if "name" not in entry:
            raise ValueError("an effect needs a name")
        effect = _choose_form(entry)
        if isinstance(effect, DynamicEffect | ElementEffect):
            raise ValueError(
                f"effect {effect.name}, form {effect.form}: acts at the {effect.site}, not at a muscle or joint"
            )
        place, other = _places_of(effect)
        if place not in entry:
            raise ValueError(f"effect {effect.name}: missing key '{place}' (a list of {place}, or null for all)")
        if entry.get(other) is not None:
            raise ValueError(f"effect {effect.name} acts at the {effect.site}: choose {place}, not {other}")
        numbers = {key: value for key, value in entry.items() if key not in ("name", "form", "muscles", "joints")}
        return {
            "name": effect.name,
            "form": effect.form,
            place: entry[place],
            other: None,
            "parameters": check_parameters(effect, numbers),
        }

    @model_serializer
    def _write(self) -> dict[str, Any]:
        place = _places_of(self.effect)[0]
        written = {"name": self.name, place: getattr(self, place)}
        form = {} if _choose_form(written) is self.effect else {"form": self.form}
        return {"name": self.name, **form, place: getattr(self, place), **self.parameters}

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        return find_effect(self.name, self.form)

    @property
    def imported_by_name(self) -> tuple[str, ...]:
        """Module of the effect."""
        return (name_module(self.name),)


def _places_of(effect: Effect) -> tuple[str, str]:
    return ("joints", "muscles") if effect.site == "joint" else ("muscles", "joints")


def _choose_form(entry: Mapping[str, Any]) -> Effect:
    name = str(entry["name"])
    try:
        forms = list_forms(name)
    except ValueError as error:
        raise ValueError(f"name: {error}") from None
    if entry.get("form") is not None:
        return find_effect(name, str(entry["form"]))
    return next((effect for effect in forms if _places_of(effect)[0] in entry), forms[0])


def check_parameters(effect: Effect, values: Mapping[str, Any]) -> dict[str, float]:
    """Return an effect's parameters as floats, in declared order.

    Raises
    ------
    ValueError
        For one that is unknown, missing though not optional, no number or out of bounds.
    """
    declared = {parameter.name: parameter for parameter in effect.parameters}
    for name in values:
        if name not in declared:
            raise ValueError(f"effect {effect.name} has no parameter '{name}': {nearest(str(name), declared)}")
    for name, parameter in declared.items():
        if name not in values and not parameter.optional:
            raise ValueError(
                f"effect {effect.name}: missing parameter '{name}' "
                f"({parameter.description}{_format_unit(parameter, ', ')})"
            )
    return {
        name: _check_bounds(effect.name, parameter, values[name])
        for name, parameter in declared.items()
        if name in values
    }


def _check_bounds(effect: str, parameter: Parameter, value: Any) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not parameter.low <= value <= parameter.high:
        raise ValueError(
            f"effect {effect}, {parameter.name}: expected a number from {parameter.low} to {parameter.high}"
            f"{_format_unit(parameter, ' ')}, got {value!r}; change it in the list plant.effects"
        )
    return float(value)


def _format_unit(parameter: Parameter, before: str) -> str:
    return "" if parameter.unit == "1" else f"{before}{parameter.unit}"


class Plant(Declared):
    """Everything the simulation needs to know beside the exoskeleton's rows."""

    muscles: dict[str, MuscleModel]
    encoder: Encoder
    integration_step_s: float = Field(
        ge=1e-5, description="largest step of the joints' integrator, s; below the least, thousands of steps per sample"
    )
    relaxation_passes: int = Field(
        ge=1, le=100, description="passes that feed force effects back; each simulates the trial, and few suffice"
    )
    effects: list[AppliedEffect]

    def check_against(self, exoskeleton: Exoskeleton) -> Self:
        """Return the plant if it fits the machine.

        Raises
        ------
        ValueError
            When a muscle has no constants, an effect names a muscle or joint that does not exist, or a joint has one
            effect twice.
        """
        for muscle in exoskeleton.muscles:
            self.model_of(muscle)
        for index, entry in enumerate(self.effects):
            for kind, chosen, known in (
                ("muscle", entry.muscles, exoskeleton.muscle_names),
                ("joint", entry.joints, exoskeleton.joint_names),
            ):
                for name in chosen or []:
                    if name not in known:
                        raise ValueError(
                            f"plant.effects.{index}.{kind}s: effect {entry.name}: no {kind} '{name}'; "
                            f"{nearest(name, known)}"
                        )
        self._check_joint_effects(exoskeleton)
        return self

    def _check_joint_effects(self, exoskeleton: Exoskeleton) -> None:
        seen = set()
        for entry in self.effects:
            for joint in (entry.joints or exoskeleton.joint_names) if entry.effect.site == "joint" else []:
                if (entry.name, joint) in seen:
                    raise ValueError(f"effect {entry.name} is listed twice for joint {joint}; list it once")
                seen.add((entry.name, joint))

    def model_of(self, muscle: Muscle) -> MuscleModel:
        """Return a muscle's constants: its own, else its type's.

        Raises
        ------
        ValueError
            When there are neither.
        """
        for key in (muscle.name, muscle.type):
            if key in self.muscles:
                return self.muscles[key]
        hint = nearest(muscle.type, self.muscles)
        raise ValueError(f"plant has no constants for muscle {muscle.name} or its type {muscle.type}; {hint}")


def collect_constants(exoskeleton: Exoskeleton, plant: Plant) -> MuscleConstants:
    """Return the constants of all muscles as arrays, in the exoskeleton's order."""
    rows = [_constants_of(muscle, plant.model_of(muscle)) for muscle in exoskeleton.muscles]
    return MuscleConstants(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


def _constants_of(muscle: Muscle, model: MuscleModel) -> tuple[float, ...]:
    area = 1000.0 * np.pi * (0.5 * muscle.nominal_diameter_m) ** 2
    a, b = braid_coefficients(model.braid_angle_deg)
    return (
        area,
        a,
        b,
        model.contraction_factor,
        model.passive_linear_n,
        model.passive_quadratic_n,
        model.damping_n_s,
        model.valve_tau_s,
        muscle.contraction_at_angle_0,
        muscle.contraction_per_rad,
        muscle.torque_arm_m,
        area * muscle.max_pressure_kpa * (a - b),
        model.area_factor,
        model.regulator_gain,
        model.regulator_offset_kpa,
        model.force_offset_n,
    )
