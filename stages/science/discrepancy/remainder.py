"""What named effects leave: whether it matters, and whether the names are ambiguous.

A search that has ended flows in; out flow, by channel, the share of the gap that a flexible model would still remove,
and two probabilities.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stages.science.discrepancy.evidence import MEMORY, NONE, STATIC_MAP
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel
from stages.science.discrepancy.naming import Named, Round
from stages.science.discrepancy.search import Search, list_stuck
from stages.science.discrepancy.settings import SearchSettings
from stages.science.output_channels.noise import make_plain
from stages.science.output_channels.spectral_line import remove_line
from stages.science.signals.trajectories import Array

DRAWS = 1000


class Remainder(NamedTuple):
    """What a channel's named effects leave.

    `share` is the part of the initial gap above the floor that a flexible model, or the family, would still remove: a
    median; `line_hz` the frequency of an oscillation in all trials of one of its elements, Hz, or nan. The family
    explains it: a static map, where the channel follows one more probably than not and it removes more than half, a
    memory, where the same is true of one, or a linear one of the inputs removes most in one of them; else it is empty.

    The others are probabilities: `unknown` that it is more than the limit while the gap left is one that matters,
    `ambiguous` that the named effects leave more than forms of one effect differ by, or one at a bound leaves a gap, or
    they are too many, `doubt` that names of the channel leave something that a static map does not explain either. An
    oscillation through all trials, as of a supply, speaks for no name and against none.
    """

    share: float
    unknown: float
    ambiguous: float
    line_hz: float
    family: str
    doubt: float


def weigh_remainder(
    found: Search,
    named: Sequence[Named],
    last: Sequence[Fitted],
    settings: SearchSettings,
    generator: np.random.Generator,
) -> dict[str, Remainder]:
    """Return by channel what is left by the last fits of all outputs, over a Bayesian bootstrap of trials."""
    remainders = {}
    reached = {id(state): fitted for state, fitted in zip(found.outputs, last, strict=True)}
    for channel, mapped in found.rounds[-1].verdicts.maps.items():
        states = [state for state in found.outputs if state.output.channel == channel]
        weights = generator.dirichlet(np.ones(len(states[0].samples)), DRAWS)
        fits = [[state.nominal for state in states], [reached[id(state)] for state in states]]
        raws = [[each.raw for each in some] for some in fits]
        share, sure = _weigh(states, raws, weights, settings)
        told, by_map, beside = float(np.median(share)), 0.0, fits
        if mapped >= settings.certain:
            beside = [
                [own.refit(make_plain(own.fit.spread), its.static_map) for its, own in zip(states, some, strict=True)]
                for some in fits
            ]
            now, after = (_draw_gap(states, weights, each) for each in (raws[1], [each.raw for each in beside[1]]))
            least = _draw_gap(states, weights, [state.leftover.raw for state in states])
            by_map = float(np.median(share * np.clip((now - after) / np.maximum(now - least, 1e-9), 0.0, 1.0)))
        calm = [list(map(_square_without_line, states, some)) for some in beside]
        unmapped, left = _weigh(states, calm, weights, settings)
        added = any(each.forms for each in fits[1])
        ambiguous = float((unmapped > settings.ambiguous_share).mean()) if added else 0.0
        if any(is_hidden(state, settings.hiding_share) for state in states):
            ambiguous = 1.0 if added else 0.0
            sure = sure if added else max(sure, settings.certain)
        both = zip(states, fits[1], strict=True)
        stuck = any(list_stuck(each) and state.ratio(each.raw) > settings.smallest_gap for state, each in both)
        if stuck or sum(each.channel == channel and not each.shown for each in named) >= settings.most_effects:
            ambiguous = 1.0
        lines = [state.leftover.line_hz for state in states if state.leftover.line_hz is not None]
        line_hz = float(np.median(lines)) if lines else np.nan
        explained = {STATIC_MAP: by_map, MEMORY: told * _share_of_memory(found.rounds[-1], settings.certain)}
        most = next((each for each, its in explained.items() if its > 0.5 * told), "")
        family = most or next((state.leftover.family for state in states if state.leftover.family), "")
        doubt = max(left, settings.ambiguous_weight * ambiguous)
        remainders[channel] = Remainder(explained.get(most, told), sure, ambiguous, line_hz, family, doubt)
    return remainders


def _share_of_memory(looked: Round, certain: float) -> float:
    """Return the share of the gap above the floor that a memory removes in a round; 0 where it is not so probable."""
    before, after = looked.gaps[NONE], looked.gaps.get(MEMORY, np.inf)
    likely = looked.verdicts.names.get(MEMORY, 0.0) >= certain and before > 1.0
    return float(np.clip((before - after) / (before - 1.0), 0.0, 1.0)) if likely else 0.0


def _weigh(
    states: Sequence[FittedChannel], raws: Sequence[Sequence[Array]], weights: Array, settings: SearchSettings
) -> tuple[Array, float]:
    """Return the share of the gap that is left under each of the weights, and how often it and the gap matter.

    Gaps before and after are told by sums of squares of trials, (K,), of each output.
    """
    least_raws = [state.leftover.raw for state in states]
    initial, now, least = (_draw_gap(states, weights, each) for each in (*raws, least_raws))
    seen = initial > (1.0 + 0.5 * (settings.smallest_gap - 1.0)) * least  # beside no gap, no share of it means much
    share = np.where(seen, (now - least) / np.maximum(initial - least, 1e-9), 0.0)
    matters = (now > settings.smallest_gap * least) & (share > settings.unexplained_share)
    return share, float(matters.mean())


def _square_without_line(state: FittedChannel, fitted: Fitted) -> Array:
    """Return the sum of squares of each trial's residual, (K,), without an oscillation that runs through all trials."""
    residual, line_hz = fitted.residual, state.leftover.line_hz
    if line_hz is not None:
        residual = remove_line(residual, state.output.present, state.output.step_s, line_hz)
    return np.asarray((residual**2).sum(axis=0))


def is_hidden(state: FittedChannel, share: float) -> bool:
    """Return whether the noise floor, white noise apart, is above a share of the range: it may hide so much."""
    return bool(state.floor**2 - state.noise.white**2 > (share * state.output.range) ** 2)


def _draw_gap(states: Sequence[FittedChannel], weights: Array, raws: Sequence[Array]) -> Array:
    ratios = []
    for state, raw in zip(states, raws, strict=True):
        own = weights[:, : len(state.samples)]
        mean = (own @ raw) / (own @ state.samples)
        ratios.append(mean / state.floor**2)
    return np.asarray(np.sqrt(np.mean(ratios, axis=0)))
