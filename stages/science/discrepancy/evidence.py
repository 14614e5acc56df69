"""Which name the left-out trials speak for, of names, of families without one, and of nothing.

Log scores of models flow in; probabilities flow out. Each channel may also follow a law other than the nominal one: all
that is said of it is weighed without and with a static map beside it.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.flexible import MEMORY
from stages.science.signals.trajectories import Array

NONE, STATIC_MAP = "none", "static_map"
LIKELY = 0.05
"""Share of a name's probability from which a form may be it."""


@dataclass(frozen=True)
class Verdicts:
    """Probabilities of names that sum to one, ``none`` and ``static_map`` among them, and how each would be carried.

    `forms` are the most probable of each name in every output, empty where none was looked at, and `likely` all that
    have a share of its probability; `mapped` says whether it is more probable beside a static map. `carries` are the
    probabilities, (C,), that each output is among those that carry the name; `maps` the probabilities that a channel
    which carries no name follows a static map other than the nominal one.
    """

    names: Mapping[str, float]
    forms: Mapping[str, list[str]]
    likely: Mapping[str, Collection[str]]
    mapped: Mapping[str, bool]
    carries: Mapping[str, Array]
    maps: Mapping[str, float]

    @property
    def families(self) -> list[str]:
        """Those of the names that name no effect."""
        return [name for name in self.names if name in (STATIC_MAP, MEMORY)]


@dataclass(frozen=True)
class Beside:
    """Log scores, all without or with a static map: of each output, (C,), and by form and place if it carries that.

    `elsewhere` has, by form and place, what is gained in another channel beside, and the channel: a sensor's effect
    changes what is simulated of its readings.
    """

    none: Array
    forms: Mapping[tuple[str, str], Mapping[int, float]]
    elsewhere: Mapping[tuple[str, str], Mapping[int, tuple[str, float]]] = field(default_factory=dict)


def weigh_names(
    alone: Beside,
    beside: Beside,
    channels: Sequence[str],
    priors: Mapping[str, float],
    most_evidence: float,
    worth: Callable[[str, list[str], Collection[str], Array, bool], bool],
) -> Verdicts:
    """Return the probability of each name, by scores without and with a static map.

    A name is carried by outputs of one channel, a static map by all of a channel; `channels` has that of each output.
    The prior probability of a name is shared evenly by the numbers of outputs that may carry it, by the sets of that
    number, and by the forms, of which all that carry it have one; that of a static map is of each channel. Log ratios
    of two likelihoods, nats, are scaled down, in a channel all alike, to `most_evidence` at most: how wrong the law of
    one channel is says nothing of another's. A name is `worth` it if it would close a gap that matters, given its form
    in every output, its likely forms, the probability of each output, and whether it is likelier beside a static map;
    else it has none, however sure its small gain is.

    Notes
    -----
    Prior by number and set: Scott and Berger, Bayes and empirical-Bayes multiplicity adjustment in the
    variable-selection problem, Annals of Statistics 38 (2010). A power of the likelihood under models that are all a
    little wrong: Miller and Dunson, Robust Bayesian inference via coarsening, JASA 114 (2019).
    """
    names = list(dict.fromkeys(name for name, _ in alone.forms))
    map_prior, at = priors[STATIC_MAP], np.array(channels)
    power = {
        each: min(1.0, most_evidence / max(_find_largest(alone, beside, at == each, each), 1e-300))
        for each in dict.fromkeys(channels)
    }
    more = beside.none - alone.none
    log_map = {each: its * float(more[at == each].sum()) for each, its in power.items()}
    log_law = {each: np.logaddexp(np.log1p(-map_prior), np.log(map_prior) + value) for each, value in log_map.items()}
    log_weight, chosen, carries = {NONE: float(np.log(priors[NONE]))}, {}, {}
    likely: dict[str, Collection[str]] = {}
    mapped: dict[str, bool] = {}
    for name in names:
        found = [
            _weigh_name(name, scores, power, channels, log_prior, log_map if scores is beside else {}, log_law)
            for scores, log_prior in ((alone, np.log1p(-map_prior)), (beside, np.log(map_prior)))
        ]
        weight = np.logaddexp(found[0][0], found[1][0])
        mapped[name] = found[1][0] > found[0][0]
        _, chosen[name], likely[name], carries[name] = found[mapped[name]]
        offered = worth(name, chosen[name], likely[name], carries[name], mapped[name])
        log_weight[name] = float(weight + np.log(priors[name])) if offered else -np.inf
    weights = np.exp(np.array(list(log_weight.values())) - max(log_weight.values()))
    shares = dict(zip(log_weight, map(float, weights / weights.sum()), strict=True))
    maps = {each: 1.0 - float(np.exp(np.log1p(-map_prior) - value)) for each, value in log_law.items()}
    lawful = float(np.prod([1.0 - each for each in maps.values()]))
    shares |= {NONE: shares[NONE] * lawful, STATIC_MAP: shares[NONE] * (1.0 - lawful)}
    return Verdicts(shares, chosen, likely, mapped, carries, maps)


