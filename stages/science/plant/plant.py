"""The plant's configuration: nominal constants of muscles and sensors, and a list of named effects.

A section of YAML flows in; checked values come out. A muscle's constants stand under its type, or under its own name
where it differs from its type.
"""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field, model_serializer, model_validator

from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.effect import DynamicEffect, Effect, ElementEffect, find_effect, list_forms
from stages.science.plant.effect_config import EffectConfig, check_parameters
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.learned_map import ADDED_TO, LearnedMap
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


class AppliedEffect(EffectConfig):
    """One entry of the plant's list, with where it is.

    `form` is the first that the entry's place (muscles or joints) admits, where the entry does not say.
    """

    muscles: list[str] | None
    joints: list[str] | None

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
        named = {"name": effect.name, "form": effect.form, "parameters": check_parameters(effect, numbers)}
        return {**named, place: entry[place], other: None}

    @model_serializer
    def _write(self) -> dict[str, Any]:
        place = _places_of(self.effect)[0]
        written = {"name": self.name, place: getattr(self, place)}
        form = {} if _choose_form(written) is self.effect else {"form": self.form}
        return {"name": self.name, **form, place: getattr(self, place), **self.parameters}


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
    learned: list[LearnedMap] = Field(default=[], description="maps without a name, of what no effect explains")

    def count_substeps(self, step_s: float) -> int:
        """Return the integrator's steps in a sample, s."""
        return max(int(np.ceil(step_s / self.integration_step_s - 1e-9)), 1)

    def check_against(self, exoskeleton: Exoskeleton) -> Self:
        """Return the plant if it fits the machine.

        A `ValueError` tells a muscle without constants, an effect of a muscle or joint that does not exist, an effect
        that a joint has twice, and a learned map of what does not exist.
        """
        for muscle in exoskeleton.muscles:
            self.find_model(muscle.name, muscle.type)
        seen = set()
        for index, entry in enumerate(self.effects):
            kind, chosen, known = "muscle", entry.muscles, exoskeleton.muscle_names
            if entry.effect.site == "joint":
                kind, chosen, known = "joint", entry.joints, exoskeleton.joint_names
            for name in known if chosen is None else chosen:
                if name not in known:
                    raise ValueError(
                        f"plant.effects.{index}.{kind}s: effect {entry.name}: no {kind} '{name}'; "
                        f"{nearest(name, known)}"
                    )
                if kind == "joint" and (entry.name, name) in seen:
                    raise ValueError(f"effect {entry.name} is listed twice for joint {name}; list it once")
                seen.add((entry.name, name))
        for index, learned in enumerate(self.learned):
            for what, name, known in (
                ("element", learned.element, exoskeleton.muscle_names),
                ("channel", learned.channel, list(ADDED_TO)),
            ):
                if name not in known:
                    raise ValueError(f"plant.learned.{index}.{what}: got '{name}'; {nearest(name, known)}")
        return self

    def find_model(self, name: str, kind: str) -> MuscleModel:
        """Return the constants of a muscle of a name and a type: its own, else its type's.

        A `ValueError` says that there are neither.
        """
        for key in (name, kind):
            if key in self.muscles:
                return self.muscles[key]
        raise ValueError(f"plant has no constants for muscle {name} or its type {kind}; {nearest(kind, self.muscles)}")


def collect_constants(exoskeleton: Exoskeleton, plant: Plant) -> MuscleConstants:
    """Return the constants of all muscles as arrays, in the exoskeleton's order."""
    rows = []
    for muscle in exoskeleton.muscles:
        model = plant.find_model(muscle.name, muscle.type)
        area = 1000.0 * np.pi * (0.5 * muscle.nominal_diameter_m) ** 2
        a, b = braid_coefficients(model.braid_angle_deg)
        full_force_n = area * muscle.max_pressure_kpa * (a - b)
        told = {"area_n_per_kpa": area, "braid_a": a, "braid_b": b, "full_force_n": full_force_n}
        told |= {
            name: getattr(muscle, name) for name in ("contraction_at_angle_0", "contraction_per_rad", "torque_arm_m")
        }
        rows.append([told[name] if name in told else getattr(model, name) for name in MuscleConstants._fields])
    return MuscleConstants(*np.array(rows, dtype=float).T.copy())
