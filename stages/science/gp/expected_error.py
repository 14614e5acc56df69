"""What error a model expects of itself, and what it expected where trials that it learned from were left out of it.

A model and inputs flow in; root mean squares of what a noisy measurement would differ from the model's mean flow out,
in standard units, or the factor by which its intervals are too narrow. Hyperparameters are held.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP, condition

Executed = Sequence[tuple[Array, Array]]
"""Samples of each of K trials, standardised: inputs, (B, D), and outputs, (B,)."""


def expect_error(model: MarginalGP, inputs: Array) -> float:
    """Return the root of the mean of V + sn^2 over (Q, D) inputs."""
    return float(np.sqrt(model.predict(inputs)[1].mean() + model.noise_variance))


def leave_trials_out(model: MarginalGP, trials: NDArray[np.intp], executed: Executed) -> Array:
    """Return the errors expected and measured in each of K trials, (K, 2), by the model without that trial's points.

    The (N,) trials are those that the model's N points were taken from, as positions in `executed`; -1 for what is
    never left out. A `ValueError` says that they are not one for each point.
    """
    errors = np.empty((len(executed), 2))
    for k, (left, inputs, outputs) in enumerate(_leave_each_out(model, trials, executed)):
        mean, variance = left.predict(inputs)
        errors[k] = np.mean([variance + left.noise_variance, np.square(mean - outputs)], axis=1)
    return np.sqrt(errors)


def scale_intervals(model: MarginalGP, trials: NDArray[np.intp], executed: Executed, level: float) -> float:
    """Return the factor with which intervals of a level hold that share of the trials' samples, each trial left out.

    Takes and raises what `leave_trials_out` does. Intervals are normal and marginalised over the hyperparameters. The
    factor is the quantile of what is measured, in half widths (cross-validation by trials, whose samples depend on each
    other). A model of independent noise is too sure where force depends on what no input tells: neighbours err alike.
    """
    scores = []
    for left, inputs, outputs in _leave_each_out(model, trials, executed):
        mean, variance = left.predict_marginal(inputs)
        scores.append(np.abs(outputs - mean) / np.sqrt(variance + left.noise_variance))
    return float(np.quantile(np.concatenate(scores), level) / ndtri(0.5 + 0.5 * level))


def _leave_each_out(
    model: MarginalGP, trials: NDArray[np.intp], executed: Executed
) -> Iterator[tuple[MarginalGP, Array, Array]]:
    """Yield the model without a trial's points, theta and S held, and that trial's samples."""
    posterior = model.posterior
    if len(trials) != len(posterior.inputs):
        raise ValueError(f"trials: expected {len(posterior.inputs)}, one for each point, got {len(trials)}")
    for k, (inputs, outputs) in enumerate(executed):
        kept = trials != k
        known = posterior.inputs[kept], posterior.outputs[kept]
        left = condition(*known, model.theta, posterior.prior, posterior.mean, model.laplace.covariance)
        yield left, inputs, outputs
