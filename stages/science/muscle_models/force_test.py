"""A set of recordings whose force no model has seen the whole of: what every model's error is measured on.

Rows of a bank flow in; error rates of all muscles' models flow out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from stages.science.gp.marginal import MarginalGP
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.measures import error_rate
from stages.science.signals.scaling import MODEL_OUTPUT, Array, Scaling


@dataclass(frozen=True)
class ForceTest:
    """Standardised inputs (N, D) and measured forces (N,) of every muscle, and the table that they come from."""

    name: str
    scalings: list[Scaling]
    inputs: tuple[Array, ...]
    forces_n: tuple[Array, ...]

    @classmethod
    def read(cls, name: str, recordings: pd.DataFrame, muscles: MuscleSet) -> ForceTest:
        """Gather recordings by muscle."""
        rows = [recordings[recordings["muscle"] == each] for each in muscles.names]
        return cls(
            name,
            muscles.scalings,
            tuple(scaling.inputs_of(its) for scaling, its in zip(muscles.scalings, rows, strict=True)),
            tuple(its[MODEL_OUTPUT].to_numpy() for its in rows),
        )

    @property
    def largest_n(self) -> list[float]:
        """Largest force of each muscle, N, by which error rates are divided."""
        return [float(each.max()) for each in self.forces_n]

    def error_rates(self, models: Sequence[MarginalGP]) -> list[float]:
        """Return the RMSE of each muscle's model over the muscle's largest force."""
        return [
            error_rate(scaling.restore_force(model.predict_mean(inputs)), force)
            for model, scaling, inputs, force in zip(models, self.scalings, self.inputs, self.forces_n, strict=True)
        ]
