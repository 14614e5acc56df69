"""Algorithm 1 over recorded trials: the bank's own recording of a movement stands for its execution, and no rig is run.

The muscles, a loop's settings and the bank's recordings flow in; out flows what is known after each trial, an
`Interaction` with every muscle's data and hyperparameters. A time shift takes other samples than the most informative
ones, as if the person had been early or late (paper, section 5.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.interaction import Interaction
from stages.science.muscle_models.loop_settings import LoopSettings
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.samples import place_evenly
from stages.science.signals.scaling import Array

Draw = Callable[..., np.random.Generator]
"""Returns the generator of a key of names and numbers, always the same one for the same key."""

ROUNDING = 1e-9
"""Share of a sample by which the quotient of two decimal durations may miss a whole number."""


def displace(
    row: int, taken: Sequence[int], samples: int, amplitude_s: float, period_s: float, generator: np.random.Generator
) -> int:
    """Return the row of the sample at t + d to take in place of another, at t, with d uniform within an amplitude.

    d is rounded to a sample, `period_s` apart. It is drawn again when the sample lies outside the trial of so many,
    farther from t than the amplitude, or was taken from this trial before; each d takes one uniform number, whatever
    the amplitude. A `ValueError` says that every sample within reach was taken.
    """
    reach = int(np.floor(amplitude_s / period_s + ROUNDING))
    free = set(range(max(0, row - reach), min(samples - 1, row + reach) + 1)).difference(taken)
    if not free:
        raise ValueError(f"expected a free sample within {amplitude_s} s of sample {row}, all are taken")
    while True:
        moved = row + int(np.rint(amplitude_s * generator.uniform(-1.0, 1.0) / period_s))
        if moved in free:
            return moved


@dataclass(frozen=True)
class Replay:
    """The bank's movements, as a choice sees them, without force, and what was recorded in each, `period_s` apart.

    Recordings are standardised, by muscle: inputs (R, T, D) and outputs (R, T) of R movements.
    """

    muscles: MuscleSet
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    period_s: float

    @classmethod
    def read(cls, muscles: MuscleSet, bank: pd.DataFrame) -> Replay:
        """Gather the bank's recordings by muscle and movement.

        A `ValueError` says that its movements are not those that may be chosen.
        """
        recorded = [int(each) for each in bank["trajectory"].unique()]
        if recorded != muscles.trajectories:
            raise ValueError(f"expected recordings of movements {muscles.trajectories}, got {recorded}")
        inputs, outputs = muscles.standardise(bank)
        count = len(recorded)
        times = np.unique(bank["time_s"].to_numpy())
        return cls(
            muscles,
            tuple(each.reshape(count, -1, each.shape[1]) for each in inputs),
            tuple(each.reshape(count, -1) for each in outputs),
            float(times[-1] - times[0]) / (times.size - 1),
        )

    def run(
        self,
        loop: LoopSettings,
        priors: Sequence[Hyperprior],
        initial: Sequence[int],
        generator: Draw,
        amplitude_s: float = 0.0,
    ) -> Iterator[Interaction]:
        """Yield what is known of the initial data alone, then after each trial.

        Parameters
        ----------
        loop, priors
            How to choose, and how often; Table 1 of each muscle, or another.
        initial : sequence of int
            Positions in the bank of the trials that the initial data come from, evenly spread over them; none of them
            is chosen again unless the loop allows it.
        generator : callable
            Called with ``starts``, the trial and the muscle; ``random`` and the trial; ``shift``, the trial, the
            muscle and the number of the pick. What is equal for these is random alike, whatever the amplitude.
        amplitude_s : float
            Of the shift of each sample that a trial gives, s; 0 for none.

        Raises
        ------
        ValueError
            When no movement is left to choose, or a trial has too few samples.
        """

        def starts(trial: int) -> list[np.random.Generator]:
            return [generator("starts", trial, name) for name in self.muscles.names]

        def shift(trial: int, name: str) -> Callable[[int, Sequence[int]], int]:
            size = self.outputs[0].shape[1], amplitude_s, self.period_s
            return lambda row, taken: displace(row, taken, *size, generator("shift", trial, name, len(taken)))

        first, at = list(initial), place_evenly(loop.initial_points, len(initial) * self.outputs[0].shape[1])
        inputs = [each[first].reshape(-1, each.shape[2])[at] for each in self.inputs]
        outputs = [each[first].ravel()[at] for each in self.outputs]
        design = loop.design(self.muscles.mean)
        known = Interaction.begin(design, self.muscles.candidates, priors, inputs, outputs, initial, starts(0))
        yield known
        for trial in range(1, loop.trials + 1):
            chosen = known.ask(generator("random", trial), score_all=False).trajectory
            recorded = [each[chosen] for each in self.inputs], [each[chosen] for each in self.outputs]
            ways = [shift(trial, name) for name in self.muscles.names] if amplitude_s else None
            known, _ = known.tell(chosen, *recorded, starts(trial), ways)
            yield known
