"""Sections of the configuration that the stages of the discrepancy workflow share."""

import keyword
import re
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from stages.science.output_channels.output_channel import DetectionSettings
from stages.science.plant.declaration import Declared, nearest
from stages.science.plant.effect import list_effects, name_module


class Tolerance(Declared):
    """How far a nominal constant may be from its starting value."""

    unit: str
    start: float | None = Field(
        description="starting value; null takes the one that measured data come with, or else the plant's"
    )
    low: float
    high: float
    sd: float = Field(gt=0.0)
    times: Literal["one", "start", "largest", "full"] = Field(
        description="what low, high and sd are multiples of: 1, the start, the largest force measured, that of the "
        "nominal muscle at rest and its largest pressure"
    )
    description: str


class SearchSettings(Declared):
    """When a gap matters and a name is accepted."""

    smallest_gap: float = Field(gt=1.0, le=10.0)
    least_share: float = Field(ge=0.0, le=1.0)
    least_rest: float = Field(ge=0.0, le=1.0)
    unexplained_share: float = Field(gt=0.0, lt=1.0)
    ambiguous_share: float = Field(gt=0.0, lt=1.0)
    most_evidence: float = Field(gt=0.0)
    family_prior: float = Field(gt=0.0, lt=0.5)
    static_prior: float = Field(gt=0.0, lt=0.5)
    shortlist: int = Field(ge=1, le=100)
    most_effects: int = Field(ge=1, le=10)
    none_prior: float = Field(gt=0.0, lt=1.0)
    certain: float = Field(gt=0.0, lt=1.0)
    clear_ratio: float = Field(gt=1.0)
    largest_jitter: float = Field(gt=0.0)
    hiding_share: float = Field(gt=0.0, lt=1.0)
    nothing_share: float = Field(gt=0.0, lt=1.0)
    ambiguous_weight: float = Field(ge=0.0, le=1.0)
    left_out: list[str] = Field(description="effects that are not looked for")

    @model_validator(mode="after")
    def _know_effects(self) -> Self:
        for name in self.left_out:
            if name not in list_effects():
                raise ValueError(f"left_out: no effect '{name}'; {nearest(name, list_effects())}")
        return self

    @property
    def imported_by_name(self) -> tuple[str, ...]:
        """Modules of all effects, as any may be looked for."""
        return tuple(name_module(name) for name in list_effects())


class RegimeSettings(Declared):
    """Regimes of motion and time in which a gap is looked for."""

    around_reversal: float = Field(gt=0.0)
    band_edges: list[float] = Field(min_length=1)
    largest_quantile: float = Field(gt=0.5, le=1.0)


class MuscleChannelSettings(Declared):
    """Which channels of muscles are looked at, and how their inputs are smoothed."""

    smoothing_s: float = Field(gt=0.0)
    slow_smoothing_s: float = Field(gt=0.0)
    least_samples: int = Field(ge=10)
    least_drive_kpa: float = Field(ge=0.0)


class ReportSettings(Declared):
    """From where on the findings mention something."""

    high_floor: float = Field(ge=1.0)
    most_confounded: float = Field(gt=0.5, lt=1.0)
    concentrated: float = Field(ge=1.0)
    least_share: float = Field(ge=0.0, le=1.0)
    nearest_gap: float = Field(gt=0.0, le=1.0)
    odd_trial: float = Field(gt=1.0)
    most_forgotten: float = Field(ge=0.0, le=1.0)
    most_places: int = Field(ge=1)


class DiscrepancySettings(Declared):
    """How gaps are found, named and mended."""

    verification_share: float = Field(gt=0.0, lt=0.8)
    bootstraps: int = Field(ge=100, le=100000)
    level: float = Field(gt=0.5, lt=1.0)
    patch: Literal["none", "when_unexplained", "always"]
    write_effect: str | None
    search: SearchSettings
    regimes: RegimeSettings
    detection: DetectionSettings
    muscle_channels: MuscleChannelSettings
    report: ReportSettings
    max_pressure_kpa: dict[str, float]
    tolerances: dict[str, dict[str, Tolerance]]

    @field_validator("write_effect")
    @classmethod
    def _is_a_new_name(cls, name: str | None) -> str | None:
        if name is not None and (re.fullmatch("[a-z][a-z0-9_]*", name) is None or keyword.iskeyword(name)):
            raise ValueError(f"expected a name of small letters, digits and _, such as my_friction, got {name}")
        if name in list_effects():
            raise ValueError(f"there is an effect {name} already; choose another name")
        return name

    @property
    def significance(self) -> float:
        """Probability of a result by chance below which it counts."""
        return 1.0 - self.level


class DescriptionSettings(Declared):
    """How what stays unexplained is described."""

    most_inputs: int = Field(ge=1, le=5)
    least_errors: float = Field(ge=0.0)
    least_help: float = Field(ge=0.0, le=1.0)
    range_part: float = Field(gt=0.0, le=1.0)
    pseudo_inputs: int = Field(ge=2, le=200)
    most_terms: int = Field(ge=1, le=10)
    least_own: float = Field(ge=0.0, le=1.0)


def choose_verification(trials: int, share: float) -> list[int]:
    """Return the positions of the trials that are opened once, spread evenly: at least one, and all but two at most.

    Raises
    ------
    ValueError
        When there are fewer than three trials.
    """
    if trials < 3:
        raise ValueError(f"expected at least 3 trials, two to fit and one to verify, got {trials}; record more")
    chosen = [k for k in range(trials) if int((k + 1) * share + 1e-9) > int(k * share + 1e-9)]
    return chosen[-(trials - 2) :] or [trials - 1]
