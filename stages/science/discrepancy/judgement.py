"""The whole search on one dataset, up to the decision, and the search that knows the true names as its upper bound.

Outputs with all trials flow in, with the positions of the test trials; out flow the search, the decision, and the gap
on the test trials before, after, at the noise floor, and with the true names known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stages.science.discrepancy.decision import TEST, Decision, compare_part, decide, select_judged
from stages.science.discrepancy.fitted_channel import FittedChannel, prepare
from stages.science.discrepancy.ranking import list_named, list_steps, list_unexplained
from stages.science.discrepancy.remainder import Remainder, sum_doubt, weigh_remainder
from stages.science.discrepancy.restoring import SearchTables
from stages.science.discrepancy.search import Search, search
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.discrepancy.verification import Verified, verify
from stages.science.output_channels.fitting import Fit
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

NAMED_COLUMNS = ["order", "name", "form", "channel", "muscle", "probability", "shown", "indistinguishable_from"]


@dataclass(frozen=True)
class Judgement:
    """What was found in a dataset, and what is said of it.

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
    verified : list of Verified
        All outputs on all trials.
    decision : Decision
        As in the verdict.
    settings : DiscrepancySettings
        Of the workflow.
    """

    outputs: list[OutputChannel]
    test: list[int]
    prepared: list[FittedChannel]
    found: Search
    left: dict[str, Remainder]
    verified: list[Verified]
    decision: Decision
    settings: DiscrepancySettings

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
        return sum_doubt(self.left, self.settings.search.remainder)

    def gap(self, fits: Sequence[Fit], channels: Collection[str]) -> float:
        """Return the gap on the test trials, RMSE over range, root mean square over outputs of some channels."""
        squares = []
        for output, each in zip(self.outputs, fits, strict=True):
            if output.channel in channels:
                simulated = replace(each.model, output=output).simulate(each.values)
                squares.append(_mean_square(output, output.measured - simulated, self.test))
        return float(np.sqrt(np.mean(squares)))

    def floor(self, channels: Collection[str]) -> float:
        """Return the noise floor of the test trials, in the same unit."""
        each = [verified for verified in self.verified if verified.output.channel in channels]
        counts = [verified.output.present.sum(axis=0)[self.test] for verified in each]
        means = [(own.floor[self.test] / np.maximum(n, 1))[n > 0].mean() for own, n in zip(each, counts, strict=True)]
        return float(np.sqrt(np.mean(means)))


def judge(
    outputs: Sequence[OutputChannel],
    test: Sequence[int],
    settings: DiscrepancySettings,
    draw: Callable[..., np.random.Generator],
) -> Judgement:
    """Return what the search finds in a dataset, and what is said of it.

    Parameters
    ----------
    outputs : sequence of OutputChannel
        With all trials.
    test : sequence of int
        Positions of the trials that are not fitted.
    settings : DiscrepancySettings
        Of the workflow.
    draw : callable
        Returns the generator of a purpose, or of a purpose and a part of the trials.
    """
    fitted = [trial for trial in range(outputs[0].trials) if trial not in set(test)]
    prepared = [prepare(output.take(fitted)) for output in outputs]
    found = search(prepared, settings.search, draw("trials"))
    left = weigh_remainder(found, settings.search, draw("unexplained"))
    tables = _tabulate(prepared, found, left, settings)
    verified = verify(outputs, fitted, tables)
    compared = compare_part(tables, select_judged(tables, verified), TEST, test, settings, draw)
    decision = decide(tables, verified, pd.DataFrame(compared), test, settings, draw)
    return Judgement(list(outputs), list(test), prepared, found, left, verified, decision, settings)


def _tabulate(
    prepared: Sequence[FittedChannel], found: Search, left: dict[str, Remainder], settings: DiscrepancySettings
) -> SearchTables:
    """Return what the search found as the workflow keeps it."""
    channels = [
        {
            "channel": state.output.channel,
            "muscle": state.output.element,
            "range": state.output.range,
            "noise_floor": state.floor,
            **state.noise._asdict(),
        }
        for state in prepared
    ]
    named = list_named(found.named, sum_doubt(left, settings.search.remainder))
    return SearchTables(
        pd.DataFrame(channels),
        pd.DataFrame(named, columns=None if named else NAMED_COLUMNS),
        pd.DataFrame(list_unexplained(left)),
        pd.DataFrame(list_steps(found)),
    )


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
    return search(states, judged.settings.search.model_copy(update=easy), generator)


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
