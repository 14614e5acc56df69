"""A grey box: the force of a muscle as that of a physical plant and a Gaussian process of what the plant leaves.

A muscle's points with the plant's force at each flow in; a model flows out that takes inputs together with the plant's
force there. The process has the inputs, the hyperprior and the scales of the model of the force itself, but no centre:
where the plant's force is the truth, the residual is noise about zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from stages.science.gp.marginal import MarginalGP, fit
from stages.science.muscle_models.muscle_set import RecordedModels
from stages.science.signals.scaling import MODEL_OUTPUT, Array, Scaling


@dataclass(frozen=True)
class GreyBox:
    """A plant's force as the mean of a muscle's model, and a Gaussian process of the residual in standard units."""

    scaling: Scaling
    residual: MarginalGP

    @classmethod
    def identify(
        cls,
        recorded: RecordedModels,
        points: pd.DataFrame,
        plant_n: Array,
        generator: np.random.Generator,
        starts: int,
        warm_starts: Sequence[Array] = (),
    ) -> GreyBox:
        """Return the model at the MAP of its hyperparameters, of Table 1 and the scaling of the muscle.

        Of the samples that it stands on, rows of the table `points`, `plant_n`, (N,), is the plant's force, N. The rest
        is of the search for the maximum, as `fit` takes it.
        """
        known = leave_residual(recorded.scaling, points, plant_n)
        search: dict[str, Any] = {"generator": generator, "starts": starts, "warm_starts": warm_starts}
        return cls(recorded.scaling, fit(*known, recorded.prior, recorded.mean, **search))

    def predict_mean(self, inputs: Array, plant_n: Array) -> Array:
        """Return the force, N, of (N, D) standardised inputs at which the plant's is known, N, (N,) each."""
        return np.asarray(plant_n + self.scaling.force_scale_n * self.residual.predict_mean(inputs))

    def predict_interval(self, inputs: Array, plant_n: Array, quantile: float) -> tuple[Array, Array]:
        """Return what a load cell would show, N: means and half the widths of intervals, (N,) each.

        Hyperparameters are marginalised; the normal quantile makes the width. The plant's own uncertainty, of its
        constants and effects, is not added: the process has to tell it.
        """
        mean_n, half_n = predict_interval(self.residual, self.scaling, inputs, quantile)
        return plant_n + mean_n - self.scaling.force_centre_n, half_n


def leave_residual(scaling: Scaling, samples: pd.DataFrame, plant_n: Array | float) -> tuple[Array, Array]:
    """Return the standardised inputs of N samples, (N, D), and what a plant's force leaves, in standard units, (N,)."""
    return scaling.inputs_of(samples), (samples[MODEL_OUTPUT].to_numpy() - plant_n) / scaling.force_scale_n


def predict_interval(model: MarginalGP, scaling: Scaling, inputs: Array, quantile: float) -> tuple[Array, Array]:
    """Return what a load cell would show by a model of the force itself; see `GreyBox.predict_interval`."""
    mean, variance = model.predict_marginal(inputs)
    half_n = quantile * scaling.force_scale_n * np.sqrt(variance + model.noise_variance)
    return scaling.restore_force(mean), np.asarray(half_n)
