"""The error to be expected where models are wanted, with its interval: what an experiment ends by.

What models expect of themselves over the task, and what they expected and what was measured in each executed trial when
its points were left out, flow in; a distribution of the error rate on the task flows out. Models whose inputs do not
tell all that force depends on are surer than they may be: how much, the trials left out tell. The ratio of measured to
expected error is taken as log-normal, alike in trials and on the task, and its next value is predicted from those of K
trials by Student's t (a normal sample's predictive distribution: Geisser, Predictive Inference, 1993).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from stages.science.gp.expected_error import expect_error, leave_trials_out
from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import place_evenly
from stages.science.signals.scaling import Array

SAMPLES = 50
"""Of a trial that is left out, evenly: a force changes little within a fiftieth of a trial."""
LEVEL = 0.95
"""Of intervals."""


@dataclass(frozen=True)
class ErrorForecast:
    """The error rate on the task, averaged over muscles: log-normal, told by K trials that were left out.

    Parameters
    ----------
    expected, rates : (M,) float arrays
        What each muscle's model expects, in standard units, and the factor that makes it an error rate.
    left_out : (K, 2) float array
        Error rates of the trials, averaged over muscles: expected and measured.
    """

    expected: Array
    rates: Array
    left_out: Array

    @property
    def _ratios(self) -> Array:
        return np.log(self.left_out[:, 1] / self.left_out[:, 0])

    @property
    def _scale(self) -> float:
        """Of the logarithm's next value; not a number where one trial says nothing of it."""
        count = len(self.left_out)
        return float(self._ratios.std(ddof=1) * np.sqrt(1.0 + 1.0 / count)) if count > 1 else np.nan

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
        """The ends of the error rate's 95 % interval; not numbers after one trial."""
        reach = np.exp(stats.t.ppf(0.5 + 0.5 * LEVEL, len(self.left_out) - 1) * self._scale)
        return float(self.median / reach), float(self.median * reach)

    def probability_below(self, limit: float) -> float:
        """Return how probable an error rate below a limit is; not a number after one trial."""
        return float(stats.t.cdf(np.log(limit / self.median) / self._scale, len(self.left_out) - 1))


def forecast_error(
    models: Sequence[MarginalGP],
    tasks: Sequence[Array],
    muscles: MuscleSet,
    points: pd.DataFrame,
    executed: Sequence[pd.DataFrame],
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
    executed : sequence over K trials of DataFrame
        Their recordings, trial 1 first.
    """
    standard = [muscles.standardise(each) for each in executed]
    expected, rates, left_out = [], [], []
    for m, (name, scaling, model) in enumerate(zip(muscles.names, muscles.scalings, models, strict=True)):
        trials = points.loc[points["muscle"] == name, "trial"].to_numpy() - 1
        samples = []
        for inputs, outputs in standard:
            rows = place_evenly(min(SAMPLES, len(inputs[m])), len(inputs[m]))
            samples.append((inputs[m][rows], outputs[m][rows]))
        force = scaling.restore_force(model.predict_mean(tasks[m]))
        rates.append(float(np.ptp(scaling.restore_force(np.array([0.0, 1.0])))) / float(np.abs(force).max()))
        expected.append(expect_error(model, tasks[m]))
        left_out.append(rates[-1] * leave_trials_out(model, trials, samples))
    return ErrorForecast(np.array(expected), np.array(rates), np.mean(left_out, axis=0))
