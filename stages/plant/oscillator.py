"""The configuration of an oscillator: constants of its linear model with tolerances, and a list of named effects.

A section of YAML flows in; checked values and the simulated output of a record come out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Self, cast

from pydantic import Field, model_validator

from stages.plant.declaration import Declared
from stages.plant.effect import DynamicEffect, Parameter
from stages.plant.listed import ListedEffect, NominalConstant, find_effect_at
from stages.plant.second_order import Between, OscillatorConstants, collect_terms, refine, simulate_oscillator
from stages.signals.trajectories import Array

SITE = "oscillator"


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


class OscillatorEffect(ListedEffect):
    """An effect that acts at an oscillator."""

    SITE = SITE

    @property
    def effect(self) -> DynamicEffect:
        """The effect itself."""
        return find_oscillator_effect(self.name, self.form)


def find_oscillator_effect(name: str, form: str | None) -> DynamicEffect:
    """Return an effect that acts at an oscillator, in the form given or its first; see `find_effect_at`."""
    return cast(DynamicEffect, find_effect_at(SITE, name, form))


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
