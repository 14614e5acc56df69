"""A learned map: what no named effect explains of a channel, as a sparse Gaussian process of named signals.

Signals by name flow in; what is added to the channel flows out. Away from what it was learnt from it fades to zero. It
is no effect: it has no cause, no parameter with a meaning, and no source but the data.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from stages.science.plant.declaration import Declared
from stages.science.plant.effect import ChainEffect, Signal, State
from stages.science.signals.histories import HISTORIES, find_signal
from stages.science.signals.trajectories import Array

TIME, SESSION_TIME = "time_s", "start_s"
"""What times since the start of a trial and of the session are called."""
MUSCLE_PACE_S = 1.0
"""Time scale by which histories of a muscle's signals are told, s."""
Kind = Literal["learned_static", "learned_memory", "learned_session"]
ADDED_TO: Mapping[str, Signal] = {"pressure_kpa": "pressure_kpa", "force_n": "force_n"}
"""By channel of a muscle, the signal that a map of it adds to."""
DRIVES: Mapping[str, str] = {"pressure_kpa": "pressure_command_kpa", "force_n": "pressure_kpa"}
"""By channel of a muscle, what drives it; of a neighbour, the name follows the neighbour's."""


class LearnedInput(Declared):
    """One input of a map: a signal, or its history, less its middle, over its spread."""

    name: str
    middle: float = Field(description="its mean where the map was learnt, in its unit")
    spread: float = Field(gt=0.0, description="its standard deviation there, in its unit")
    length: float = Field(gt=0.0, description="length scale of the kernel, in spreads")
    low: float = Field(description="its least value there, in its unit; below it the map fades to zero")
    high: float = Field(description="its largest value there, in its unit; above it the map fades to zero")

    @model_validator(mode="after")
    def _begin_below(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low: expected at most high ({self.high}), got {self.low}")
        return self

    def hold(self, values: Array) -> tuple[Array, Array]:
        """Return values moved into the range where the map was learnt, standardised, and how far they were, in widths.

        A width is a length, or a spread where that is less: a map that does not depend on an input fades along it too.
        """
        held = np.clip(values, self.low, self.high)
        return (held - self.middle) / self.spread, (values - held) / (self.spread * min(self.length, 1.0))


class LearnedMap(Declared):
    """Squared exponential bumps at the points, times weights: the mean of a sparse Gaussian process.

    Only where it was learnt: beyond an input's range it is what it is at the range's end, times a normal bell of the
    distance, and nowhere beyond the values that it had.
    """

    channel: str
    element: str = Field(description="muscle, or name of the machine")
    inputs: list[LearnedInput] = Field(min_length=1)
    deviation: float = Field(ge=0.0, description="standard deviation of what it leaves, in the channel's unit")
    lowest: float = Field(description="least value that it had where it was learnt, in the channel's unit")
    highest: float = Field(description="largest value that it had there, in the channel's unit")
    points: list[list[float]] = Field(description="places of the bumps, standardised, one of each input")
    weights: list[float] = Field(min_length=1, description="of the bumps, in the channel's unit")

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if len(self.points) != len(self.weights) or any(len(each) != len(self.inputs) for each in self.points):
            raise ValueError(
                f"points: expected {len(self.weights)} (one for each weight) of {len(self.inputs)} numbers (one for "
                "each input)"
            )
        return self

    @property
    def kind(self) -> Kind:
        """What it tells its values from: the present alone, the past, or the time."""
        names = [each.name for each in self.inputs]
        if {TIME, SESSION_TIME} & set(names):
            return "learned_session"
        past = any(name.startswith(tuple(f"{each} " for each in HISTORIES)) for name in names)
        return "learned_memory" if past else "learned_static"

    def evaluate(self, signals: Mapping[str, Array]) -> Array:
        """Return what is added to the channel, in its unit, of its inputs by name, which have one shape.

        A `ValueError` tells an input that is not among the signals.
        """
        for each in self.inputs:
            if each.name not in signals:
                raise ValueError(
                    f"the learned map of {self.channel} is told from '{each.name}', which is not known here; known are "
                    f"{', '.join(signals)}; take the map out of the plant with plant.learned=[]"
                )
        held, away = zip(*(each.hold(signals[each.name]) for each in self.inputs), strict=True)
        lengths = [each.length for each in self.inputs]
        added = np.zeros_like(held[0])
        for point, weight in zip(self.points, self.weights, strict=True):
            places = zip(held, point, lengths, strict=True)
            added += weight * np.exp(-0.5 * sum(((values - at) / length) ** 2 for values, at, length in places))
        return np.asarray(np.clip(added, self.lowest, self.highest) * np.exp(-0.5 * sum(each**2 for each in away)))

    def share_outside(self, signals: Mapping[str, Array], present: NDArray[np.bool_]) -> float:
        """Return the share of the samples present at which an input is beyond the range where the map was learnt."""
        beyond = [(signals[each.name] < each.low) | (signals[each.name] > each.high) for each in self.inputs]
        return float(np.logical_or.reduce(beyond)[present].mean()) if present.any() else 0.0


def act_on_muscle(learned: LearnedMap, muscles: Sequence[str]) -> ChainEffect:
    """Return a map of a muscle's channel as an effect on the columns of all muscles, copies of them one after another.

    It adds the map to the simulated signal of its muscle, and looks at what drives the others.
    """
    own, inputs = list(muscles).index(learned.element), [each.name for each in learned.inputs]

    def apply(values: Array, state: State, _: Mapping[str, float]) -> Array:
        place = np.arange(values.shape[1]) % len(muscles)
        beside = {
            f"{name} {DRIVES[learned.channel]}": state.command_kpa[:, place == k] for k, name in enumerate(muscles)
        }
        signals = beside | list_muscle_signals(learned.channel, state.select(place == own))
        told = {name: find_signal(name, signals, state.step_s, MUSCLE_PACE_S) for name in inputs}
        changed = values.copy()
        changed[:, place == own] += learned.evaluate(told)
        return changed

    return ChainEffect(
        name=learned.kind,
        form="gaussian process",
        site="muscle" if learned.channel == "force_n" else "pressure",
        signal=ADDED_TO[learned.channel],
        parameters=(),
        source="learnt from the recorded data",
        signature="What no named effect explains.",
        split_by="",
        apply=apply,
    )


def list_muscle_signals(channel: str, state: State) -> dict[str, Array]:
    """Return the signals of a muscle, (T, K), from which a map of one of its channels may be told, by name."""
    within = np.repeat(state.time_s[:, None], len(state.start_s), axis=1)
    times = {TIME: within, SESSION_TIME: within + state.start_s}
    drive = {DRIVES[channel]: state.command_kpa}
    rate = np.gradient(state.command_kpa, state.step_s, axis=0)
    if channel == "pressure_kpa":
        return {**drive, "command_rate": rate, **times}
    own = {"contraction": state.contraction, "contraction_velocity_per_s": state.velocity_per_s}
    return {**drive, **own, "pressure_rate": rate, **times}
