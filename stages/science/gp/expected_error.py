"""What error a model expects of itself, and what it expected where trials that it learned from were left out of it.

A model and inputs flow in; root mean squares of what a noisy measurement would differ from the model's mean flow out,
in standard units. Hyperparameters are held.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.kernel import Array
from stages.science.gp.marginal import MarginalGP, condition


def expect_error(model: MarginalGP, inputs: Array) -> float:
    """Return the root of the mean of V + sn^2 over (Q, D) inputs."""
    return float(np.sqrt(model.predict(inputs)[1].mean() + model.noise_variance))


def leave_trials_out(model: MarginalGP, trials: NDArray[np.intp], executed: Sequence[tuple[Array, Array]]) -> Array:
    """Return the error that is expected and the one that is measured in each trial, by the model without its points.

    Parameters
    ----------
    model : MarginalGP
        Of N points.
    trials : (N,) int array
        Of each point the trial that it was taken from, as a position in `executed`; -1 for what is never left out.
    executed : sequence over K trials of (B, D) and (B,) float arrays
        Samples of each trial, standardised: inputs and outputs.

    Returns
    -------
    (K, 2) float array

    Raises
    ------
    ValueError
        When the trials are not one for each point.
    """
    posterior = model.posterior
    if len(trials) != len(posterior.inputs):
        raise ValueError(f"trials: expected {len(posterior.inputs)}, one for each point, got {len(trials)}")
    errors = np.empty((len(executed), 2))
    for k, (inputs, outputs) in enumerate(executed):
        kept = trials != k
        known = posterior.inputs[kept], posterior.outputs[kept]
        left = condition(*known, model.theta, posterior.prior, posterior.mean)
        mean, variance = left.predict(inputs)
        errors[k] = np.mean([variance + left.noise_variance, np.square(mean - outputs)], axis=1)
    return np.sqrt(errors)
