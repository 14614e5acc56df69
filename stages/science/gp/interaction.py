"""Algorithm 1 as a value: ask which trajectory tells most, tell what was recorded, get the next value.

The bank's inputs, hyperpriors and an initial dataset flow in; each `Interaction.tell` returns a new `Interaction` with
the picked samples appended and the muscles' models identified again. Nothing here executes a trial, so the same code
serves a loop that drives a rig and an operator who does it by hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.integrated_variance import TaskVariance
from stages.science.gp.kernel import Array
from stages.science.gp.knowledge import Choice, Knowledge, Policy, check_muscles, check_trajectories
from stages.science.gp.leaders import BOUNDED, score_leaders
from stages.science.gp.marginal import MarginalGP, condition, fit
from stages.science.gp.posterior import check_data
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.subsample import Displace, check_count, subsample
from stages.science.gp.task_gain import TaskGain
from stages.science.gp.task_utilities import TASK_UTILITIES, task_utility

SOURCE_TASK = 100
"""Task inputs, about, over which sources of exchanged inputs are compared, and bent movements; bank movements are
scored over all."""


@dataclass(frozen=True)
class Design(Policy):
    """The choices that method and paper leave open.

    Parameters
    ----------
    utility, reduce, reuse_trajectories, mean, memory_mb, exchanged
        As in `Policy`.
    subsample_utility : str
        What a recording's samples are picked by; a name in `UTILITIES` or `TASK_UTILITIES`, or ``random``.
    points_per_trial : int
        Samples that each muscle's model takes from a trial.
    joint_every : int
        ``log_det`` and `TASK_UTILITIES`, which score samples together, take every so-many-th of a trajectory.
    starts : int
        Starts of each MAP search beside the warm one.
    """

    subsample_utility: str
    points_per_trial: int
    joint_every: int
    starts: int


@dataclass(frozen=True)
class Interaction(Knowledge):
    """What is known before a trial, with exact models of a few picked samples; the parameters are `Knowledge`'s."""

    design: Design

    def _identify(
        self, inputs: tuple[Array, ...], outputs: tuple[Array, ...], generators: Sequence[np.random.Generator]
    ) -> Self:
        mean, starts = self.design.mean, self.design.starts
        warm = [[theta] for theta in self.thetas] or [[] for _ in self.priors]
        thetas = tuple(
            fit(x, y, prior, mean, generator=each, starts=starts, warm_starts=last).theta
            for x, y, prior, last, each in zip(inputs, outputs, self.priors, warm, generators, strict=True)
        )
        return replace(self, inputs=inputs, outputs=outputs, thetas=thetas)

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
        return self.design.joint_every

    def _score(self, candidates: Sequence[Array]) -> Array:
        if self.design.utility not in TASK_UTILITIES:
            return super()._score(candidates)
        check_muscles(len(self.priors), self.tasks, told="tasks: ")
        return task_utility(self.models, self.tasks, *self._thin(candidates), self.design.utility)

    def _score_leaders(self, candidates: Sequence[Array], available: NDArray[np.intp]) -> Array:
        if (self.design.utility, self.design.reduce) != (BOUNDED, "sum"):
            return super()._score_leaders(candidates, available)
        return score_leaders(self.models, candidates, available, self.design.memory_mb)

    def _thin(self, candidates: Sequence[Array]) -> tuple[list[Array], int]:
        """Return the candidates that are scored together, and how many a trial gives: as many at least are left."""
        samples = candidates[0].shape[1]
        count = min(self.design.points_per_trial, samples)
        return [each[:, :: min(self.stride, samples // count)] for each in candidates], count

    def _thin_sources(self) -> list[Array]:
        samples = self.candidates[0].shape[1]
        return [each[:, :: samples // min(self.design.points_per_trial, samples)] for each in self.candidates]

    def _score_muscle(self, muscle: int, inputs: Array) -> Array:
        if self.design.utility not in TASK_UTILITIES:
            return super()._score_muscle(muscle, inputs)
        return self._gains[muscle].gain(inputs)

    def foresee(self, choice: Choice) -> Array:
        """Return what the best samples of a choice would take from each muscle's mean variance over its task, (M,).

        A `ValueError` says that there is no such trajectory, or no task.
        """
        thinned, count = self._thin([each[None] for each in self.inputs_of(choice)])
        check_muscles(len(self.priors), self.tasks, told="tasks: ")
        muscles = zip(self.models, self.tasks, thinned, strict=True)
        return np.array([TaskVariance(model, task).pick(inputs[0], count)[1] for model, task, inputs in muscles])

    def weigh(self, muscle: int, inputs: Array) -> float:
        """Return the utility of (T, D) inputs for one muscle, for about `SOURCE_TASK` inputs of its task."""
        design, trajectory = self.design, inputs[None]
        if design.utility in TASK_UTILITIES:
            (thinned,), count = self._thin([trajectory])
            return float(self._gains[muscle].score(thinned, count)[0])
        how = design.utility, design.reduce, design.memory_mb, self.stride
        return float(trajectory_utility([self.models[muscle]], [trajectory], *how)[0])

    @cached_property
    def _gains(self) -> tuple[TaskGain, ...]:
        gain = TASK_UTILITIES[self.design.utility]
        tasks = (each[:: max(1, len(each) // SOURCE_TASK)] for each in self.tasks)
        return tuple(gain(*each) for each in zip(self.models, tasks, strict=True))

    def tell(
        self,
        trajectory: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        generators: Sequence[np.random.Generator],
        displace: Sequence[Displace] | None = None,
    ) -> tuple[Self, tuple[NDArray[np.intp], ...]]:
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
        ways: Sequence[Displace | None] = [None] * len(self.priors) if displace is None else displace
        check_muscles(len(self.priors), inputs, outputs, generators, ways)
        for each in zip(inputs, outputs, strict=True):
            check_data(*each)
        check_trajectories("trajectory: expected 0 to", [trajectory], self.candidates)
        picks = tuple(
            self._pick(muscle, x, y, each, way)
            for muscle, (x, y, each, way) in enumerate(zip(inputs, outputs, generators, ways, strict=True))
        )
        x, y = ([each[at] for each, at in zip(data, picks, strict=True)] for data in (inputs, outputs))
        return self._append(trajectory, x, y, generators), picks

    def _pick(
        self, muscle: int, x: Array, y: Array, generator: np.random.Generator, displace: Displace | None
    ) -> NDArray[np.intp]:
        count, utility = self.design.points_per_trial, self.design.subsample_utility
        check_count(count, len(x))
        if utility in TASK_UTILITIES:
            return TASK_UTILITIES[utility](self.models[muscle], self.tasks[muscle]).pick(x, count, displace)[0]
        if utility != "random":
            return subsample(self.models[muscle], x, y, count, utility, displace)
        taken: list[int] = []
        for row in generator.choice(len(x), count, replace=False):
            taken.append(int(row) if displace is None else displace(int(row), taken))
        return np.array(taken, dtype=np.intp)
