"""Standardisation of a muscle's inputs and output with constants that are fixed before any force is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stages.science.signals.trajectories import Array

MODEL_INPUTS = ("pressure_kpa", "contraction", "contraction_velocity_per_s")
MODEL_OUTPUT = "force_n"


@dataclass(frozen=True)
class Scaling:
    """Centres and scales of a muscle: (D,) of the columns of its model's inputs, each in its unit, and of force, N."""

    inputs: tuple[str, ...]
    input_centre: Array
    input_scale: Array
    force_centre_n: float
    force_scale_n: float

    @classmethod
    def of_muscle(cls, rows: pd.DataFrame, muscle: str) -> Scaling:
        """Read one muscle's constants from rows with columns muscle, quantity, centre and scale."""
        constants = rows[rows["muscle"] == muscle].set_index("quantity")[["centre", "scale"]]
        names = tuple(str(each) for each in constants.index if each != MODEL_OUTPUT)
        inputs, output = constants.loc[list(names)].to_numpy(), constants.loc[MODEL_OUTPUT].to_numpy()
        return cls(names, inputs[:, 0].copy(), inputs[:, 1].copy(), float(output[0]), float(output[1]))

    def inputs_of(self, samples: pd.DataFrame) -> Array:
        """Return the (N, D) standardised inputs of a muscle's samples.

        They are C-contiguous, however the frame holds them: products of the same numbers in another layout differ in
        their last bits.
        """
        return np.ascontiguousarray((samples[list(self.inputs)].to_numpy() - self.input_centre) / self.input_scale)

    def restore_inputs(self, standardised: Array) -> Array:
        """Return the (N, D) inputs, each in its unit."""
        return standardised * self.input_scale + self.input_centre

    def output_of(self, samples: pd.DataFrame) -> Array:
        """Return the (N,) standardised force of a muscle's samples."""
        return (samples[MODEL_OUTPUT].to_numpy() - self.force_centre_n) / self.force_scale_n

    def restore_force(self, standardised: Array) -> Array:
        """Return forces in N."""
        return standardised * self.force_scale_n + self.force_centre_n
