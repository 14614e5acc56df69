"""What a muscle's model takes its force for a function of: measured signals, and features of their past.

A section of the configuration and recordings flow in; recordings with a column for each feature flow out. All features
are functions of motion and pressure, so that a bank supplies them without force. Every trial begins at rest: what was
before it is not known.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BaseModel, Field, PositiveFloat, model_validator

from stages.science.signals.columns import Column, column
from stages.science.signals.histories import lag
from stages.science.signals.operators import follow_play
from stages.science.signals.scaling import MODEL_INPUTS
from stages.science.signals.trajectories import Array


class InputConstants(BaseModel, extra="forbid", frozen=True, strict=True, allow_inf_nan=False):
    """Constants of the features."""

    stop_width: PositiveFloat = Field(le=1, description="half the width of the play, of contraction, 1")
    stop_ratio: float = Field(gt=1, le=100, description="a wide play over it, and it over a narrow play, 1")
    highpass_s: PositiveFloat = Field(le=3600, description="time constant of high-passes, s")
    direction_per_s: PositiveFloat = Field(description="contraction velocity at which its direction has turned, 1/s")


class Feature(NamedTuple):
    """A model's input: its column in tables, its unit, a description, and how it follows from a trial's signals.

    `constant` is the name of the constant that it depends on, if any. `of_pressure` says whether it follows from
    pressure alone; else it follows from motion alone. The signals are the columns of a muscle's recording by name, (T,)
    each, and the time between samples, s; there is nothing to do for a measured one.
    """

    column: str
    unit: str
    description: str
    follow: Callable[[Mapping[str, Array], float, InputConstants], Array] | None = None
    constant: str = ""
    of_pressure: bool = False


def _stop(power: int) -> Callable[[Mapping[str, Array], float, InputConstants], Array]:
    def follow(signals: Mapping[str, Array], step_s: float, constants: InputConstants) -> Array:
        contraction, width = signals["contraction"], constants.stop_width * constants.stop_ratio**power
        return np.asarray(contraction - follow_play(contraction[:, None], width)[:, 0])

    return follow


def _highpass(name: str) -> Callable[[Mapping[str, Array], float, InputConstants], Array]:
    def follow(signals: Mapping[str, Array], step_s: float, constants: InputConstants) -> Array:
        signal = signals[name]
        return np.asarray(signal - lag(signal, constants.highpass_s, step_s))

    return follow


def _direction(signals: Mapping[str, Array], step_s: float, constants: InputConstants) -> Array:
    return np.tanh(signals["contraction_velocity_per_s"] / constants.direction_per_s)


def _pressure_rate(signals: Mapping[str, Array], step_s: float, constants: InputConstants) -> Array:
    return np.gradient(signals["pressure_kpa"], step_s)


PRESSURE, CONTRACTION, VELOCITY = MODEL_INPUTS
FEATURES = {
    "pressure": Feature(PRESSURE, "kPa", "measured pressure", of_pressure=True),
    "contraction": Feature(CONTRACTION, "1", "measured contraction"),
    "contraction_velocity": Feature(VELOCITY, "1/s", "measured contraction velocity"),
    **{
        f"contraction_stop{size}": Feature(
            f"contraction_stop{size}",
            "1",
            f"contraction less its {play}, which dry friction follows",
            _stop(power),
            "stop_width",
        )
        for size, play, power in (
            ("_narrow", "narrow play operator", -1),
            ("", "play operator", 0),
            ("_wide", "wide play operator", 1),
        )
    },
    "contraction_highpass": Feature(
        "contraction_highpass",
        "1",
        "contraction less its first-order lag, which creep follows",
        _highpass(CONTRACTION),
        "highpass_s",
    ),
    "pressure_highpass": Feature(
        "pressure_highpass_kpa", "kPa", "pressure less its first-order lag", _highpass(PRESSURE), "highpass_s", True
    ),
    "direction": Feature(
        "direction", "1", "tanh of contraction velocity, which sliding friction follows", _direction, "direction_per_s"
    ),
    "pressure_rate": Feature("pressure_rate_kpa_per_s", "kPa/s", "rate of pressure", _pressure_rate, of_pressure=True),
}
"""Inputs by name. Play operators of several widths (Prandtl and Ishlinskii) and first-order lags are the generic
memories of Brokate and Sprekels, Hysteresis and Phase Transitions (1996), and of linear viscoelasticity."""


def describe_features() -> dict[str, Column]:
    """Return the columns that tables of samples have beside the measured ones, where a model has these inputs."""
    return {
        each.column: column(float, each.description, each.unit, optional=True)
        for each in FEATURES.values()
        if each.follow is not None
    }


FEATURE_COLUMNS = tuple(describe_features())
"""Columns that tables have where a model has these inputs."""

if TYPE_CHECKING:
    Name = str
else:
    Name = Literal[*FEATURES]


class ModelSettings(BaseModel, extra="forbid", frozen=True, strict=True, allow_inf_nan=False):
    """Config group ``model``."""

    inputs: Annotated[list[Name], Field(min_length=1)]
    constants: InputConstants

    @model_validator(mode="after")
    def _name_once(self) -> Self:
        names = list(dict.fromkeys(self.inputs))
        if names != self.inputs:
            raise ValueError(f"inputs: expected each once, got {self.inputs}; set model.inputs=[{','.join(names)}]")
        return self

    @property
    def features(self) -> list[Feature]:
        """The inputs, in the order of the model's vector."""
        return [FEATURES[name] for name in self.inputs]

    @property
    def pressure_inputs(self) -> tuple[int, ...]:
        """Places in the vector of the inputs that follow from pressure alone."""
        return tuple(place for place, each in enumerate(self.features) if each.of_pressure)

    def extend(self, recordings: pd.DataFrame, trial: Sequence[str]) -> pd.DataFrame:
        """Return recordings with a column for each feature that is not measured.

        Rows are those of `RECORDING_COLUMNS`, in the order of time in each trial, which the columns `trial` name, and
        muscle.
        """
        asked = [each for each in self.features if each.follow is not None]
        if not asked:
            return recordings
        told = {each.column: np.empty(len(recordings)) for each in asked}
        for rows in recordings.groupby([*trial, "muscle"], sort=False).indices.values():
            signals = {name: recordings[name].to_numpy()[rows] for name in ("time_s", *MODEL_INPUTS)}
            step_s = float(np.median(np.diff(signals["time_s"])))
            for each in asked:
                assert each.follow is not None
                told[each.column][rows] = each.follow(signals, step_s, self.constants)
        return recordings.assign(**told)


def _refuse_features(model: ModelSettings) -> ModelSettings:
    if [each.column for each in model.features] != list(MODEL_INPUTS):
        raise ValueError(
            "expected the inputs pressure, contraction, contraction_velocity, which the paper's analyses take, "
            f"got {', '.join(model.inputs)}; set model=paper"
        )
    return model


MeasuredInputs = Annotated[ModelSettings, AfterValidator(_refuse_features)]
"""A model of what is measured now, in the paper's order."""
