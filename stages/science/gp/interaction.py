"""Algorithm 1 as a value: ask which trajectory tells most, tell what was recorded, get the next value.

The bank's inputs, hyperpriors and an initial dataset flow in; each `Interaction.tell` returns a new `Interaction` with
the picked samples appended and the muscles' models identified again. Nothing here executes a trial, so the same code
serves a loop that drives a rig and an operator who does it by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array
from stages.science.gp.knowledge import Knowledge, Policy, check_muscles, check_trajectories
from stages.science.gp.marginal import MarginalGP, condition, fit
from stages.science.gp.subsample import Displace, check_count, subsample


@dataclass(frozen=True)
class Design(Policy):
    """The choices that method and paper leave open.

    Parameters
    ----------
    utility, reduce, reuse_trajectories, mean, memory_mb
        As in `Policy`.
    subsample_utility : str
        What a recording's samples are picked by; a name in `UTILITIES`, or ``random``.
    points_per_trial : int
        Samples that each muscle's model takes from a trial.
    log_det_every : int
        The ``log_det`` utility takes every so-many-th sample of a trajectory.
    starts : int
        Starts of each MAP search beside the warm one.
    """

    subsample_utility: str
    points_per_trial: int
    log_det_every: int
    starts: int


@dataclass(frozen=True)
class Interaction(Knowledge):
    """What is known before a trial, with exact models of a few picked samples; the parameters are `Knowledge`'s."""

    design: Design

    @classmethod
    def begin(
        cls,
        design: Design,
        candidates: Sequence[Array],
        priors: Sequence[Hyperprior],
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        used: Sequence[int],
        generators: Sequence[np.random.Generator],
    ) -> Interaction:
        """Identify every muscle's model from the initial data; one generator for each muscle's starts.

        Raises
        ------
        ValueError
            When a muscle is missing or a used trajectory is not in the bank.
        """
        check_muscles(len(priors), candidates, inputs, outputs, generators)
        check_trajectories("used: expected trajectories 0 to", used, candidates)
        thetas = tuple(
            fit(x, y, prior, mean=design.mean, generator=each, starts=design.starts).theta
            for x, y, prior, each in zip(inputs, outputs, priors, generators, strict=True)
        )
        return cls(design, tuple(candidates), tuple(priors), tuple(inputs), tuple(outputs), thetas, frozenset(used))

    @cached_property
    def models(self) -> tuple[MarginalGP, ...]:
        """The muscles' models at their recorded MAP."""
        return tuple(
            condition(x, y, theta, prior, mean=self.design.mean)
            for x, y, theta, prior in zip(self.inputs, self.outputs, self.thetas, self.priors, strict=True)
        )

    @property
    def stride(self) -> int:
        """Samples of a trajectory to which a joint utility takes one."""
        return self.design.log_det_every

    def tell(
        self,
        trajectory: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        generators: Sequence[np.random.Generator],
        displace: Sequence[Displace] | None = None,
    ) -> tuple[Interaction, tuple[NDArray[np.intp], ...]]:
        """Take a trial's most informative samples and identify every model again.

        Parameters
        ----------
        trajectory : int
            What was executed.
        inputs, outputs : sequences over M muscles of (T, D) and (T,) float arrays
            What was recorded, standardised.
        generators : sequence of Generator
            For the starts of each muscle's search, and for its picks where they are random.
        displace : sequence of callable, optional
            For each muscle: takes another sample in place of each pick (see `subsample`).

        Returns
        -------
        Interaction
            With the picked samples appended.
        tuple over M muscles of (K,) int arrays
            Indices of the samples taken from the recording, in the order of picking.

        Raises
        ------
        ValueError
            When a muscle is missing, the trajectory is not in the bank, or the recording has too few samples.
        """
        check_muscles(len(self.priors), inputs, outputs, generators)
        check_trajectories("trajectory: expected 0 to", [trajectory], self.candidates)
        ways: Sequence[Displace | None] = [None] * len(self.priors) if displace is None else displace
        check_muscles(len(self.priors), ways)
        picks = tuple(
            self._pick(model, x, y, each, way)
            for model, x, y, each, way in zip(self.models, inputs, outputs, generators, ways, strict=True)
        )
        grown_inputs = tuple(np.vstack([old, x[at]]) for old, x, at in zip(self.inputs, inputs, picks, strict=True))
        grown_outputs = tuple(
            np.concatenate([old, y[at]]) for old, y, at in zip(self.outputs, outputs, picks, strict=True)
        )
        thetas = tuple(
            fit(
                x, y, prior, mean=self.design.mean, generator=each, starts=self.design.starts, warm_starts=(theta,)
            ).theta
            for x, y, prior, theta, each in zip(
                grown_inputs, grown_outputs, self.priors, self.thetas, generators, strict=True
            )
        )
        told = replace(self, inputs=grown_inputs, outputs=grown_outputs, thetas=thetas, used=self.used | {trajectory})
        return told, picks

    def _pick(
        self, model: MarginalGP, x: Array, y: Array, generator: np.random.Generator, displace: Displace | None
    ) -> NDArray[np.intp]:
        count, utility = self.design.points_per_trial, self.design.subsample_utility
        check_count(count, len(x))
        if utility != "random":
            return subsample(model, x, y, count, utility, displace)
        picks = generator.choice(len(x), count, replace=False)
        if displace is None:
            return picks
        taken: list[int] = []
        for row in picks:
            taken.append(displace(int(row), taken))
        return np.array(taken, dtype=np.intp)
