"""Inputs of the models and the constants of their memory, by the evidence of executed trials.

Executed trials, the places of the models' points in them, and the bank flow in; models of all muscles flow out for each
choice that is tried, and its score: the sum of their log evidence. A machine's muscles share inputs and constants, so
that all points of all muscles speak for one choice.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import MarginalGP, fit
from stages.science.muscle_models.inputs import FEATURES, ModelSettings
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import Array, Scaling

CONSTANTS = tuple(dict.fromkeys(each.constant for each in FEATURES.values() if each.constant))
MOST_OCTAVES = 6.0
STARTS = 8
"""Of the last models' searches, which are few."""
Key = tuple[str, int, str]
"""Participant, experiment and muscle."""


class Choice(NamedTuple):
    """Names of a model's inputs, and how far each of `CONSTANTS` is above the assumed one, octaves."""

    inputs: tuple[str, ...]
    octaves: tuple[float, ...]

    def apply(self, model: ModelSettings) -> ModelSettings:
        """Return the settings of a model with these inputs, and with constants by its own."""
        own = zip(CONSTANTS, self.octaves, strict=True)
        scaled = {name: getattr(model.constants, name) * 2.0**octaves for name, octaves in own}
        constants = model.constants.model_copy(update=scaled)
        return model.model_copy(update={"inputs": list(self.inputs), "constants": constants})

    @property
    def used(self) -> list[str]:
        """The constants that the inputs depend on."""
        return [name for name in CONSTANTS if any(FEATURES[each].constant == name for each in self.inputs)]

    def list_moves(self, step: float) -> Iterator["Choice"]:
        """Yield the choices in which one constant in use is a step lower or higher, octaves."""
        for name in self.used:
            place = CONSTANTS.index(name)
            for moved in (self.octaves[place] - step, self.octaves[place] + step):
                if abs(moved) <= MOST_OCTAVES:
                    yield self._replace(octaves=(*self.octaves[:place], moved, *self.octaves[place + 1 :]))

    def list_toggles(self) -> Iterator[tuple[str, "Choice"]]:
        """Yield each input that is not measured, and the choice in which it is left out or added.

        A constant that is no longer in use is as assumed again: an input that needs it later begins there.
        """
        for name in [name for name, each in FEATURES.items() if each.follow is not None]:
            kept = {*self.inputs} ^ {name}
            if not kept:
                continue  # a model has an input
            toggled = self._replace(inputs=tuple(each for each in FEATURES if each in kept))
            own = zip(CONSTANTS, self.octaves, strict=True)
            yield name, toggled._replace(octaves=tuple(each * (constant in toggled.used) for constant, each in own))


@dataclass(frozen=True)
class Fitted:
    """A muscle's model in an experiment, the names of its inputs, and their scaling."""

    inputs: tuple[str, ...]
    scaling: Scaling
    model: MarginalGP

    @property
    def log_evidence(self) -> float:
        """Log marginal likelihood over the hyperparameters, by Laplace's approximation (nats; MacKay 1992)."""
        spread = np.linalg.slogdet(2.0 * np.pi * self.model.laplace.covariance)[1]
        return float(self.model.log_posterior + 0.5 * spread)


Models = dict[Key, Fitted]
Job = tuple["Evidence", Choice, Models, np.random.Generator]
Spread = Callable[[Callable[[Job], Models], Sequence[Job]], Iterable[Models]]


@dataclass(frozen=True)
class Evidence:
    """What a model is chosen by.

    `bank` has the movements, for the inputs' scales at the `times_s` of the candidates; `executed` has the trials,
    numbered in a column `trial`; `rows` are the places of each model's points in `executed`, (N,); `recorded` is what
    the assumed models of each muscle share, and `log_length` mean and variance of the hyperprior of an added input's;
    `designed` has the hyperparameters, (P,), at which trials were chosen.
    """

    model: ModelSettings
    bank: pd.DataFrame
    times_s: Array
    executed: pd.DataFrame
    rows: Mapping[Key, NDArray[np.intp]]
    recorded: Mapping[str, RecordedModels]
    log_length: tuple[float, float]
    designed: Mapping[Key, Array] = field(default_factory=dict)

    def fit(
        self, choice: Choice, near: Mapping[Key, Fitted], generator: np.random.Generator, starts: int = 0
    ) -> Models:
        """Return all models of a choice.

        Each search begins at the hyperprior's mean, at so many draws from it, and where the model `near` is, or where
        the design's was.
        """
        model = choice.apply(self.model)
        bank = leave_out_lead_in(model.extend(self.bank, ["trajectory"]))
        bank = bank[bank["time_s"].isin(self.times_s)]
        columns = [each.column for each in model.features]
        along = {str(name): its[columns].to_numpy() for name, its in bank.groupby("muscle", sort=False)}
        executed = model.extend(self.executed, ["trial"])
        found = {}
        for key, rows in self.rows.items():
            recorded, points = self.recorded[key[-1]], executed.iloc[rows]
            spread = along[key[-1]].std(axis=0)
            scaling = replace(
                recorded.scaling,
                inputs=tuple(columns),
                input_centre=along[key[-1]].mean(axis=0),
                input_scale=np.where(spread > 0.0, spread, 1.0),
            )
            prior = self._extend_prior(recorded.prior, choice)
            begun = [(near[key].inputs, near[key].model.theta)] if key in near else []
            begun += [(tuple(self.model.inputs), self.designed[key])] if key in self.designed and not begun else []
            warm = [_carry_over(*each, choice, prior) for each in begun]
            data = scaling.inputs_of(points), scaling.output_of(points), prior, recorded.mean
            found[key] = Fitted(
                choice.inputs, scaling, fit(*data, generator=generator, starts=starts, warm_starts=warm)
            )
        return found

    def _extend_prior(self, prior: Hyperprior, choice: Choice) -> Hyperprior:
        assumed = self.model.inputs
        rows = dict(zip(assumed, zip(prior.mean, prior.variance, strict=False), strict=False))
        mean, variance = np.transpose([rows.get(name, self.log_length) for name in choice.inputs])
        rest = len(assumed)
        return Hyperprior(np.append(mean, prior.mean[rest:]), np.append(variance, prior.variance[rest:]))


