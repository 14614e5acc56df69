"""What is known of every muscle before anything is measured, and its models as a loop recorded them.

Rows of the tables flow in; arrays by muscle, in the order of the hyperprior, and Gaussian processes flow out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.interaction import Design, Interaction
from stages.science.gp.marginal import MarginalGP, condition
from stages.science.signals.scaling import MODEL_OUTPUT, Array, Scaling

CONSTANT_MEAN = "constant_mean"
WHO = ["participant", "experiment"]
Arrays = tuple[Array, ...]


@dataclass(frozen=True)
class MuscleSet:
    """What a loop knows of every muscle before it begins, in the order of the hyperprior table.

    The muscles' names, the hyperparameters of each one's model, the R movements of the bank; and by muscle the scaling,
    Table 1 and the standardised inputs along each movement, (R, T, D).
    """

    names: list[str]
    hyperparameters: list[str]
    trajectories: list[int]
    scalings: list[Scaling]
    priors: list[Hyperprior]
    candidates: list[Array]

    @classmethod
    def read(cls, candidates: pd.DataFrame, hyperprior: pd.DataFrame, scaling: pd.DataFrame) -> MuscleSet:
        """Gather the tables by muscle."""
        names = list(hyperprior["muscle"].unique())
        trajectories = [int(each) for each in candidates["trajectory"].unique()]
        recorded = [RecordedModels.read(hyperprior, scaling, name) for name in names]
        priors, scalings = [each.prior for each in recorded], [each.scaling for each in recorded]
        hyperparameters = list(hyperprior.loc[hyperprior["muscle"] == names[0], "hyperparameter"])
        known = cls(names, hyperparameters, trajectories, scalings, priors, [])
        along = [each.reshape(len(trajectories), -1, each.shape[1]) for each in known.inputs_of(candidates)]
        return replace(known, candidates=along)

    @property
    def mean(self) -> str:
        """``constant`` if Table 1 has a row for the models' constant mean, else ``zero``."""
        return _name_mean(self.hyperparameters)

    def indices(self, trajectories: Sequence[int]) -> list[int]:
        """Return the positions of movements in the bank."""
        return [self.trajectories.index(each) for each in trajectories]

    def inputs_of(self, samples: pd.DataFrame) -> list[Array]:
        """Return each muscle's standardised inputs (N, D) from rows with a muscle column."""
        muscles = zip(self.names, self.scalings, strict=True)
        return [scaling.inputs_of(samples[samples["muscle"] == name]) for name, scaling in muscles]

    def standardise(self, samples: pd.DataFrame) -> tuple[list[Array], list[Array]]:
        """Return each muscle's inputs (N, D) and outputs (N,) from rows with a muscle column."""
        samples = samples[["muscle", *self.scalings[0].inputs, MODEL_OUTPUT]]
        own = [(each, samples[samples["muscle"] == name]) for name, each in zip(self.names, self.scalings, strict=True)]
        return [scaling.inputs_of(rows) for scaling, rows in own], [scaling.output_of(rows) for scaling, rows in own]

    def resume(
        self,
        design: Design,
        used: Sequence[int],
        points: pd.DataFrame,
        models: pd.DataFrame,
        tasks: Sequence[Array] = (),
    ) -> Interaction:
        """Return what is known after the last trial of one experiment and arm, by what was left on disk.

        Parameters
        ----------
        design : Design
            How the next movement is chosen.
        used : sequence of int
            Movements that were executed, the initial trials' too.
        points, models : DataFrame
            This experiment's and arm's rows of the tables of these names; of `models`, the last trial's are taken.
        tasks : sequence over M muscles of (Q, D) float arrays
            Standardised inputs that the models are wanted for, where the design asks for them.
        """
        return Interaction(design, *self.recall(used, points, models), tuple(tasks))

    def recall(
        self, used: Sequence[int], samples: pd.DataFrame, models: pd.DataFrame
    ) -> tuple[Arrays, tuple[Hyperprior, ...], Arrays, Arrays, Arrays, frozenset[int]]:
        """Return what a `Knowledge` takes after its design: candidates to used movements; see `resume`."""
        inputs, outputs = self.standardise(samples)
        latest = models[models["trial"] == models["trial"].max()]
        thetas = tuple(latest.loc[latest["muscle"] == name, "value"].to_numpy() for name in self.names)
        known = tuple(self.candidates), tuple(self.priors), tuple(inputs), tuple(outputs), thetas
        return *known, frozenset(self.indices(used))


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
        return cls(prior, _name_mean(rows["hyperparameter"]), Scaling.of_muscle(scaling, muscle))

    def rebuild(self, model: pd.DataFrame, points: pd.DataFrame) -> MarginalGP:
        """Return a model as it stood after a trial, from this muscle's rows of one experiment and arm.

        `model` are those of the table `models` after one trial, `points` those of the table `points` of this trial and
        earlier ones at least; those of later trials are left out. A `ValueError` tells rows of `model` of several
        trials, or of none.
        """
        trials = [int(each) for each in model["trial"].unique()]
        if len(trials) != 1:
            raise ValueError(f"model: expected the rows of one trial, got those of trials {trials}")
        known = points[points["trial"] <= trials[0]]
        inputs, force = self.scaling.inputs_of(known), self.scaling.output_of(known)
        return condition(inputs, force, model["value"].to_numpy(), self.prior, mean=self.mean)


@dataclass(frozen=True, eq=False)
class ExperimentModels:
    """All models of a muscle in one experiment, as a loop recorded them: their rows of `models` and `points`."""

    participant: str
    experiment: int
    muscle: str
    recorded: RecordedModels
    models: pd.DataFrame
    points: pd.DataFrame

    @classmethod
    def split(
        cls, recorded: Mapping[str, RecordedModels], models: pd.DataFrame, points: pd.DataFrame
    ) -> dict[str, ExperimentModels]:
        """Return the models of every muscle in every experiment, by a note of which they are."""
        found = {}
        for muscle, its in recorded.items():
            its_points = dict[Any, pd.DataFrame](list(points[points["muscle"] == muscle].groupby(WHO, sort=False)))
            for key, its_models in models[models["muscle"] == muscle].groupby(WHO, sort=False):
                where = str(key[0]), int(str(key[1])), muscle
                found["{} experiment {} {}".format(*where)] = cls(*where, its, its_models, its_points[key])
        return found

    def measure(self, tell: Callable[[MarginalGP], Iterable[tuple[Any, ...]]]) -> list[tuple[Any, ...]]:
        """Return participant, experiment, arm, trial and a row of what is told of a model, for all arms and trials."""
        points_of = dict[Any, pd.DataFrame](list(self.points.groupby("arm", sort=False)))
        found: dict[bytes, list[tuple[Any, ...]]] = {}
        rows: list[tuple[Any, ...]] = []
        for (arm, trial), model in self.models.groupby(["arm", "trial"], sort=False):
            gp = self.recorded.rebuild(model, points_of[arm])
            if gp.identity not in found:  # arms share the model of the initial data
                found[gp.identity] = list(tell(gp))
            rows += [(self.participant, self.experiment, arm, trial, *told) for told in found[gp.identity]]
        return rows


def _name_mean(hyperparameters: Iterable[str]) -> str:
    return "constant" if CONSTANT_MEAN in set(hyperparameters) else "zero"
