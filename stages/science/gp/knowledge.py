"""What is known before a trial, and the question that it answers: which trajectory tells most.

The bank's inputs and the muscles' models flow in; the trajectory to execute flows out. `Interaction` and
`SparseInteraction` say what a trial adds to what is known.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from stages.science.gp.hyperprior import Hyperprior
from stages.science.gp.kernel import Array
from stages.science.gp.marginal_model import MarginalModel
from stages.science.gp.scoring import trajectory_utility


@dataclass(frozen=True)
class Policy:
    """How the next trajectory is chosen.

    Parameters
    ----------
    utility : str
        What a trajectory is chosen by; a name in `UTILITIES` or `TASK_UTILITIES`, ``log_det`` or ``random``.
    reduce : str
        ``sum`` or ``max`` over a trajectory's samples.
    reuse_trajectories : bool
        Whether an executed trajectory may be chosen again.
    mean : str
        Of the models: ``zero`` or ``constant``.
    memory_mb : float
        Bound on the working memory of a bank's scores (MB).
    exchanged : tuple of int
        Inputs that each muscle may take from another trajectory of the bank than the one that is executed; none where
        trajectories are executed as they are, as ``random`` ones always are.
    """

    utility: str
    reduce: str
    reuse_trajectories: bool
    mean: str
    memory_mb: float
    exchanged: tuple[int, ...] = field(default=(), kw_only=True)


@dataclass(frozen=True)
class Choice:
    """A trajectory's index in the bank, and the (R,) utilities, minus infinity where excluded; None at random.

    `sources` are the trajectories that the M muscles' exchanged inputs are taken from; empty where none are.
    """

    trajectory: int
    scores: Array | None
    sources: tuple[int, ...] = ()


@dataclass(frozen=True)
class Knowledge(ABC):
    """What is known before a trial.

    Parameters
    ----------
    design : Policy
        How to choose.
    candidates : tuple over M muscles of (R, T, D) float arrays
        Inputs of every trajectory of the bank, standardised.
    priors : tuple over M muscles of Hyperprior
        Table 1.
    inputs, outputs : tuples over M muscles of (N, D) and (N,) float arrays
        The data so far, standardised.
    thetas : tuple over M muscles of (P,) float arrays
        The MAP of each muscle's hyperparameters, given the data.
    used : frozenset of int
        Trajectories executed so far.
    tasks : tuple over M muscles of (Q, D) float arrays
        Standardised inputs that the models are wanted for; `TASK_UTILITIES` alone ask for them.
    """

    design: Policy
    candidates: tuple[Array, ...]
    priors: tuple[Hyperprior, ...]
    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    thetas: tuple[Array, ...]
    used: frozenset[int]
    tasks: tuple[Array, ...] = ()

    @classmethod
    def begin(
        cls,
        design: Policy,
        candidates: Sequence[Array],
        priors: Sequence[Hyperprior],
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        used: Sequence[int],
        generators: Sequence[np.random.Generator],
        tasks: Sequence[Array] = (),
    ) -> Self:
        """Identify every muscle's model from the initial data; one generator for each muscle's starts.

        A `ValueError` tells a missing muscle, a used trajectory that is not in the bank, and pseudo-inputs that
        outnumber the data.
        """
        check_muscles(len(priors), candidates, inputs, outputs, generators)
        check_trajectories("used: expected trajectories 0 to", used, candidates)
        blank = cls(design, tuple(candidates), tuple(priors), (), (), (), frozenset(used), tuple(tasks))
        return blank._identify(tuple(inputs), tuple(outputs), generators)

    @abstractmethod
    def _identify(
        self, inputs: tuple[Array, ...], outputs: tuple[Array, ...], generators: Sequence[np.random.Generator]
    ) -> Self:
        """Return what is known of these data, the models sought from the last ones where there are any."""

    def _append(
        self,
        trajectory: int,
        inputs: Sequence[Array],
        outputs: Sequence[Array],
        generators: Sequence[np.random.Generator],
    ) -> Self:
        """Return what is known with samples of a trial of the bank appended."""
        x, y = (
            tuple(np.concatenate(each) for each in zip(known, new, strict=True))
            for known, new in ((self.inputs, inputs), (self.outputs, outputs))
        )
        return replace(self._identify(x, y, generators), used=self.used | {trajectory})

    @property
    @abstractmethod
    def models(self) -> Sequence[MarginalModel]:
        """The muscles' models at their recorded MAP."""

    @property
    def stride(self) -> int:
        """Samples of a trajectory to which a joint utility takes one."""
        return 1

    @property
    def available(self) -> NDArray[np.intp]:
        """Trajectories that may be chosen."""
        used = [] if self.design.reuse_trajectories else sorted(self.used)
        return np.setdiff1d(np.arange(len(self.candidates[0])), used)

    def ask(self, generator: np.random.Generator, but: Collection[int] = (), *, score_all: bool = True) -> Choice:
        """Choose the next trajectory.

        Parameters
        ----------
        generator : Generator
            Drawn from by the ``random`` control alone.
        but : collection of int
            Trajectories that are not to be chosen now, beside those executed so far.
        score_all : bool
            Otherwise trajectories that are not the best for certain may be scored by minus infinity, in less time.

        Raises
        ------
        ValueError
            When no trajectory is left.
        """
        available = np.setdiff1d(self.available, list(but))
        if not available.size:
            raise ValueError(
                f"expected a trajectory that was neither executed yet nor excluded, but all {len(self.candidates[0])} "
                "of the bank were; record a larger bank or allow reuse"
            )
        if self.design.utility == "random":
            return Choice(int(generator.choice(available)), None)
        found = self._find_sources()
        candidates = self.exchange(found)
        scores = self._score(candidates) if score_all else self._score_leaders(candidates, available)
        scores[~np.isin(np.arange(len(scores)), available)] = -np.inf
        best = int(np.argmax(scores))
        return Choice(best, scores, tuple(int(each[best]) for each in found))

    def exchange(self, sources: Sequence[NDArray[np.intp]]) -> tuple[Array, ...]:
        """Return the candidates with exchanged inputs, from the (R,) sources of each muscle; as they are without."""
        if not sources:
            return self.candidates
        columns, exchanged = list(self.design.exchanged), []
        for inputs, its in zip(self.candidates, sources, strict=True):
            exchanged.append(inputs.copy())
            exchanged[-1][..., columns] = inputs[its][..., columns]
        return tuple(exchanged)

    def inputs_of(self, choice: Choice) -> tuple[Array, ...]:
        """Return each muscle's inputs (T, D) along a choice; a `ValueError` says that there is no such trajectory."""
        check_trajectories("trajectory: expected 0 to", [choice.trajectory, *choice.sources], self.candidates)
        chosen, columns = [each[choice.trajectory] for each in self.candidates], list(self.design.exchanged)
        for place, source in enumerate(choice.sources):
            chosen[place] = chosen[place].copy()
            chosen[place][:, columns] = self.candidates[place][source][:, columns]
        return tuple(chosen)

    def _find_sources(self) -> list[NDArray[np.intp]]:
        """Return the best source of exchanged inputs for each muscle and trajectory, (R,) each; none without.

        As a utility is a sum over muscles, each muscle's best sources make the best of the R^M combinations. They are
        found on as many even samples as a trial may give.
        """
        if not self.design.exchanged:
            return []
        count = len(self.candidates[0])
        found = []
        for muscle, inputs in enumerate(self._thin_sources()):
            best = np.empty(count, dtype=np.intp)
            for trajectory, samples in enumerate(inputs):
                block = np.repeat(samples[None], count, axis=0)
                block[..., list(self.design.exchanged)] = inputs[..., list(self.design.exchanged)]
                best[trajectory] = int(np.argmax(self._score_muscle(muscle, block)))
            found.append(best)
        return found

    def _thin_sources(self) -> Sequence[Array]:
        """Return the samples of each muscle's candidates by which sources are compared."""
        return self.candidates

    def _score_muscle(self, muscle: int, inputs: Array) -> Array:
        """Return the utility of (B, T, D) thinned trajectories for one muscle, (B,)."""
        design = self.design
        return trajectory_utility([self.models[muscle]], [inputs], design.utility, design.reduce, design.memory_mb, 1)

    def _score(self, candidates: Sequence[Array]) -> Array:
        """Return the utility of every trajectory of the bank, (R,)."""
        design = self.design
        return trajectory_utility(self.models, candidates, design.utility, design.reduce, design.memory_mb, self.stride)

    def _score_leaders(self, candidates: Sequence[Array], available: NDArray[np.intp]) -> Array:
        """Return the utility, (R,), of those available trajectories at least that may be the best."""
        return self._score(candidates)


def check_muscles(expected: int, *each: Sequence[object], told: str = "") -> None:
    """Refuse, by a `ValueError`, values that are not one for each muscle."""
    for values in each:
        if len(values) != expected:
            raise ValueError(f"{told}expected {expected} muscles, got {len(values)}")


def check_trajectories(name: str, trajectories: Sequence[int], candidates: Sequence[Array]) -> None:
    """Refuse, by a `ValueError` that names the first, trajectories that are not in the bank."""
    last = len(candidates[0]) - 1
    for each in trajectories:
        if not 0 <= each <= last:
            raise ValueError(f"{name} {last}, got {each}")
