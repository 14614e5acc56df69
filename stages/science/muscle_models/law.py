"""The textbook's law as the mean of a muscle's model: linear in its coefficients, fitted to every sample.

Standardised inputs and force flow in, coefficients and forces flow out. The law is linear in pressure and quadratic in
contraction (Chou and Hannaford 1996; Teramae, Noda, Hyon and Morimoto 2013), and linear in every other input, each with
and without pressure. A Gaussian process then models what the law leaves.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import lstsq

from stages.science.gp.marginal import MarginalGP
from stages.science.signals.scaling import Array

PRIOR_SD = 3.0
"""Of each coefficient, standard units: the force spans four, the inputs about as much."""
RESIDUAL_SD = 0.1
"""Of the force about the law, standard units: 2.5 % of the largest force; it only weighs the prior against the data."""

NO_LAW: Array = np.zeros(0)
"""Coefficients where a model has no law."""

PRESSURE, CONTRACTION = "pressure_kpa", "contraction"


def name_terms(inputs: Sequence[str]) -> list[str]:
    """Return the law's terms for a model's inputs, in the order of `expand`."""
    alone = ["1", CONTRACTION, f"{CONTRACTION}^2", *(name for name in inputs if name not in (PRESSURE, CONTRACTION))]
    return [*alone, *(f"{PRESSURE} {name}" if name != "1" else PRESSURE for name in alone)]


def expand(inputs: Array, names: Sequence[str]) -> Array:
    """Return the terms (N, J) of standardised inputs (N, D), whose names are given."""
    columns = dict(zip(names, inputs.T, strict=True))
    pressure, contraction = columns.pop(PRESSURE), columns.pop(CONTRACTION)
    alone = np.stack([np.ones(len(inputs)), contraction, contraction**2, *columns.values()], axis=1)
    return np.hstack([alone, pressure[:, None] * alone])


def fit_law(inputs: Array, outputs: Array, names: Sequence[str]) -> Array:
    """Return the coefficients (J,) of the largest posterior, given standardised inputs (N, D) and force (N,)."""
    terms = expand(inputs, names)
    ridge = RESIDUAL_SD / PRIOR_SD * np.eye(terms.shape[1])
    found: Array = lstsq(np.vstack([terms, ridge]), np.concatenate([outputs, np.zeros(len(ridge))]))[0]
    return found


def follow_law(coefficients: Array, inputs: Array, names: Sequence[str]) -> Array:
    """Return the law's standardised force (N,) at standardised inputs (N, D); zero of no coefficients."""
    return expand(inputs, names) @ coefficients if len(coefficients) else np.zeros(len(inputs))


def predict_with_law(model: MarginalGP, law: Array, inputs: Array, names: Sequence[str]) -> Array:
    """Return the standardised force (N,) that a law and a model of what it leaves predict together."""
    return model.predict_mean(inputs) + follow_law(law, inputs, names)
