"""The whole search on one dataset, and the search that knows the true names as its upper bound.

Outputs with all trials flow in, with the positions of the test trials; out flow the search, its status, and the gap on
the test trials before, after, at the noise floor, and with the true names known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.science.discrepancy.fitted_channel import FittedChannel, prepare
from stages.science.discrepancy.naming import Named
from stages.science.discrepancy.remainder import Remainder, sum_doubt, weigh_remainder
from stages.science.discrepancy.search import Search, search
from stages.science.discrepancy.settings import SearchSettings
from stages.science.discrepancy.verdict import Status, decide_status
from stages.science.output_channels.fitting import Fit, fit
from stages.science.output_channels.flexible import find_floor
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array


@dataclass(frozen=True)
class Judgement:
    """What was found in a dataset.

    Parameters
    ----------
    outputs : list of OutputChannel
        With all trials.
    test : list of int
        Positions of the trials that nothing was fitted to.
    prepared : list of FittedChannel
        After the nominal fit.
    found : Search
        Ended.
    left : dict of str to Remainder
        By channel, what was named leaves.
    settings : SearchSettings
        Of the search.
    """

    outputs: list[OutputChannel]
    test: list[int]
    prepared: list[FittedChannel]
    found: Search
    left: dict[str, Remainder]
    settings: SearchSettings

    @property
    def unexplained(self) -> str:
        """Channel in which most probably something without a name is left."""
        return max(self.left, key=lambda channel: self.left[channel].unknown)

    @property
    def unknown(self) -> float:
        """Probability that something without a name is left, and matters."""
        return max((each.unknown for each in self.left.values()), default=0.0)

    @property
    def doubt(self) -> float:
        """Probability of an effect without a name; the probability of every name is reduced by it."""
        return sum_doubt(self.left, self.settings.remainder)

    @property
    def status(self) -> Status:
        """As in the verdict."""
        return decide_status([each.doubt(self.doubt) for each in self.found.named], self.unknown, self.settings.certain)

    @property
    def named(self) -> list[Named]:
        """Effects that the verdict names; none where something is left unexplained."""
        return self.found.named if self.status == "named" else []

    def gap(self, fits: Sequence[Fit], channels: Collection[str]) -> float:
        """Return the gap on the test trials, RMSE over range, root mean square over outputs of some channels."""
        squares = []
        for output, each in zip(self.outputs, fits, strict=True):
            if output.channel in channels:
                simulated = replace(each.model, output=output).simulate(each.values)
                squares.append(_mean_square(output, output.measured - simulated, self.test))
        return float(np.sqrt(np.mean(squares)))

    def floor(self, channels: Collection[str]) -> float:
        """Return what neither the last model nor a flexible one explains on the test trials, in the same unit."""
        learnt = np.ones(self.outputs[0].trials, dtype=bool)
        learnt[self.test] = False
        squares = []
        for output, state in zip(self.outputs, self.found.outputs, strict=True):
            if output.channel in channels:
                last = state.current.fit
                whole = fit(replace(last.model, output=output), state.noise, last.values, iterations=0)
                least = find_floor(whole, state.noise, learnt).residual
                kept = (_mean_square(output, each, self.test) for each in (least, whole.residual))
                squares.append(min(kept))
        return float(np.sqrt(np.mean(squares)))


def judge(
    outputs: Sequence[OutputChannel],
    test: Sequence[int],
    settings: SearchSettings,
    draw: Callable[[str], np.random.Generator],
) -> Judgement:
    """Return what the search finds in a dataset.

    Parameters
    ----------
    outputs : sequence of OutputChannel
        With all trials.
    test : sequence of int
        Positions of the trials that are not fitted.
    settings : SearchSettings
        When a gap matters and a name is accepted.
    draw : callable
        Returns the generator of a purpose.
    """
    fitted = [trial for trial in range(outputs[0].trials) if trial not in set(test)]
    prepared = [prepare(output.take(fitted)) for output in outputs]
    found = search(prepared, settings, draw("trials"))
    left = weigh_remainder(found, settings, draw("unexplained"))
    return Judgement(list(outputs), list(test), prepared, found, left, settings)


def search_with_truth(judged: Judgement, names: Collection[str], generator: np.random.Generator) -> Search:
    """Return the search that knows the true names and adds them however little they gain.

    Parameters
    ----------
    judged : Judgement
        Of the dataset.
    names : collection of str
        True names; the library is restricted to them.
    generator : numpy.random.Generator
        Draws weights of trials.
    """
    every = ("least_gain", "least_share", "later_share", "later_gain", "later_rest")
    easy = {"smallest_gap": 1.0, **dict.fromkeys(every, 0.0), "none_prior": 1e-9, "most_effects": len(names)}
    states = [replace(state, output=_restrict(state.output, names)) for state in judged.prepared]
    return search(states, judged.settings.model_copy(update=easy), generator)


def _restrict(output: OutputChannel, names: Collection[str]) -> OutputChannel:
    """Return an output that offers only the effects of these names."""
    forms = tuple(form for form in output.forms if form.name in names)
    kind = type(output.__class__.__name__, (output.__class__,), {"forms": forms})
    narrow: OutputChannel = object.__new__(kind)
    vars(narrow).update(vars(output))
    return narrow


def _mean_square(output: OutputChannel, residual: Array, trials: Sequence[int]) -> float:
    """Return the mean square over trials with samples, over the range squared; each trial counts alike."""
    present = output.present[:, trials]
    count = present.sum(axis=0)
    squares = np.where(present, residual[:, trials], 0.0)
    each = (squares**2).sum(axis=0)[count > 0] / count[count > 0]
    return float(each.mean() / output.range**2) if each.size else 0.0
