"""An output channel: one channel of one element, simulated from measured upstream signals, trial by trial.

An output channel knows its measured signal, the constants of its nominal model and which effects can act in it; given
values for all of these it simulates. Nothing else of the workflow knows what machine it looks at.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from stages.science.plant.declaration import Declared
from stages.science.plant.effect import NamedEffect, Parameter
from stages.science.recording.signal_names import label
from stages.science.signals.trajectories import Array

MOST_STARTS = 12


class DetectionSettings(Declared):
    """From where on measured values show something by themselves: saturation, quantisation, spectral lines, noise."""

    saturation_share: float = Field(gt=0.0, lt=1.0)
    saturation_samples: int = Field(ge=2)
    saturation_ratio: float = Field(ge=1.0)
    quantised_share: float = Field(gt=0.0, lt=1.0)
    quantised_deviation: float = Field(gt=0.0, lt=0.5)
    lowest_line_hz: float = Field(gt=0.0)
    line_chance: float = Field(gt=0.0, lt=1.0)
    calm_gap: float = Field(ge=1.0)
    least_white: float = Field(ge=0.0, le=1.0)
    least_white_share: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True)
class Counts:
    """A sensor's counts, which its values show: the form that rounds to them, its parameters, the step."""

    form: NamedEffect
    parameters: Mapping[str, float]
    step: float
    """In the channel's unit."""
    averaged_out: float
    """Mean square of the sensor's white noise that the channel, whose samples are means of several, lacks."""


Placed = Sequence[tuple[NamedEffect, Mapping[str, float]]]
"""Effects with their parameters."""
Case = tuple[Mapping[str, float], Placed]
"""Constants by name, and effects."""
Task = TypeVar("Task")
Done = TypeVar("Done")


class Divide(Protocol):
    """Computes ``work(task)`` for each of independent tasks, in order; results hold the objects `kept` themselves."""

    def __call__(
        self, work: Callable[[Task], Done], tasks: Sequence[Task], /, kept: Iterable[object] = ()
    ) -> list[Done]:
        """Return the results, computed wherever it be."""


def compute_here(work: Callable[[Task], Done], tasks: Sequence[Task], kept: Iterable[object] = ()) -> list[Done]:
    """Return the results of all tasks, computed one after the other."""
    return [work(each) for each in tasks]


def list_starts(form: NamedEffect, most: int = MOST_STARTS) -> list[dict[str, float]]:
    """Return values to begin at: all combinations of the parameters' starts, thinned evenly if there are many."""
    names = [each.name for each in form.parameters]
    grid = [dict(zip(names, chosen, strict=True)) for chosen in product(*(each.starts for each in form.parameters))]
    if len(grid) <= most:
        return grid
    return [grid[round(index)] for index in np.linspace(0, len(grid) - 1, most)]


@dataclass(frozen=True)
class Driver:
    """A measured signal, (T, K) without gaps, that may explain a residual; its name ends in its unit."""

    name: str
    values: Array
    own: bool = True
    """Whether it belongs to this element; others' get fewer features."""
    rate: bool = False
    """Whether its sign is a direction of motion."""
    unit: str = ""
    """Of its values times the factor, where the name does not tell it; figures show these."""
    factor: float = 1.0

    @property
    def shown(self) -> Array:
        """The values in that unit, (T, K)."""
        return self.values * self.factor

    @property
    def label(self) -> str:
        """What an axis of them says."""
        return label(self.name, self.unit)


