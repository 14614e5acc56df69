"""Algorithm 1 with models that keep every sample: ask which trajectory tells most, tell what was recorded.

The bank's inputs, hyperpriors and an initial dataset flow in; each `SparseInteraction.tell` returns a new value with
all recorded samples appended and the muscles' sparse models identified again, from where they were.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.knowledge import Knowledge, Policy, check_muscles, check_trajectories
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_marginal import SparseMarginalGP, condition_sparse


@dataclass(frozen=True)
class SparseDesign(Policy):
    """How to choose, and how to identify a sparse model.

    Parameters
    ----------
    utility, reduce, reuse_trajectories, mean, memory_mb
        As in `Policy`; no ``log_det``.
    pseudo_inputs : int
        Of each muscle's model.
    starts : int
        Starts of the first search.
    first_iterations, iterations : int
        Of each climb of the first search, and of the one climb after a trial, at most.
    """

    pseudo_inputs: int
    starts: int
    first_iterations: int
    iterations: int


@dataclass(frozen=True)
class SparseInteraction(Knowledge):
    """What is known before a trial, with sparse models of all samples; the other parameters are `Knowledge`'s."""

    design: SparseDesign
    pseudo: tuple[Array, ...] = ()
    """Pseudo-inputs of each of M muscles, (K, D) float arrays, standardised."""

    def _identify(
        self, inputs: tuple[Array, ...], outputs: tuple[Array, ...], generators: Sequence[np.random.Generator]
    ) -> Self:
        design, mean, first, muscles = self.design, self.design.mean, not self.thetas, len(self.priors)
        counts = [design.pseudo_inputs] * muscles if first else [len(each) for each in self.pseudo]
        warm = [[]] * muscles if first else [[each] for each in zip(self.pseudo, self.thetas, strict=True)]
        starts, iterations = (design.starts, design.first_iterations) if first else (0, design.iterations)
        known = zip(inputs, outputs, counts, self.priors, generators, warm, strict=True)
        found = [
            fit_sparse(x, y, count, prior, mean, generator=each, starts=starts, warm_starts=last, iterations=iterations)
            for x, y, count, prior, each, last in known
        ]
        thetas, pseudo = tuple(each.theta for each in found), tuple(each.pseudo for each in found)
        return replace(self, inputs=inputs, outputs=outputs, thetas=thetas, pseudo=pseudo)

    @cached_property
    def models(self) -> tuple[SparseMarginalGP, ...]:
        """The muscles' models at their recorded pseudo-inputs and MAP."""
        muscles = zip(self.inputs, self.outputs, self.pseudo, self.thetas, self.priors, strict=True)
        return tuple(condition_sparse(*each, self.design.mean) for each in muscles)

    def tell(
        self,
        trajectory: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        generators: Sequence[np.random.Generator],
    ) -> Self:
        """Append all samples of a trial and identify every model again, from its last pseudo-inputs and theta.

        Takes what `Interaction.tell` takes; a climb from where a model was draws nothing. A `ValueError` tells a
        missing muscle, and a trajectory that is not in the bank.
        """
        check_muscles(len(self.priors), inputs, outputs, generators)
        check_trajectories("trajectory: expected 0 to", [trajectory], self.candidates)
        return self._append(trajectory, inputs, outputs, generators)