def _find_largest(alone: Beside, beside: Beside, own: NDArray[np.bool_], channel: str) -> float:
    """Return the largest log ratio of any explanation's likelihood to that of nothing, in the outputs of a channel."""
    gains = [np.maximum(beside.none - alone.none, 0.0)[own].sum()]
    for scores in (alone, beside):
        for by_output in scores.forms.values():
            gain = np.maximum(scores.none - alone.none, 0.0)
            for place, score in by_output.items():
                gain[place] = max(gain[place], score - alone.none[place])
            gains.append(gain[own].sum())
        for there in scores.elsewhere.values():
            gains.append(sum(max(gain, 0.0) for where, gain in there.values() if where == channel))
    return float(max(gains))


def _weigh_name(
    name: str,
    scores: Beside,
    power: Mapping[str, float],
    channels: Sequence[str],
    log_prior: float,
    log_map: Mapping[str, float],
    log_law: Mapping[str, float],
) -> tuple[float, list[str], set[str], Array]:
    """Return the log weight of a name over that of nothing, its form in each output, likely ones, and what carries it.

    One cause has one form in all outputs that carry it.
    """
    best, likely = [""] * len(channels), set()
    weights: dict[str, float] = {}
    shares: dict[str, Array] = {}
    for channel in dict.fromkeys(channels):
        found: dict[str, tuple[float, list[int], Array]] = {}
        for form, by_output in [(form, its) for (each, form), its in scores.forms.items() if each == name]:
            own = [place for place in by_output if channels[place] == channel]
            if own:
                gains = power[channel] * np.array([by_output[k] - scores.none[k] for k in own])
                there = scores.elsewhere.get((name, form), {})
                gains += [power[there[k][0]] * there[k][1] if k in there else 0.0 for k in own]
                total, its_carries = _weigh_sets(gains)
                found[form] = total, own, its_carries
        if found:
            total = float(np.logaddexp.reduce([each for each, _, _ in found.values()]))
            weights[channel] = total - np.log(len(found)) + log_prior + log_map.get(channel, 0.0) - log_law[channel]
            shares[channel] = np.zeros(len(channels))
            for form, (each, own, its_carries) in sorted(found.items(), key=lambda item: item[1][0]):
                shares[channel][own] += np.exp(each - total) * its_carries
                likely |= {form} if np.exp(each - total) > LIKELY else set()
                for place in own:
                    best[place] = form
    if not weights:
        return -np.inf, best, likely, np.zeros(len(channels))
    most = max(weights, key=weights.__getitem__)
    return float(np.logaddexp.reduce(list(weights.values())) - np.log(len(weights))), best, likely, shares[most]


def _weigh_sets(gains: Array) -> tuple[float, Array]:
    """Return the log mean of the likelihood ratio over all sets of outputs but the empty, and each one's probability.

    Every number of outputs is as likely as any other, and every set of a number.
    """
    from scipy.special import gammaln

    number = np.arange(1, len(gains) + 1)
    log_prior = -np.log(len(gains)) - (gammaln(len(gains) + 1) - gammaln(number + 1) - gammaln(len(gains) - number + 1))
    total = float(np.logaddexp.reduce(log_prior + _sum_sets(gains)[1:]))
    shares = np.empty(len(gains))
    for place in range(len(gains)):
        without = np.append(_sum_sets(np.delete(gains, place)), -np.inf)
        shares[place] = 1.0 - np.exp(min(float(np.logaddexp.reduce(log_prior + without[1:])) - total, 0.0))
    return total, shares


def _sum_sets(gains: Array) -> Array:
    """Return the log of the summed likelihood ratios of all sets of each number of outputs, zero to all."""
    sums = np.full(len(gains) + 1, -np.inf)
    sums[0] = 0.0
    for gain in gains:
        sums[1:] = np.logaddexp(sums[1:], sums[:-1] + gain)
    return sums
