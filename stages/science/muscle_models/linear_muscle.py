"""A muscle's force as polynomials of contraction, with and without pressure, by least squares.

Pressure, contraction and force of one muscle flow in; a law that predicts comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stages.science.signals.scaling import Array

LARGEST_VALUE = 1e50
"""Forces of values within it are finite."""

SMALLEST_VALUE = 1e-50
SMALLEST_RANGE = 1e-9
"""An input of a smaller half range, as it is or relative to its largest value, is taken for constant."""

SMALLEST_SINGULAR_VALUE = 1e-8
"""Directions of coefficients are determined by data above it, relative to the largest, in standardised inputs."""


@dataclass(frozen=True, eq=False)
class LinearMuscleModel:
    """F = P (a1 C^2 + a2 C + a3) + (a4 C^2 + a5 C + a6), of one muscle.

    Chou and Hannaford, Measurement and modeling of McKibben pneumatic artificial muscles, IEEE Trans. Robot. Autom. 12
    (1996), whose law without end effects is of this form; Teramae, Noda, Hyon and Morimoto, Modeling and control of a
    pneumatic-electric hybrid system, IROS (2013), who fit it. The law may be negative where a muscle is slack, and it
    knows no velocity.
    """

    centre: Array
    scale: Array
    """Half ranges of pressure (kPa) and contraction, (2,), which with their centres standardise them."""
    weights: Array
    """a1 to a6 of the same polynomial in standardised inputs, (6,), N."""

    @classmethod
    def fit(cls, pressure_kpa: ArrayLike, contraction: ArrayLike, force_n: ArrayLike) -> LinearMuscleModel:
        """Fit the polynomial by ordinary least squares to pressures (kPa gauge), contractions and forces (N), (n,).

        Samples of a slack muscle do not follow the law and are better left out. Where data do not determine all
        coefficients (fewer than six samples, two contractions only, one pressure), the model is the polynomial of least
        norm in standardised inputs: it explains the data as well as any other, and its forces elsewhere are a
        convention; an input that never changed changes no force. Columns of the design are those of inputs in [-1, 1],
        of like size and nearly independent.

        A `ValueError` tells arrays that are empty or not vectors of one length, and a value that is not finite or
        absurdly large.
        """
        pressure, contracted, force = (np.asarray(each, dtype=float) for each in (pressure_kpa, contraction, force_n))
        if not pressure.shape == contracted.shape == force.shape or force.ndim != 1 or not force.size:
            raise ValueError(
                "expected pressure, contraction and force as vectors of one length, not empty; "
                f"got shapes {pressure.shape}, {contracted.shape} and {force.shape}"
            )
        for name, values in (("pressure", pressure), ("contraction", contracted), ("force", force)):
            worst = float(np.abs(values).max())  # NaN if there is one
            if not worst <= LARGEST_VALUE:
                raise ValueError(f"expected a finite {name} within {LARGEST_VALUE:g}, got {worst}")
        centre, scale = np.transpose([_standardise(pressure), _standardise(contracted)])
        design = _design((pressure - centre[0]) / scale[0], (contracted - centre[1]) / scale[1])
        left, singular, right = np.linalg.svd(design, full_matrices=False)
        rank = int((singular > singular[0] * SMALLEST_SINGULAR_VALUE).sum())
        size = float(np.abs(force).max()) or 1.0
        weights = right[:rank].T @ (left[:, :rank].T @ (force / size) / singular[:rank])
        return cls(centre, scale, weights * size)

    def predict(self, pressure_kpa: ArrayLike, contraction: ArrayLike) -> Array:
        """Return the force, N, by pressure (kPa gauge) and contraction, two arrays of one shape; NaN where one is NaN.

        A `ValueError` tells shapes that differ and a value that is absurdly large.
        """
        pressure, contracted = np.asarray(pressure_kpa, dtype=float), np.asarray(contraction, dtype=float)
        if pressure.shape != contracted.shape:
            raise ValueError(
                f"expected pressure and contraction of one shape, got {pressure.shape} and {contracted.shape}"
            )
        worst = float(np.fmax.reduce(np.abs([pressure, contracted]), axis=None, initial=0.0))
        if worst > LARGEST_VALUE:
            raise ValueError(f"expected pressure and contraction within {LARGEST_VALUE:g}, got {worst}")
        inputs = (pressure - self.centre[0]) / self.scale[0], (contracted - self.centre[1]) / self.scale[1]
        return _design(*inputs) @ self.weights


def _standardise(values: Array) -> tuple[float, float]:
    """Return centre and half range; of a constant, it and 1."""
    low, high = float(values.min()), float(values.max())
    half, largest = (high - low) / 2, max(abs(low), abs(high))
    if half <= max(SMALLEST_RANGE * largest, SMALLEST_VALUE):
        return low, largest if largest > SMALLEST_VALUE else 1.0
    return (low + high) / 2, half


def _design(pressure: Array, contraction: Array) -> Array:
    """Return the (..., 6) terms of a1 to a6."""
    powers = np.stack([contraction**2, contraction, np.ones_like(contraction)], axis=-1)
    return np.concatenate([pressure[..., None] * powers, powers], axis=-1)