def _carry_over(inputs: Sequence[str], theta: Array, choice: Choice, prior: Hyperprior) -> Array:
    """Return the hyperparameters of a model with some other inputs; new ones are at the hyperprior's mean."""
    known = dict(zip(inputs, theta, strict=False))
    lengths = [known.get(name, mean) for name, mean in zip(choice.inputs, prior.mean, strict=False)]
    return np.append(lengths, theta[len(inputs) :])


@dataclass(frozen=True)
class Selected:
    """The best choice, the score of each that was tried (nats), the first one first, and the models of these two."""

    best: Choice
    scores: Mapping[Choice, float]
    assumed: Mapping[Key, Fitted]
    fitted: Mapping[Key, Fitted]

    @property
    def first(self) -> Choice:
        """The choice that was assumed."""
        return next(iter(self.scores))

    @property
    def gain(self) -> float:
        """How much the best score is above that of what was assumed (nats)."""
        return self.scores[self.best] - self.scores[self.first]

    def refit(self, evidence: Evidence, generator: np.random.Generator) -> Self:
        """Return the same with both models fitted to the points of other evidence."""
        assumed = evidence.fit(self.first, {}, generator, STARTS)
        return replace(self, assumed=assumed, fitted=evidence.fit(self.best, self.fitted, generator, STARTS))


def select_model(
    evidence: Evidence,
    spread_octaves: float,
    steps_octaves: Sequence[float],
    generator: np.random.Generator,
    told: Callable[[Choice], None] = lambda choice: None,
    spread: Spread = map,
) -> Selected:
    """Return the inputs and constants for which there is most evidence.

    A pattern search (Hooke and Jeeves 1961): from the best choice, each constant is tried a step lower and higher;
    where none is better, each input that is not measured is left out or added; then the next step is taken.

    Parameters
    ----------
    evidence : Evidence
        Points of all models.
    spread_octaves : float
        Standard deviation of a constant's log-normal prior about the assumed value, octaves. Sets of inputs are alike
        beforehand.
    steps_octaves : sequence of float
        Steps, the longest first, octaves.
    generator : Generator
        Of the searches for maxima, which draw no starts.
    told : callable
        Gets each choice when it has been tried.
    spread : callable
        Calls a function with each of several jobs, in order, as `map` does.
    """
    here = Choice(tuple(name for name in FEATURES if name in evidence.model.inputs), (0.0,) * len(CONSTANTS))
    scores: dict[Choice, float] = {}
    assumed: Models = {}
    best: Models = {}

    def look(choices: Sequence[Choice]) -> bool:
        nonlocal here, best, assumed
        begun, new = here, [each for each in choices if each not in scores]
        for choice, models in zip(new, spread(_fit, [(evidence, each, best, generator) for each in new]), strict=True):
            prior = -0.5 * sum((each / spread_octaves) ** 2 for each in choice.octaves)
            scores[choice] = sum(each.log_evidence for each in models.values()) + prior
            assumed = assumed or models
            if scores[choice] >= max(scores.values()):
                here, best = choice, models
            told(choice)
        return here != begun

    look([here])
    for step in steps_octaves:
        while look([*here.list_moves(step)]) or look([each for _, each in here.list_toggles()]):
            pass
    return Selected(here, scores, assumed, best)


def _fit(job: Job) -> Models:
    evidence, choice, near, generator = job
    return evidence.fit(choice, near, generator)
