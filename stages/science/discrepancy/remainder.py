"""What named effects leave: whether it matters, and whether the names are ambiguous.

A search that has ended flows in; out flow, by channel, the share of the gap that a flexible model would still remove,
and two probabilities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel
from stages.science.discrepancy.naming import Named
from stages.science.discrepancy.search import Search
from stages.science.discrepancy.settings import RemainderSettings, SearchSettings
from stages.science.signals.trajectories import Array

DRAWS, MEMORY = 1000, "memory"


class Remainder(NamedTuple):
    """What a channel's named effects leave.

    Parameters
    ----------
    share : float
        Of the initial gap above the floor, what a flexible model would still remove; median over resampled trials.
    unknown : float
        Probability that it is more than the limit while the gap left is one that matters.
    ambiguous : float
        Probability that the named effects leave more than forms of one effect differ by, or that they are too many.
    line_hz : float or None
        Frequency of an oscillation in all trials of one of its elements, Hz.
    family : str
        That removes most in one of them, a linear memory of the inputs; else empty.
    """

    share: float
    unknown: float
    ambiguous: float
    line_hz: float | None
    family: str


def weigh_remainder(
    found: Search,
    named: Sequence[Named],
    last: Sequence[Fitted],
    settings: SearchSettings,
    generator: np.random.Generator,
) -> dict[str, Remainder]:
    """Return by channel what is left, over a Bayesian bootstrap of trials.

    Parameters
    ----------
    found : Search
        Ended.
    named : sequence of Named
        Effects that were added.
    last : sequence of Fitted
        Fits of all outputs with these.
    settings : SearchSettings
        When a gap matters.
    generator : numpy.random.Generator
        Draws weights of trials.
    """
    remainders = {}
    reached = {id(state): fitted for state, fitted in zip(found.outputs, last, strict=True)}
    for channel in dict.fromkeys(state.output.channel for state in found.outputs):
        states = [state for state in found.outputs if state.output.channel == channel]
        weights = generator.dirichlet(np.ones(len(states[0].samples)), DRAWS)
        initial = _draw_gap(states, weights, lambda state: state.nominal.raw)
        now = _draw_gap(states, weights, lambda state: reached[id(state)].raw)
        least = _draw_gap(states, weights, lambda state: state.leftover.raw)
        seen = initial > (1.0 + 0.5 * (settings.smallest_gap - 1.0)) * least  # beside no gap, no share of it means much
        share = np.where(seen, (now - least) / np.maximum(initial - least, 1e-9), 0.0)
        unknown = (share > settings.unexplained_share) & (now > settings.smallest_gap * least)
        added = any(reached[id(state)].forms for state in states)
        ambiguous = float((share > settings.ambiguous_share).mean()) if added else 0.0
        sure = float(unknown.mean())
        if any(_is_hidden(state, settings.remainder) for state in states):
            ambiguous = 1.0 if added else 0.0
            sure = sure if added else max(sure, settings.remainder.hidden_probability)
        if sum(each.channel == channel and not each.shown for each in named) >= settings.remainder.many_names:
            ambiguous = 1.0
        lines = [state.leftover.line_hz for state in states if state.leftover.line_hz is not None]
        line_hz = float(np.median(lines)) if lines else None
        family = MEMORY if any(state.leftover.linear_memory for state in states) else ""
        remainders[channel] = Remainder(float(np.median(share)), sure, ambiguous, line_hz, family)
    return remainders


def _is_hidden(state: FittedChannel, settings: RemainderSettings) -> bool:
    """Return whether the noise floor is so high that neither a name nor its absence is certain."""
    return settings.hides(state.floor / state.output.range, state.noise.white / state.output.range)


def sum_doubt(remainders: Mapping[str, Remainder], settings: RemainderSettings) -> float:
    """Return the probability of an effect without a name; the probability of every name is reduced by it.

    Where a named effect leaves so much that it is ambiguous, `ambiguous_weight` shares the probability.
    """
    return max(
        (max(each.unknown, settings.ambiguous_weight * each.ambiguous) for each in remainders.values()), default=0.0
    )


def _draw_gap(states: Sequence[FittedChannel], weights: Array, raw_of: Callable[[FittedChannel], Array]) -> Array:
    ratios = []
    for state in states:
        own = weights[:, : len(state.samples)]
        mean = (own @ raw_of(state)) / (own @ state.samples)
        ratios.append(mean / state.floor**2)
    gap: Array = np.sqrt(np.mean(ratios, axis=0))
    return gap
