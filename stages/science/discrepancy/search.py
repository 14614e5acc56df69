"""The search for what is missing: locate, name, add, and repeat until what is left is noise or has no name.

Outputs with their trials flow in; out flow the rounds of the search, each with its ranking, and for every output the
nominal fit, the fit with what was named, and what a flexible model would leave.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from stages.science.discrepancy.evidence import MEMORY, NONE
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel, correct_inputs, list_kept, prepare, refine
from stages.science.discrepancy.naming import Choice, Named, Round, carry, is_worth, rank
from stages.science.discrepancy.settings import SearchSettings
from stages.science.discrepancy.trial_scores import compare_by
from stages.science.output_channels.families import join
from stages.science.output_channels.fitting import fit
from stages.science.output_channels.noise import Noise, make_plain
from stages.science.output_channels.output_channel import Divide, compute_here, list_starts
from stages.science.output_channels.trial_noise import TrialNoise, estimate_trial_noise

FRESH_STARTS, LONG = 4, 30
"""Number of other starts of the final fit of a named effect, and of iterations of each."""

NEARBY_STARTS, NEARBY = 8, 0.1
"""Number of random starts near a fit of an effect with a threshold, as its cost has local minima, and their standard
deviation in those of the priors."""

BETTER = 0.9
"""Sum of squares over the present one, below which constants found with a candidate are taken alone."""


@dataclass
class Search:
    """A search: its outputs now, what each round found, what was named, and the fits of all outputs at each step.

    `undecided` are the fits with the likeliest name of the last round, where that was not added.
    """

    outputs: list[FittedChannel]
    rounds: list[Round] = field(default_factory=list)
    named: list[Named] = field(default_factory=list)
    steps: list[list[Fitted]] = field(default_factory=list)
    undecided: list[Fitted] = field(default_factory=list)


def search(
    outputs: Sequence[FittedChannel],
    settings: SearchSettings,
    generator: np.random.Generator,
    divide: Divide = compute_here,
) -> Search:
    """Name and add effects to prepared outputs until none is worth it; the generator draws other starts of fits.

    A name that others are like may stand for two of them: in a single output that is searched without it too.
    """
    found = _search(outputs, settings, generator, divide)
    if len(outputs) > 1 or not any(each.alternatives for each in found.named[:1]):
        return found
    without = settings.model_copy(update={"left_out": [*settings.left_out, found.named[0].name]})
    other = _search(outputs, without, generator.spawn(1)[0], divide)
    (now,), (then,) = ([state.current for state in each.outputs] for each in (found, other))
    if len(other.named) < 2 or not is_worth(outputs[0], now.raw, then.raw, settings):
        return found
    best = compare_by(outputs[0].output, then.residual, settings.largest_jitter)
    gain = min(best.score(then.residual) - best.score(now.residual), settings.most_evidence)
    doubt = float(np.exp(-max(gain + np.log(settings.family_prior), 0.0)))
    other.named = [replace(each, probability=min(each.probability, 1.0 - doubt)) for each in other.named]
    other.rounds[0] = _keep_beside(other.rounds[0], found.rounds[0], found.named[0].name, doubt)
    return other


def _keep_beside(looked: Round, first: Round, name: str, probability: float) -> Round:
    """Return a round that was made without a name with that name in it, as another round found it, so probable."""
    verdicts = looked.verdicts
    names = {each: (1.0 - probability) * its for each, its in verdicts.names.items()} | {name: probability}
    return replace(
        looked,
        verdicts=replace(verdicts, names=names, forms={**verdicts.forms, name: first.verdicts.forms[name]}),
        gaps={**looked.gaps, name: first.gaps[name]},
        heldout={**looked.heldout, name: first.heldout[name]},
        sites={**looked.sites, name: first.sites[name]},
    )


def _search(
    outputs: Sequence[FittedChannel], settings: SearchSettings, generator: np.random.Generator, divide: Divide
) -> Search:
    found = Search(list(outputs))
    found.steps.append([state.nominal for state in outputs])
    while len(found.named) < settings.most_effects:
        looked, choices = rank(found.outputs, settings, divide)
        if _find_better_constants(found, choices):
            continue
        found.rounds.append(looked)
        if looked.named is not None:
            _take(found, looked.named, choices, settings, generator, divide)
            continue
        both = _take_two(found, choices, settings, generator, divide)
        if both is not None:
            found = both
            continue
        effects = [each for each in looked.verdicts.forms if each not in looked.verdicts.families]
        if effects:
            likeliest = max(effects, key=looked.verdicts.names.__getitem__)
            found.undecided = carry(found.outputs, choices, looked.verdicts, likeliest)
        break
    found.named = [_doubt_beside_bounds(named, found, settings) for named in found.named]
    return found


def _take(
    found: Search,
    named: Named,
    choices: Sequence[Choice],
    settings: SearchSettings,
    generator: np.random.Generator,
    divide: Divide,
) -> None:
    """Add an effect to a search, no more probable than those of its channel and elements that it was found beside."""
    _add(found, named, choices, generator, divide)
    there = [each for each in found.named if each.channel == named.channel]
    sure = min([1.0, *(each.probability for each in there if {*each.elements} & {*named.elements})])
    found.named.append(replace(named, probability=sure * named.probability))
    _take_out_redundant(found, settings)
    found.steps.append([state.current for state in found.outputs])


def _take_two(
    found: Search,
    choices: Sequence[Choice],
    settings: SearchSettings,
    generator: np.random.Generator,
    divide: Divide,
) -> Search | None:
    """Return a search with two more effects where its last round found a memory likelier than any: it may be both.

    The likeliest is added; with the one that is named beside it on the same elements, it has to predict trials left out
    better than the memory does. None if it does not: an element with one of the two alone has nothing that is both.
    """
    looked, known = found.rounds[-1], len(found.named)
    names, first = looked.verdicts.names, looked.likeliest
    if first is None or names.get(MEMORY, 0.0) < max(names.values()) or known + 2 > settings.most_effects:
        return None
    nameless = {each: names[each] for each in (NONE, *looked.verdicts.families)}
    others = sum(its for each, its in names.items() if each not in nameless)
    both = Search([*found.outputs], [*found.rounds], [*found.named], [*found.steps])
    _take(both, replace(first, probability=first.probability / others), choices, settings, generator, divide)
    again, beside = rank(both.outputs, settings, divide)
    if again.named is None or {*again.named.elements} != {*first.elements}:
        return None
    _take(both, again.named, beside, settings, generator, divide)
    if len(both.named) < known + 2:
        return None
    changed = [each for each in zip(found.outputs, both.outputs, strict=True) if each[0] is not each[1]]
    gain = min(sum(_compare_with_memory(*each, settings) for each in changed), settings.most_evidence)
    doubt = float(np.exp(-max(gain + np.log(settings.family_prior), 0.0)))
    if doubt > 1.0 - settings.certain:
        return None
    both.named[known:] = [replace(each, probability=min(each.probability, 1.0 - doubt)) for each in both.named[known:]]
    left = doubt / sum(nameless.values())
    told = {name: its * (left if name in nameless else (1.0 - doubt) / others) for name, its in names.items()}
    verdicts = replace(looked.verdicts, names=told)
    both.rounds[-1:] = [replace(looked, verdicts=verdicts, named=both.named[known]), again]
    return both


def _compare_with_memory(before: FittedChannel, after: FittedChannel, settings: SearchSettings) -> float:
    """Return by how much, nats, a fit predicts trials left out better than one with a memory, a static map or none."""
    output, fitted, largest = before.output, after.current, settings.largest_jitter
    noise: Noise | TrialNoise = make_plain(fitted.fit.spread)
    if output.jitters:
        noise = estimate_trial_noise(fitted.residual, output, largest)
    lawless = before.static_map
    remembering = [before.current.refit(noise, each) for each in (before.memory, join(lawless, before.memory))]
    naming = [fitted, fitted.refit(noise, lawless)]
    best = min((*remembering, *naming), key=lambda each: float((each.residual**2).sum()))
    scores = compare_by(output, best.residual, largest)
    named, remembered = (max(scores.score(each.residual) for each in some) for some in (naming, remembering))
    return named - remembered


def _doubt_beside_bounds(named: Named, found: Search, settings: SearchSettings) -> Named:
    """Return an effect, no more than possible if where it is another stands at a bound: it may stand for its rest.

    What exact values show stands for nothing else.
    """
    fits = [state.current for state in found.outputs if named.is_in(state.output)]
    stuck = any({*list_stuck(each)} - {named.name} for each in fits)
    stands_in = stuck and not named.shown
    return replace(named, probability=min(named.probability, settings.certain)) if stands_in else named


def list_stuck(fitted: Fitted) -> list[str]:
    """Return the names of the effects whose magnitude is at a bound other than zero."""
    place, stuck = len(fitted.fit.model.output.constants), []
    for form in fitted.forms:
        if not fitted.fit.free[place] and fitted.fit.values[place] != 0.0:
            stuck.append(form.name)
        place += len(form.parameters)
    return stuck


def _find_better_constants(found: Search, choices: Sequence[Choice]) -> bool:
    """Take over constants that a form with a threshold found, where they alone are better; return whether any are."""
    better = False
    for place, state in enumerate(found.outputs):
        least = BETTER * float(state.current.raw.sum())
        for fitted in choices[place].values():
            if fitted.forms[-1].scales or fitted.raw.sum() >= least:
                continue
            known = len(state.current.fit.values)
            again = refine(state.current.fit.model, fitted.fit.values[:known], fitted.fit.spread)
            if again.raw.sum() < least:
                found.outputs[place] = state.continue_from(again)
                better, least = True, BETTER * float(again.raw.sum())
    if better:
        found.steps[-1] = [state.current for state in found.outputs]
    return better


def _add(
    found: Search, named: Named, choices: Sequence[Choice], generator: np.random.Generator, divide: Divide
) -> None:
    form_of = dict(zip(named.elements, named.forms, strict=True))
    carriers = [place for place, state in enumerate(found.outputs) if named.is_in(state.output)]
    chosen = [choices[place][named.name, form_of[found.outputs[place].output.element]] for place in carriers]
    tasks = list(zip([found.outputs[place] for place in carriers], chosen, generator.spawn(len(carriers)), strict=True))
    added = divide(lambda each: _carry(*each), tasks, list_kept(found.outputs))
    for place, state in zip(carriers, added, strict=True):
        found.outputs[place] = state
        _correct_others(found, place)


def _carry(state: FittedChannel, chosen: Fitted, generator: np.random.Generator) -> FittedChannel:
    """Return an output whose present fit carries a chosen form.

    It is the best of fits that begin at other values of the form's parameters, the chosen one among them.
    """
    model, noise = chosen.fit.model, chosen.estimate_noise()
    newest = model.forms[-1]
    known, fixed = len(chosen.fit.values) - len(newest.parameters), len(model.output.constants)
    found = [chosen.fit]
    bases = [chosen.fit.values[:known]]
    if not newest.scales:  # what sets in somewhere may leave constants far astray
        bases.append(np.concatenate([model.prior[0][:fixed], chosen.fit.values[fixed:known]]))
    for base, start in product(bases, list_starts(newest, 1 if model.output.shows(newest) else FRESH_STARTS)):
        values = np.concatenate([base, [start[each.name] for each in newest.parameters]])
        found.append(fit(model, noise, values, iterations=LONG))
    if not newest.scales:
        noise = make_plain(chosen.fit.spread)
        middle = min(found, key=lambda each: each.cost(noise)).values
        for drawn in generator.standard_normal((NEARBY_STARTS, len(middle))):
            found.append(fit(model, noise, middle + NEARBY * model.prior[1] * drawn, iterations=LONG))
    best = min(found, key=lambda each: each.cost(noise))
    return state.continue_from(refine(model, best.values, best.spread))


def _correct_others(found: Search, place: int) -> None:
    """Correct the inputs of other output channels for the sensor effects that were found, and prepare these again.

    What was named there stays, fitted again: where it stood for the sensor's effect, nothing is left for it to explain.
    """
    fits = [state.current for state in found.outputs]
    for other, state in enumerate(found.outputs):
        if other != place and state.output.element == found.outputs[place].output.element:
            recorded = found.steps[0][other].fit.model.output
            corrected = correct_inputs(recorded, fits)
            if corrected is not recorded:
                found.outputs[other] = prepare(corrected)
                if state.current.forms:
                    again = state.current.put_in(corrected).refit(make_plain(state.current.fit.spread))
                    found.outputs[other] = found.outputs[other].continue_from(again)


def _take_out_redundant(found: Search, settings: SearchSettings) -> None:
    """Remove an earlier effect that a later one has made redundant."""
    for named in found.named[:-1]:
        keep: list[tuple[int, Fitted]] = []
        worth = False
        for place, state in enumerate(found.outputs):
            if not named.is_in(state.output):
                continue
            without = state.current.drop_effects([named.name], state.noise)
            keep.append((place, without))
            own = [form for form in state.current.forms if form.name == named.name]
            worth |= any(map(state.output.shows, own)) or is_worth(state, without.raw, state.current.raw, settings)
        if not worth:
            for place, without in keep:
                found.outputs[place] = replace(found.outputs[place], current=without)
            del found.steps[1 + found.named.index(named)]
            found.named.remove(named)
            return
