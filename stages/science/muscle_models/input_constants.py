"""Constants of the models' memory, identified together with the hyperparameters.

Executed trials, the places of the models' points in them, and the bank flow in; models of all muscles flow out for each
set of constants that is tried, and its score: the sum of their log posteriors, each at its maximum. A machine's muscles
share the constants, so that all points of all muscles speak for one set.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.gp.marginal import MarginalGP, fit
from stages.science.muscle_models.inputs import ModelSettings
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import Array, Scaling

Octaves = tuple[float, ...]
"""How far each constant is above the assumed one, in octaves, in the order of `ModelSettings.constant_names`."""
Key = tuple[str, int, str]
"""Participant, experiment and muscle."""


@dataclass(frozen=True)
class Fitted:
    """A muscle's model in an experiment, and the scaling of its inputs."""

    scaling: Scaling
    model: MarginalGP


@dataclass(frozen=True)
class Evidence:
    """What constants are identified from.

    `bank` has the movements, for the inputs' scales at the `times_s` of the candidates; `executed` has the trials,
    numbered in a column `trial`; `rows` are the places of each model's points in `executed`, (N,); `recorded` is what
    the models of each muscle share.
    """

    model: ModelSettings
    bank: pd.DataFrame
    times_s: Array
    executed: pd.DataFrame
    rows: Mapping[Key, NDArray[np.intp]]
    recorded: Mapping[str, RecordedModels]

    def fit(
        self, octaves: Octaves, near: Mapping[Key, Fitted], starts: int, generator: np.random.Generator
    ) -> dict[Key, Fitted]:
        """Return all models at one set of constants; one start of each search is where the model `near` it is."""
        model = self.model.scale(octaves)
        columns = [each.column for each in model.features if each.constant]
        bank = leave_out_lead_in(model.extend(self.bank, ["trajectory"]))
        bank = bank[bank["time_s"].isin(self.times_s)]
        along = {str(name): its[columns].to_numpy() for name, its in bank.groupby("muscle", sort=False)}
        executed = model.extend(self.executed, ["trial"])
        found = {}
        for key, rows in self.rows.items():
            recorded, points = self.recorded[key[-1]], executed.iloc[rows]
            scaling = _rescale(recorded.scaling, columns, along[key[-1]])
            warm = [near[key].model.theta] if key in near else []
            data = scaling.inputs_of(points), scaling.output_of(points), recorded.prior, recorded.mean
            found[key] = Fitted(scaling, fit(*data, generator=generator, starts=starts, warm_starts=warm))
        return found


def _rescale(scaling: Scaling, columns: Sequence[str], values: Array) -> Scaling:
    """Return a scaling in which some inputs have the centres and scales of their values along the bank, (N, C)."""
    places, spread = [scaling.inputs.index(name) for name in columns], values.std(axis=0)
    centre, scale = scaling.input_centre.copy(), scaling.input_scale.copy()
    centre[places], scale[places] = values.mean(axis=0), np.where(spread > 0.0, spread, 1.0)
    return replace(scaling, input_centre=centre, input_scale=scale)


@dataclass(frozen=True)
class Identified:
    """The best set of constants, the score of each that was tried (nats), and the models at the first and the best."""

    best: Octaves
    scores: Mapping[Octaves, float]
    assumed: Mapping[Key, Fitted]
    fitted: Mapping[Key, Fitted]


def identify_constants(
    evidence: Evidence,
    spread_octaves: float,
    steps_octaves: Sequence[float],
    starts: int,
    generator: np.random.Generator,
    told: Callable[[Octaves], None] = lambda octaves: None,
) -> Identified:
    """Return the constants at which the posterior of all models is highest.

    A pattern search (Hooke and Jeeves 1961) in octaves: from the best set, each constant is tried a step lower and
    higher; where none is better, the next step is taken. No constant leaves the assumed one by more than six spreads.

    Parameters
    ----------
    evidence : Evidence
        Points of all models.
    spread_octaves : float
        Standard deviation of a constant's log-normal prior about the assumed value, octaves.
    steps_octaves : sequence of float
        Steps, the longest first, octaves.
    starts, generator
        Starts of each search for a posterior's maximum that are drawn from the hyperprior, and what draws them.
    told : callable
        Gets each set before it is tried.
    """
    here: Octaves = (0.0,) * len(evidence.model.constant_names)
    scores: dict[Octaves, float] = {}
    assumed: dict[Key, Fitted] = {}
    best: dict[Key, Fitted] = {}
    for step in steps_octaves:
        moved = True
        while moved:
            begun = here
            for octaves in (here, *_list_neighbours(begun, step)):
                if octaves in scores or max(map(abs, octaves), default=0.0) > 6.0 * spread_octaves:
                    continue
                told(octaves)
                models = evidence.fit(octaves, best, starts, generator)
                prior = -0.5 * sum((each / spread_octaves) ** 2 for each in octaves)
                scores[octaves] = sum(each.model.log_posterior for each in models.values()) + prior
                assumed = assumed or models
                if scores[octaves] >= max(scores.values()):
                    here, best = octaves, models
            moved = here != begun
    return Identified(here, scores, assumed, best)


def _list_neighbours(octaves: Octaves, step: float) -> list[Octaves]:
    moves = [sign * step * np.eye(len(octaves))[place] for place in range(len(octaves)) for sign in (-1.0, 1.0)]
    return [tuple(map(float, np.add(octaves, move))) for move in moves]
