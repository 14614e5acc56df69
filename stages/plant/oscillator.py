"""The configuration of an oscillator: constants of its linear model with tolerances, and a list of named effects.

A section of YAML flows in; checked values and the simulated output of a record come out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Self

from pydantic import Field, model_serializer, model_validator

from stages.plant.declaration import Declared
from stages.plant.effect import DynamicEffect, Parameter, find_effect, list_forms
from stages.plant.plant import check_parameters
from stages.plant.second_order import Between, OscillatorConstants, collect_terms, refine, simulate_oscillator
from stages.signals.trajectories import Array

SITE = "oscillator"


class NominalConstant(Declared):
    """A constant of the linear model: where a fit begins, and how far it may go."""

    unit: str
    start: float
    low: float
    high: float
    sd: float = Field(gt=0.0, description="standard deviation of the prior about the start")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if not self.low <= self.start <= self.high or self.low == self.high:
            raise ValueError(
                f"expected low <= start <= high and low < high, got low {self.low}, start {self.start}, "
                f"high {self.high}"
            )
        return self

    def as_parameter(self, name: str, description: str) -> Parameter:
        """Return what a fit takes."""
        return Parameter(name, self.unit, self.low, self.high, self.start, self.sd, description, starts=(self.start,))


class NominalConstants(Declared):
    """Constants of m y'' + d y' + k y = input, as gain, natural frequency and damping ratio."""

    static_gain: NominalConstant = Field(description="output at rest over input")
    natural_frequency_hz: NominalConstant = Field(description="natural frequency without damping")
    damping_ratio: NominalConstant = Field(description="damping over the critical")
    input_offset: NominalConstant = Field(description="what is added to the measured input")
    output_offset: NominalConstant = Field(description="what the sensor adds to the motion")

    @model_validator(mode="after")
    def _check_possible(self) -> Self:
        if self.natural_frequency_hz.low <= 0.0:
            raise ValueError(f"natural_frequency_hz: expected low above 0 Hz, got {self.natural_frequency_hz.low}")
        if self.damping_ratio.low < 0.0:
            raise ValueError(f"damping_ratio: expected low of at least 0, got {self.damping_ratio.low}")
        return self


class OscillatorEffect(Declared):
    """One entry of the plant's list: an effect by name, its form and its parameters, written flat in YAML.

    `form` is the first that acts at an oscillator, where the entry does not say.
    """

    name: str
    form: str
    parameters: dict[str, float]

    @model_validator(mode="before")
    @classmethod
    def _read(cls, entry: Any) -> Any:
        if not isinstance(entry, Mapping) or "parameters" in entry:
            return entry
        if "name" not in entry:
            raise ValueError("an effect needs a name")
        effect = find_oscillator_effect(str(entry["name"]), entry.get("form"))
        numbers = {key: value for key, value in entry.items() if key not in ("name", "form")}
        return {"name": effect.name, "form": effect.form, "parameters": check_parameters(effect, numbers)}

    @model_serializer
    def _write(self) -> dict[str, Any]:
        return {"name": self.name, "form": self.form, **self.parameters}

    @property
    def effect(self) -> DynamicEffect:
        """The effect itself."""
        return find_oscillator_effect(self.name, self.form)


def find_oscillator_effect(name: str, form: str | None) -> DynamicEffect:
    """Return an effect that acts at an oscillator, in the form given or its first.

    Raises
    ------
    ValueError
        When there is none.
    """
    wanted = find_effect(name, form) if form is not None else None
    for effect in list_forms(name) if wanted is None else (wanted,):
        if isinstance(effect, DynamicEffect) and effect.site == SITE:
            return effect
    raise ValueError(f"effect {name}{f', form {form},' if form else ''} does not act at an {SITE}")


class Oscillator(Declared):
    """Everything that simulating a driven oscillator takes."""

    kind: Literal["second_order"]
    input: str
    output: str
    between_samples: Between
    substeps: int = Field(ge=1, le=100, description="integration steps per sample")
    lead_in_s: float = Field(gt=0.0, le=1000.0, description="motion before a block that is simulated but not judged, s")
    output_scale: float = Field(gt=0.0, description="motion in which effects tell their sizes, unit of the output")
    constants: NominalConstants
    effects: list[OscillatorEffect]

    @model_validator(mode="after")
    def _check_effects(self) -> Self:
        collect_terms([(entry.effect, entry.parameters) for entry in self.effects])
        return self

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Constants as a fit takes them."""
        fields = NominalConstants.model_fields
        return tuple(
            getattr(self.constants, name).as_parameter(name, str(field.description)) for name, field in fields.items()
        )

    def collect(self, values: Mapping[str, float]) -> OscillatorConstants:
        """Return the integrator's constants from their values by name."""
        return OscillatorConstants(**values, output_scale=self.output_scale)

    def simulate(self, signal: Array, step_s: float) -> Array:
        """Return the output for a measured input, from rest, with constants at their starts and the effects listed.

        Parameters
        ----------
        signal : (T, K) ndarray
            Inputs of K records.
        step_s : float
            Time between samples, s.
        """
        constants = self.collect({each.name: each.prior_mean for each in self.parameters})
        terms = collect_terms([(entry.effect, entry.parameters) for entry in self.effects])
        fine = refine(signal, self.substeps, self.between_samples)
        return simulate_oscillator(fine, constants, terms, step_s, self.substeps)

    def amend(
        self, constants: Mapping[str, float], effects: Sequence[tuple[DynamicEffect, Mapping[str, float]]]
    ) -> Oscillator:
        """Return the plant with fitted constants and with effects added to its list."""
        fitted = {
            name: getattr(self.constants, name).model_copy(update={"start": value}) for name, value in constants.items()
        }
        added = [OscillatorEffect(name=e.name, form=e.form, parameters=dict(values)) for e, values in effects]
        return Oscillator(
            **{
                **{name: getattr(self, name) for name in type(self).model_fields},
                "constants": NominalConstants(**fitted),
                "effects": [*self.effects, *added],
            }
        )
