"""What is known of a recorded machine: its muscles and its session.

The mapping that meta.json holds, or the configured exoskeleton, flows in; rows of muscles and a `Session` flow out.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError, model_validator

from stages.science.plant.declaration import nearest
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.recording.columns import RecordingError
from stages.science.signals.columns import Column, column

MUSCLE_COLUMNS: dict[str, Column] = {
    "muscle": column(str, "its name"),
    "joint": column(str, "joint that it moves"),
    "role": column(str, "agonists raise the angle", among=["agonist", "antagonist"]),
    "type": column(str, "its type"),
    "rest_length_m": column(float, "length without pressure and load", "m", 0),
    "nominal_diameter_m": column(float, "inner diameter without pressure", "m", 0),
    "moment_arm_m": column(float, "radius of the joint's pulley", "m", 0),
    "contraction_at_angle_0": column(float, "contraction at angle 0"),
    "sign": column(int, "1 when it shortens as the angle grows", among=[-1, 1]),
    "valve_tau_s": column(float, "time constant of the valve, to begin with", "s", nullable=True),
    "braid_angle_deg": column(float, "braid angle at rest, to begin with", "degrees", nullable=True),
    "contraction_factor": column(float, "factor on contraction, to begin with", nullable=True),
    "damping_n_s": column(float, "tension lost per velocity, to begin with", "N s", nullable=True),
}
"""What every table of a recorded machine holds of each muscle."""


LONGEST_M, WIDEST_M = 10.0, 1.0
"""Above which a muscle's length, and its diameter or the radius of a pulley, are in another unit."""


class MetaSection(BaseModel):
    """A section of meta.json; other keys in it are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class MuscleMeta(MetaSection):
    """A muscle as meta.json describes it."""

    joint: str
    role: Literal["agonist", "antagonist"]
    type: str
    rest_length_m: float = Field(gt=0.0, le=LONGEST_M)
    nominal_diameter_m: float = Field(gt=0.0, le=WIDEST_M)
    moment_arm_m: float = Field(gt=0.0, le=WIDEST_M)
    contraction_at_angle_0: float = Field(gt=-0.5, lt=0.5)
    sign: Literal[-1, 1]


class Nominal(MetaSection):
    """Starting values, for all muscles or by muscle; a key in it that is none of these is a mistake."""

    model_config = ConfigDict(extra="forbid")

    valve_tau_s: PositiveFloat | dict[str, PositiveFloat] | None = None
    braid_angle_deg: PositiveFloat | dict[str, PositiveFloat] | None = None
    contraction_factor: PositiveFloat | dict[str, PositiveFloat] | None = None
    damping_n_s: float | dict[str, float] | None = None

    def of(self, muscle: str, name: str) -> float:
        """Return a muscle's starting value, or nan where meta.json has none."""
        told = getattr(self, name)
        value = told.get(muscle) if isinstance(told, dict) else told
        return np.nan if value is None else float(value)


GEOMETRY, NOMINAL = tuple(MuscleMeta.model_fields), tuple(Nominal.model_fields)
"""What describes a muscle, and the constants from which a fit may start."""


class Session(MetaSection):
    """A recorded session as meta.json describes it."""

    sampling_rate_hz: float = Field(gt=0.0, le=1e6)
    trial_start_s: list[float | None] | None = None
    load_cell_site: Literal["muscle_tip", "joint_end", "unknown"] = "unknown"
    timing: str = ""
    muscles: dict[str, MuscleMeta] = Field(min_length=1)
    nominal: Nominal = Nominal()

    @model_validator(mode="after")
    def _check_names_and_order(self) -> Self:
        for name, told in vars(self.nominal).items():
            if isinstance(told, dict) and told and not {*told} & {*self.muscles}:
                first = next(iter(told))
                raise ValueError(f"nominal.{name}: no muscle '{first}'; {nearest(first, self.muscles)}")
        told = [each for each in self.trial_start_s or [] if each is not None]
        if any(later <= earlier for earlier, later in pairwise(told)):
            raise ValueError("trial_start_s: expected each trial to start after the one before")
        return self

    def starts_of(self, trials: list[int]) -> list[float]:
        """Return when each trial started in the session, s; nan where meta.json does not say.

        A `RecordingError` tells that there are starts, but not for these trials.
        """
        told = self.trial_start_s
        if told is None:
            return [np.nan] * len(trials)
        if len(told) != len(trials) and not set(trials) <= set(range(len(told))):
            raise RecordingError(f"trial_start_s: expected one for each of {len(trials)} trials, got {len(told)}")
        chosen = told if len(told) == len(trials) else [told[trial] for trial in trials]
        return [np.nan if each is None else each for each in chosen]

    def describe(self) -> pd.DataFrame:
        """Return a row for each muscle, under `MUSCLE_COLUMNS`."""
        rows = [
            {"muscle": name, **told.model_dump(), **{each: self.nominal.of(name, each) for each in NOMINAL}}
            for name, told in self.muscles.items()
        ]
        return pd.DataFrame(rows, columns=list(MUSCLE_COLUMNS))


def read_session(meta: Any) -> Session:
    """Return what meta.json holds, checked; a `RecordingError` tells the first key that is missing or wrong."""
    if not isinstance(meta, Mapping):
        raise RecordingError("expected a mapping with sampling_rate_hz and muscles")
    try:
        return Session.model_validate(meta)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            raise RecordingError(f"lacks {key}") from None
        if first["type"] == "extra_forbidden":
            raise RecordingError(f"{key}: {nearest(key.rpartition('.')[2], NOMINAL)}") from None
        text = first["msg"].removeprefix("Value error, ")
        prefix = f"{key}: " if key else ""
        value = "" if first["type"] == "value_error" else f", got {str(first['input'])[:40]!r}"
        raise RecordingError(f"{prefix}{text[:1].lower()}{text[1:]}{value}") from None


def describe_muscles(exoskeleton: Exoskeleton) -> pd.DataFrame:
    """Return a row for each muscle of the configured exoskeleton, under `MUSCLE_COLUMNS`, without starting values."""
    rows = [{"muscle": each.name, **{name: getattr(each, name) for name in GEOMETRY}} for each in exoskeleton.muscles]
    return pd.DataFrame(rows, columns=list(MUSCLE_COLUMNS))