class OutputChannel(ABC):
    """One channel of one element over K trials of at most T samples."""

    channel: str
    """Its name and the element's are those of the verdict, for example ``force_n`` and ``pam1``."""
    element: str
    unit: str
    step_s: float
    measured: Array
    """(T, K), without gaps; meaningless where not present."""
    present: NDArray[np.bool_]
    """Where the channel and all that it is simulated from were measured, (T, K)."""
    start_s: Array
    """Start of each trial in the session, (K,), s."""
    limits: DetectionSettings
    constants: tuple[Parameter, ...]
    """Nominal constants with bounds and priors; a fit begins at the priors' means."""
    time_scale_s: float = 1.0
    """Time of a usual movement; regimes of time and frequency are told by it."""
    resolution: float = 0.0
    """Numerical error of any simulation, in the channel's unit; the noise floor is never below it."""
    other_starts: Sequence[dict[str, float]] = ()
    """Other starting values of some constants for the nominal fit; the best fit is taken."""
    averaged: int = 1
    """Samples of the recording in one of these: more of them would tell nothing more."""
    forgotten: int = 0
    """Measured samples that are not judged, since what they are simulated from lacks values before them."""
    jitters: bool = True
    """Whether each trial may have an offset and a gain of its own, as parts of one record have not."""

    @property
    def record_start_s(self) -> Array:
        """Start of each trial in its record, (K,), s; without records, in the session."""
        return self.start_s

    @property
    @abstractmethod
    def forms(self) -> tuple[NamedEffect, ...]:
        """Effects that can act in this channel."""

    @abstractmethod
    def simulate(self, constants: Mapping[str, float], effects: Placed) -> Array:
        """Return the channel, (T, K), under constants and effects."""

    def simulate_each(self, cases: Sequence[Case]) -> Array:
        """Return the channel in several cases, (T, K, C), bit for bit as `simulate` does one after the other."""
        return np.stack([self.simulate(*case) for case in cases], axis=2)

    @abstractmethod
    def drivers(self) -> list[Driver]:
        """Return the signals from which a flexible model may explain what is left."""

    def calm(self) -> Self:
        """Return the output with drivers of which no average takes noise away that its simulation has of its inputs.

        They tell less of what is there. It is the output itself where the simulation has no noise.
        """
        return self

    def list_own(self) -> dict[str, Driver]:
        """Return its own drivers by name."""
        return {each.name: each for each in self.drivers() if each.own}

    def respond(self, features: Array) -> Array:
        """Return the features of a flexible model, (T, K, F), as this channel responds to them; here without delay.

        A channel whose effects act inside a motion returns the response of that motion to each feature.
        """
        return features

    def recall(self, most: int, answer: Array | None = None) -> Array:
        """Return delayed inputs, at most `most` columns, (T, K, F): regressors of a finite impulse response.

        Of an answer, (T, K), what that was before. There are none for a channel whose upstream signals are measured
        next to it.
        """
        return np.empty((*self.measured.shape, 0))

    def mix(self) -> Array:
        """Return products of signals and what changed in them lately, (T, K, F), as a gain has that follows late.

        There are none, as of `recall`.
        """
        return np.empty((*self.measured.shape, 0))

    @abstractmethod
    def take(self, trials: Sequence[int]) -> Self:
        """Return the output with some of its trials, by position."""

    @property
    def plane(self) -> tuple[str, str]:
        """Names of the two drivers over which residuals are drawn as a plane."""
        first, second = [driver.name for driver in self.drivers() if driver.own][:2]
        return first, second

    @property
    def loop(self) -> tuple[str, str]:
        """Names of the driver that a loop of residuals runs over, and of the rate that gives its direction."""
        own = [driver for driver in self.drivers() if driver.own]
        state, rate = (next(driver.name for driver in own if driver.rate is rate) for rate in (False, True))
        return state, rate

    def starts(self, form: NamedEffect, constants: Mapping[str, float]) -> list[dict[str, float]]:
        """Return starting values of a form's parameters; none where the data exclude the form."""
        return list_starts(form)

    def shows(self, form: NamedEffect) -> bool:
        """Return whether exactly repeated values show a form's parameters, so that its starts are used unchanged."""
        return False

    def find_past_share(self, form: NamedEffect, values: Mapping[str, float]) -> float:
        """Return the share of what a form does that does not follow from a static map's signals at the same moment."""
        return 1.0

    def find_counts(self, constants: Mapping[str, float]) -> Counts | None:
        """Return the counts of which all measured values are whole multiples, if they are."""
        return None

    def correct(self, effects: Sequence[tuple[str, str, Mapping[str, float]]]) -> Self:
        """Return the output with its inputs corrected for effects of upstream sensors; itself where there are none.

        Those are of another channel of this element: (name, form, parameters).
        """
        return self

    def told_by(self, constants: Mapping[str, float]) -> Self:
        """Return the output whose drivers are told by these constants, where drivers depend on constants; else itself.

        A learned map takes them so: the amended plant knows no others.
        """
        return self

    def can_tell(self, name: str) -> bool:
        """Return whether a simulator of this machine knows an input of `list_inputs`; here all that were measured."""
        return True

    def acting(self, effects: Placed) -> Self:
        """Return the output with the inputs that act, where effects of their sensors are among its own; else itself."""
        return self

    @property
    def levers(self) -> tuple[str, ...]:
        """Names of what drives it and could be prescribed in another trial; none where nothing does."""
        return ()

    def excite(self, shares: Mapping[str, Array]) -> Self:
        """Return the output in other trials, in which each lever runs through these shares, (T, J), of its own range.

        The ranges are those of its present trials, which no other trial leaves. What would be measured is not known.
        """
        raise NotImplementedError(f"{type(self).__name__} has no levers")

    def tell_levers(self) -> dict[str, Array]:
        """Return what its levers do in its trials, by the signal's name, which ends in its unit, (T, K)."""
        return {}

    @property
    def trials(self) -> int:
        """Number of trials, K."""
        return self.measured.shape[1]

    @property
    def independent_trials(self) -> int:
        """Number of trials that have nothing in common but the machine."""
        return self.trials

    @property
    def range(self) -> float:
        """Largest less smallest measured value; gaps are told over it."""
        values = self.measured[self.present]
        return float(np.ptp(values)) if values.size else 0.0
