"""Models as the tables hold them: what a loop recorded of one muscle flows in, its Gaussian processes flow out."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.marginal import MarginalGP, condition
from stages.science.muscle_models.muscle_set import CONSTANT_MEAN
from stages.science.signals.scaling import Scaling


@dataclass(frozen=True)
class RecordedModels:
    """What the models of one muscle share, whatever they learned from: Table 1, ``zero`` or ``constant``, a scaling."""

    prior: Hyperprior
    mean: str
    scaling: Scaling

    @classmethod
    def read(cls, hyperprior: pd.DataFrame, scaling: pd.DataFrame, muscle: str) -> RecordedModels:
        """Read a muscle's rows of the tables `hyperprior` and `scaling`."""
        rows = hyperprior[hyperprior["muscle"] == muscle]
        prior = Hyperprior(rows["mean"].to_numpy(), rows["variance"].to_numpy())
        mean = "constant" if CONSTANT_MEAN in set(rows["hyperparameter"]) else "zero"
        return cls(prior, mean, Scaling.of_muscle(scaling, muscle))

    def rebuild(self, model: pd.DataFrame, points: pd.DataFrame) -> MarginalGP:
        """Return a model as it stood after a trial.

        Parameters
        ----------
        model : DataFrame
            Rows of the table `models` of this muscle in one experiment and arm, after one trial.
        points : DataFrame
            Rows of the table `points` of this muscle in the same experiment and arm, of this trial and earlier ones at
            least; those of later trials are left out.

        Raises
        ------
        ValueError
            When the rows of `model` are those of several trials, or of none.
        """
        trials = [int(each) for each in model["trial"].unique()]
        if len(trials) != 1:
            raise ValueError(f"model: expected the rows of one trial, got those of trials {trials}")
        known = points[points["trial"] <= trials[0]]
        inputs, force = self.scaling.inputs_of(known), self.scaling.output_of(known)
        return condition(inputs, force, model["value"].to_numpy(), self.prior, mean=self.mean)
