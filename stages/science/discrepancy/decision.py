"""The one decision: which names stand, by trials left out of each fit, and whether something is left without a name.

A search that has ended flows in; a `Decision` flows out. The workflow's verdict, the unblinding of a hidden effect and
the scorecard all read it. The test trials have no part in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stages.science.discrepancy.evidence import NONE
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel, correct_inputs
from stages.science.discrepancy.naming import Named
from stages.science.discrepancy.remainder import Remainder, is_hidden, weigh_remainder
from stages.science.discrepancy.search import Search
from stages.science.discrepancy.settings import DiscrepancySettings, SearchSettings
from stages.science.output_channels.muscle_channels import QUANTISATION
from stages.science.output_channels.output_channel import Counts
from stages.science.signals.trajectories import Array
from stages.science.statistics.sign_flips import compare_signs, fewest_trials, least_p

Status = Literal["no_discrepancy", "named", "unexplained"]


@dataclass(frozen=True)
class Decision:
    """What is said of a dataset.

    The status is ``named`` if an effect stands; else ``unexplained`` if something is missing more probably than not, or
    cannot be told from noise; else ``no_discrepancy``. Effects stand, in the order added, that are probable and that
    left-out trials confirm; the others are suspected, with a probability of `certain` at most. `steps` are the fits of
    all outputs with none, one, two, ... of those that stand, `remainders` what these leave by channel. `missing` is the
    probability that something is missing, with a name or without, `certain` at least where that cannot be told,
    `doubts` those of an effect without a name, by which every name in its channel is reduced, by round of the search
    and channel: beside what was added or, where the last round added nothing, beside its likeliest name too.
    It is `blind` if so much counts as noise, or one trial errs so much more than the others, that a gap would not be
    seen, or if the simulation predicts nothing.
    """

    status: Status
    missing: float
    effects: list[Named]
    suspected: list[Named]
    steps: list[list[Fitted]]
    remainders: dict[str, Remainder]
    blind: bool
    doubts: list[dict[str, float]]

    @property
    def unknown(self) -> float:
        """Probability that something without a name is left, and matters."""
        return max((each.unknown for each in self.remainders.values()), default=0.0)


def decide(found: Search, settings: DiscrepancySettings, generator: np.random.Generator) -> Decision:
    """Return what is said of a dataset whose search has ended.

    An effect stands if its probability is enough and the gap of trials left out of the fit falls with it, beside the
    others that stand, or if exact values show it, as they show a sensor's counts. Where independent trials are too few
    for a two-sided test, chance decides which of many names does best: there the gap has to fall by `clear_ratio`, as
    it has for a change at one moment, which is looked for at many and which one slow wander looks like. One
    that was found beside others of its muscle and channel shares their doubts. The others are taken out, the newest
    first. The generator flips signs and draws weights of trials.
    """
    limits = settings.search
    counted = _name_counts(found.outputs, limits)
    bearable = max(settings.significance, least_p(found.outputs[0].output.trials))
    few = found.outputs[0].output.independent_trials < fewest_trials(settings.significance)
    remainders = weigh_remainder(found, found.named, found.steps[-1], limits, generator)
    doubts = {channel: each.doubt for channel, each in remainders.items()}
    stand: list[Named] = []
    suspected: list[Named] = []
    reached: list[list[Fitted]] = []
    present = found.steps[-1]
    for added, step in zip(reversed(found.named), reversed(found.steps), strict=False):
        without = _drop(found, present, [added])
        before, after = (_pool_left_out(found, each, added) for each in (without, present))
        p_value = float(compare_signs((before - after)[:, None], generator)[0])
        clear = limits.clear_ratio * after.mean() <= before.mean()
        confirmed = p_value <= bearable and (clear or not (few or _is_of_a_moment(added, present)))
        earlier = found.named[: found.named.index(added)]
        built_on = sum(each.channel == added.channel and bool({*each.elements} & {*added.elements}) for each in earlier)
        sure = (1.0 - doubts[added.channel]) ** (1 + built_on)  # it may make up for what another's form lacks
        named = replace(added, p_value=p_value, probability=added.doubt(1.0 - sure))
        if named.probability >= limits.certain and (named.shown or confirmed):
            stand.insert(0, named)
            reached.insert(0, step)
        else:
            suspected.insert(0, replace(named, probability=min(named.probability, limits.certain)))
            present = without
    steps = [found.steps[0], *(_drop(found, each, suspected) for each in reached)]
    if suspected:
        remainders = weigh_remainder(found, stand, steps[-1], limits, generator)
        imitated = {channel: limits.ambiguous_weight * each.ambiguous for channel, each in remainders.items()}
        stand = [replace(each, probability=each.doubt(imitated[each.channel])) for each in stand]
        doubts = {channel: max(its, imitated[channel]) for channel, its in doubts.items()}
    for each, counts in counted:
        stand.append(each)
        both = enumerate(zip(found.outputs, steps[-1], strict=True))
        steps.append(
            [fit.add_counts(counts[place], state.noise) if place in counts else fit for place, (state, fit) in both]
        )
    unknown = max((each.unknown for each in remainders.values()), default=0.0)
    nothing = found.rounds[0].verdicts.names[NONE] * (1.0 - unknown)
    missing = 1.0 - min([nothing, *(1.0 - each.probability for each, _ in counted)])
    by_round = [doubts] * len(found.rounds)
    if found.undecided:
        held = weigh_remainder(found, found.named, found.undecided, limits, generator)
        by_round[-1] = {channel: each.doubt for channel, each in held.items()}
    blind = any(_is_blind(state, each, settings) for state, each in zip(found.outputs, steps[-1], strict=True))
    missing = max(missing, limits.certain) if blind and not stand else missing
    left: Status = "unexplained" if missing >= limits.certain else "no_discrepancy"
    return Decision("named" if stand else left, missing, stand, suspected, steps, remainders, blind, by_round)


def _name_counts(outputs: Sequence[FittedChannel], limits: SearchSettings) -> list[tuple[Named, dict[int, Counts]]]:
    """Return by channel the sensors whose rounding is a part of the noise floor that matters, and their counts."""
    coarse: dict[tuple[str, str], dict[int, Counts]] = {}
    for place, state in enumerate(outputs):
        counts = state.output.find_counts(state.nominal.fit.model.name_values(state.nominal.fit.values)[0])
        if counts is None:
            continue
        floor = state.floor**2 + counts.averaged_out
        if counts.step**2 / 12.0 > (1.0 - limits.smallest_gap**-2) * floor:
            coarse.setdefault((state.output.channel, counts.form.form), {})[place] = counts
    named = []
    for (channel, form), its in coarse.items():
        muscles, forms = tuple(outputs[place].output.element for place in its), (form,) * len(its)
        sure = 1.0 - limits.family_prior
        named.append((Named(QUANTISATION, forms, "sensor", channel, muscles, sure, (), shown=True), its))
    return named


def _drop(found: Search, fits: Sequence[Fitted], dropped: Sequence[Named]) -> list[Fitted]:
    """Return fits without some effects; where a sensor's effect is among them, of inputs as they were recorded."""
    left = [
        fitted.drop_effects([each.name for each in dropped if each.is_in(state.output)], state.noise)
        for state, fitted in zip(found.outputs, fits, strict=True)
    ]
    for place, (state, first) in enumerate(zip(found.outputs, found.steps[0], strict=True)):
        recorded = first.fit.model.output
        if left[place].fit.model.output is not recorded and correct_inputs(recorded, left) is recorded:
            left[place] = left[place].put_in(recorded).refit(state.noise)
    return left


def _is_of_a_moment(named: Named, fits: Sequence[Fitted]) -> bool:
    return any(form.begins_later for fitted in fits for form in fitted.forms if form.name == named.name)


def _pool_left_out(found: Search, fits: Sequence[Fitted], named: Named) -> Array:
    """Return the gap of each trial left out, (K,), over the outputs that carry an effect."""
    both = zip(found.outputs, fits, strict=True)
    carried = [(state, each) for state, each in both if named.is_in(state.output)]
    squares = [each.raw / np.maximum(state.samples, 1.0) / state.output.range**2 for state, each in carried]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def _is_blind(state: FittedChannel, fitted: Fitted, settings: DiscrepancySettings) -> bool:
    """Return whether what counts as noise hides what there is, or the simulation predicts no better than a mean.

    What shows in one trial alone, no other trial can tell from noise.
    """
    error = float(np.sqrt(fitted.raw.sum() / state.samples.sum()))
    measured = state.output.measured[state.output.present]
    by_trial = np.sqrt(fitted.raw[state.samples > 0.0] / state.samples[state.samples > 0.0])
    odd = bool(by_trial.max() > settings.report.odd_trial * np.median(by_trial))
    return odd or is_hidden(state, settings.search.nothing_share) or error > float(measured.std())
