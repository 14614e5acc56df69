"""Algorithm 1 with models that keep every sample: ask which trajectory tells most, tell what was recorded.

The bank's inputs, hyperpriors and an initial dataset flow in; each `SparseInteraction.tell` returns a new value with
all recorded samples appended and the muscles' sparse models identified again, from where they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array
from stages.science.gp.knowledge import Knowledge, Policy, check_muscles, check_trajectories
from stages.science.gp.sparse_fit import fit_sparse
from stages.science.gp.sparse_marginal import SparseMarginalGP, condition_sparse
from stages.science.gp.sparse_model import SparseGP


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
    """What is known before a trial, with sparse models of all samples.

    Parameters
    ----------
    design, candidates, priors, inputs, outputs, thetas, used
        As in `Knowledge`.
    pseudo : tuple over M muscles of (K, D) float arrays
        Pseudo-inputs, standardised.
    """

    design: SparseDesign
    pseudo: tuple[Array, ...]

    @classmethod
    def begin(
        cls,
        design: SparseDesign,
        candidates: Sequence[Array],
        priors: Sequence[Hyperprior],
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        used: Sequence[int],
        generators: Sequence[np.random.Generator],
    ) -> SparseInteraction:
        """Identify every muscle's model from the initial data; one generator for each muscle's starts.

        Raises
        ------
        ValueError
            When a muscle is missing, a used trajectory is not in the bank, or pseudo-inputs outnumber the data.
        """
        check_muscles(len(priors), candidates, inputs, outputs, generators)
        check_trajectories("used: expected trajectories 0 to", used, candidates)
        found = [
            fit_sparse(
                x,
                y,
                design.pseudo_inputs,
                prior,
                design.mean,
                generator=each,
                starts=design.starts,
                iterations=design.first_iterations,
            )
            for x, y, prior, each in zip(inputs, outputs, priors, generators, strict=True)
        ]
        thetas, pseudo = _read(found)
        data = tuple(candidates), tuple(priors), tuple(inputs), tuple(outputs)
        return cls(design, *data, thetas, frozenset(used), pseudo)

    @cached_property
    def models(self) -> tuple[SparseMarginalGP, ...]:
        """The muscles' models at their recorded pseudo-inputs and MAP."""
        return tuple(
            condition_sparse(x, y, pseudo, theta, prior, self.design.mean)
            for x, y, pseudo, theta, prior in zip(
                self.inputs, self.outputs, self.pseudo, self.thetas, self.priors, strict=True
            )
        )

    def tell(
        self,
        trajectory: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        generators: Sequence[np.random.Generator],
    ) -> SparseInteraction:
        """Append all samples of a trial and identify every model again, from its last pseudo-inputs and theta.

        Parameters
        ----------
        trajectory : int
            What was executed.
        inputs, outputs : sequences over M muscles of (T, D) and (T,) float arrays
            What was recorded, standardised.
        generators : sequence of Generator
            As in `Interaction.tell`; a climb from where a model was draws nothing.

        Raises
        ------
        ValueError
            When a muscle is missing or the trajectory is not in the bank.
        """
        check_muscles(len(self.priors), inputs, outputs, generators)
        check_trajectories("trajectory: expected 0 to", [trajectory], self.candidates)
        grown_inputs = tuple(np.vstack(each) for each in zip(self.inputs, inputs, strict=True))
        grown_outputs = tuple(np.concatenate(each) for each in zip(self.outputs, outputs, strict=True))
        found = [
            fit_sparse(
                x,
                y,
                len(pseudo),
                prior,
                self.design.mean,
                generator=each,
                starts=0,
                warm_starts=[(pseudo, theta)],
                iterations=self.design.iterations,
            )
            for x, y, pseudo, theta, prior, each in zip(
                grown_inputs, grown_outputs, self.pseudo, self.thetas, self.priors, generators, strict=True
            )
        ]
        thetas, pseudo = _read(found)
        used = self.used | {trajectory}
        return replace(self, inputs=grown_inputs, outputs=grown_outputs, thetas=thetas, pseudo=pseudo, used=used)


def _read(models: Sequence[SparseGP]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    return tuple(each.theta for each in models), tuple(each.pseudo for each in models)
