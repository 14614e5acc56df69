"""The error to be expected where models are wanted, with its interval: what an experiment ends by.

What models expect of themselves over the task, and what they expected and what was measured in each executed trial when
its points were left out, flow in; a distribution of the error rate on the task flows out. Models whose inputs do not
tell all that force depends on are surer than they may be: how much, the trials left out tell. The ratio of measured to
expected error is taken as log-normal, alike in trials and on the task. Its next value is predicted from those of K
trials by Student's t: the predictive distribution of a normal sample whose mean has a flat prior and whose variance an
inverse gamma one (Gelman et al., Bayesian Data Analysis, 2013, section 3.3). Without the latter, two trials that happen
to agree would end an experiment.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy
from pydantic import BaseModel, PositiveFloat, PositiveInt

from stages.science.gp.expected_error import expect_error, leave_trials_out
from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import place_evenly
from stages.science.signals.scaling import Array

SAMPLES = 50
"""Of a trial that is left out, evenly: a force changes little within a fiftieth of a trial."""
LEVEL = 0.95
"""Of intervals."""


class Spread(BaseModel, extra="forbid", frozen=True, strict=True, allow_inf_nan=False):
    """The SD of the logarithm of measured over expected errors before any trial, and how many trials it counts for."""

    log_sd: PositiveFloat
    trials: PositiveInt

    def freedom(self, trials: int) -> int:
        """Return the degrees of freedom once so many trials were left out."""
        return self.trials + trials - 1

    def reach(self, trials: int) -> float:
        """Return the half width of an interval, in scales of the ratio's logarithm."""
        return float(scipy.special.stdtrit(self.freedom(trials), 0.5 + 0.5 * LEVEL))

    def probability_below(self, limit: float, median: float, high: float, trials: int) -> float:
        """Return how probable an error rate below a limit is, by its median and the upper end of its interval."""
        scales = np.log(limit / median) / np.log(high / median) * self.reach(trials)
        return float(scipy.special.stdtr(self.freedom(trials), scales))


@dataclass(frozen=True)
class ErrorForecast:
    """The error rate on the task, averaged over muscles: log-normal, told by K trials that were left out.

    Parameters
    ----------
    expected, rates : (M,) float arrays
        What each muscle's model expects, in standard units, and the factor that makes it an error rate.
    left_out : (K, 2) float array
        Error rates of the trials, averaged over muscles: expected and measured.
    spread : Spread
        Of the ratio between the two, before any trial.
    """

    expected: Array
    rates: Array
    left_out: Array
    spread: Spread

    @property
    def _ratios(self) -> Array:
        return np.log(self.left_out[:, 1] / self.left_out[:, 0])

    @property
    def _scale(self) -> float:
        """Of the logarithm's next value."""
        squares = self.spread.trials * self.spread.log_sd**2 + np.square(self._ratios - self._ratios.mean()).sum()
        return float(np.sqrt(squares / self.spread.freedom(len(self.left_out)) * (1.0 + 1.0 / len(self.left_out))))

    @property
    def median(self) -> float:
        """Of the error rate."""
        return self.after(np.zeros(len(self.expected)))

    def after(self, gains: Array) -> float:
        """Return the median once so much, (M,), is taken from each muscle's mean variance over the task."""
        left = np.sqrt(np.maximum(np.square(self.expected) - gains, 0.0))
        return float(np.mean(self.rates * left) * np.exp(self._ratios.mean()))

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the error rate's 95 % interval."""
        reach = np.exp(self.spread.reach(len(self.left_out)) * self._scale)
        return float(self.median / reach), float(self.median * reach)

    def probability_below(self, limit: float) -> float:
        """Return how probable an error rate below a limit is."""
        return self.spread.probability_below(limit, self.median, self.interval[1], len(self.left_out))


Seen = Sequence[tuple[Array, Array]]
"""Standardised inputs, (S, D), and outputs, (S,), of each muscle in a trial."""


def thin(samples: pd.DataFrame, muscles: MuscleSet) -> Seen:
    """Return samples of each muscle in an executed trial, evenly spread, for `forecast_error`."""
    inputs, outputs = muscles.standardise(samples)
    rows = [place_evenly(min(SAMPLES, len(each)), len(each)) for each in outputs]
    return [(x[own], y[own]) for x, y, own in zip(inputs, outputs, rows, strict=True)]


def forecast_error(
    models: Sequence[MarginalGP],
    tasks: Sequence[Array],
    muscles: MuscleSet,
    points: pd.DataFrame,
    executed: Sequence[Seen],
    spread: Spread,
) -> ErrorForecast:
    """Return the error rate to be expected on the task.

    Parameters
    ----------
    models, tasks : sequences over M muscles of MarginalGP and of (Q, D) float arrays
        Models after K trials, and standardised inputs that they are wanted for.
    muscles : MuscleSet
        Names and scalings.
    points : DataFrame
        Rows of the table `points`, those of a muscle in the order of its model's.
    executed : sequence over K trials
        What `thin` returns of their recordings, trial 1 first.
    spread : Spread
        Of measured over expected errors, before any trial.
    """
    expected, rates, left_out = [], [], []
    for m, (name, scaling, model) in enumerate(zip(muscles.names, muscles.scalings, models, strict=True)):
        trials = points.loc[points["muscle"] == name, "trial"].to_numpy() - 1
        samples = [seen[m] for seen in executed]
        force = scaling.restore_force(model.predict_mean(tasks[m]))
        rates.append(float(np.ptp(scaling.restore_force(np.array([0.0, 1.0])))) / float(np.abs(force).max()))
        expected.append(expect_error(model, tasks[m]))
        left_out.append(rates[-1] * leave_trials_out(model, trials, samples))
    return ErrorForecast(np.array(expected), np.array(rates), np.mean(left_out, axis=0), spread)
