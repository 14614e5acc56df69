"""One round of the search: how probable each name is, and which of them is worth adding.

Outputs at their present fits and what each effect promises there flow in; probabilities, gaps and a name flow out.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stages.science.discrepancy.evidence import MEMORY, NONE, STATIC_MAP, Beside, Verdicts, weigh_names
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel, fit_plain, list_kept
from stages.science.discrepancy.screening import Screened, screen, split_forms
from stages.science.discrepancy.settings import SearchSettings
from stages.science.discrepancy.trial_scores import TrialScores, compare_by
from stages.science.output_channels.families import join
from stages.science.output_channels.noise import Noise, make_plain
from stages.science.output_channels.output_channel import Divide, OutputChannel
from stages.science.output_channels.trial_noise import TrialNoise, estimate_trial_noise, split_residual
from stages.science.plant.effect import NamedEffect
from stages.science.signals.trajectories import Array

Choice = dict[tuple[str, str], Fitted]
"""By name and form: the fit of one output that carries it."""


class Left(NamedTuple):
    """What models leave of an output, squares of left-out trials (K,): families, and all beside a static map."""

    families: Mapping[str, Array]
    beside: Mapping[tuple[str, str], Array]


PASSES = 2
"""Times that candidates are fitted under the noise of trials that the best of them leaves."""
NEAR_BEST = 1.25
"""Sum of squares over that of the best form, up to which a form is fitted under its own noise too, and over that of a
static map, up to which the map is not clearly better."""


@dataclass(frozen=True)
class Named:
    """One effect that was added, and its form on each element that carries it."""

    name: str
    forms: tuple[str, ...]
    site: str
    channel: str
    elements: tuple[str, ...]
    probability: float
    alternatives: tuple[str, ...]
    shown: bool = False
    p_value: float = 1.0

    def is_in(self, output: OutputChannel) -> bool:
        """Return whether an output carries it."""
        return output.channel == self.channel and output.element in self.elements

    def doubt(self, doubt: float) -> float:
        """Return its probability, at most that of no effect without a name in its place unless exact values show it."""
        return min(self.probability, 1.0 if self.shown else 1.0 - doubt)


@dataclass(frozen=True)
class Round:
    """One round of the search: every candidate's probability and what it would leave, and what was done.

    The likeliest effect of those that are worth it was `named` if it is likelier than nothing and any family.
    """

    verdicts: Verdicts
    confounded_with_constants: Mapping[str, float]
    gaps: Mapping[str, float]
    heldout: Mapping[str, float]
    sites: Mapping[str, str]
    likeliest: Named | None
    named: Named | None


def _list_candidates(
    outputs: Sequence[FittedChannel], settings: SearchSettings, divide: Divide
) -> list[list[Screened]]:
    """Return the screening results of outputs, as gaps may show only with a form; gains are zero if none matters."""
    least, worth = 0.5 * (settings.smallest_gap - 1.0), set()
    fresh = [state for state in outputs if state.promises is None]
    tasks = [(state, part) for state in fresh for part in split_forms(state.list_absent())]
    kept = [*list_kept(fresh), *(form for _, part in tasks for form in part)]
    found = divide(lambda each: screen(each[0].current.fit, each[0].noise, each[1]), tasks, kept)
    for state in fresh:
        both = zip(tasks, found, strict=True)
        state.promises = [each for (its, _), promised in both if its is state for each in promised]
    listed = [[each for each in state.promises or () if each.form.name not in settings.left_out] for state in outputs]
    for state, promised in zip(outputs, listed, strict=True):
        gap = state.ratio(state.current.raw) > 1.0 + least
        if gap or any(each.raw_gain > least or state.output.shows(each.form) for each in promised):
            worth.add(state.output.channel)
    for place in [place for place, state in enumerate(outputs) if state.output.channel not in worth]:
        listed[place] = [replace(each, gain=0.0, raw_gain=0.0) for each in listed[place]]
    return listed


def rank(outputs: Sequence[FittedChannel], settings: SearchSettings, divide: Divide) -> tuple[Round, list[Choice]]:
    """Return the probabilities of the names and, for each output channel, the fits of the shortlisted forms."""
    candidates = _list_candidates(outputs, settings, divide)
    close = _shortlist(outputs, candidates, settings)
    chosen = [
        [each for each in listed if (state.output.channel, each.form.name, each.form.form) in close]
        for state, listed in zip(outputs, candidates, strict=True)
    ]
    tasks = list(zip(outputs, chosen, strict=True))
    choices = divide(lambda each: extend(*each), tasks, list_kept(outputs))
    offered = [each.form for listed in candidates for each in listed]
    names = sorted({form.name for form in offered})
    halved = {name: 0.5 ** min(len(form.parameters) for form in offered if form.name == name) for name in names}
    every = sum(halved.values()) / (1.0 - settings.none_prior - settings.family_prior)
    priors = {name: each / every for name, each in halved.items()}
    priors |= {NONE: settings.none_prior, MEMORY: settings.family_prior, STATIC_MAP: settings.static_prior}
    alone, beside, left = _score_all(outputs, candidates, choices, settings, divide)
    look = _Look(outputs, choices, left, settings)

    def worth(name: str, probable: list[str], likely: Collection[str], carries: Array, mapped: bool) -> bool:
        forms = look.choose_forms(name, probable, likely)
        return name == MEMORY or bool(look.list_carriers(name, forms, carries, mapped))

    channels = [state.output.channel for state in outputs]
    verdicts = weigh_names(alone, beside, channels, priors, settings.most_evidence, worth)
    forms = {name: look.choose_forms(name, its, verdicts.likely[name]) for name, its in verdicts.forms.items()}
    verdicts = look.believe_exact(replace(verdicts, forms=forms))
    raws = {name: [each.raw for each in carry(outputs, choices, verdicts, name)] for name in names}
    raws |= {family: [each.families[family] for each in left] for family in (NONE, *verdicts.families)}
    gaps, heldout = {}, {}
    for name, squares in raws.items():
        both = list(zip(outputs, squares, strict=True))
        gaps[name] = float(np.sqrt(np.mean([state.ratio(raw) ** 2 for state, raw in both])))
        squared = [raw.sum() / state.samples.sum() / state.output.range**2 for state, raw in both]
        heldout[name] = float(np.sqrt(np.mean(squared)))
    likeliest = look.find_likeliest(verdicts, gaps)
    rivals = [verdicts.names[each] for each in (NONE, *verdicts.families)]
    named = likeliest if likeliest and likeliest.probability > max(rivals) else None
    spoken = (named.name, *named.alternatives) if named else ()
    sites: dict[str, str] = {}
    confounded: dict[str, float] = {}
    for place, listed in enumerate(candidates):
        for each in [each for each in listed if verdicts.forms[each.form.name][place] == each.form.form]:
            name = each.form.name
            sites[name] = each.form.site
            if name not in spoken:
                confounded[name] = min(each.confounded_with_constants, confounded.get(name, np.inf))
    return Round(verdicts, confounded, gaps, heldout, sites, likeliest, named), choices


def carry(outputs: Sequence[FittedChannel], choices: Sequence[Choice], verdicts: Verdicts, name: str) -> list[Fitted]:
    """Return the fits of outputs with a name, on those that carry it more probably than not."""
    carried = zip(outputs, choices, verdicts.forms[name], verdicts.carries[name], strict=True)
    return [fits.get((name, form), state.current) if its > 0.5 else state.current for state, fits, form, its in carried]


@dataclass(frozen=True)
class _Look:
    """One look at outputs: the fits of the shortlisted forms in each, and what models leave there."""

    outputs: Sequence[FittedChannel]
    choices: Sequence[Choice]
    left: Sequence[Left]
    settings: SearchSettings

    def choose_forms(self, name: str, probable: Sequence[str], likely: Collection[str]) -> list[str]:
        """Return the form of a name with the smallest gap in its channel, of those that are likely and fitted.

        Those that begin at a moment all count, as a static map beside one may undo what that says. Where there is none,
        it is the most probable.
        """
        squares: dict[str, dict[str, float]] = {state.output.channel: {} for state in self.outputs}
        for channel, own in squares.items():
            both = zip(self.outputs, self.choices, strict=True)
            its = [(state, fits) for state, fits in both if state.output.channel == channel]
            known = [
                form
                for _, fits in its
                for (each, form), fitted in fits.items()
                if each == name and (form in likely or fitted.forms[-1].begins_later)
            ]
            for form in dict.fromkeys(known):
                own[form] = sum(state.ratio(fits.get((name, form), state.current).raw) ** 2 for state, fits in its)
        channels = [squares[state.output.channel] for state in self.outputs]
        return [min(own, key=own.__getitem__, default=form) for own, form in zip(channels, probable, strict=True)]

    def believe_exact(self, verdicts: Verdicts) -> Verdicts:
        """Return the verdicts with effects that exactly repeated values show as nearly certain, whatever their gain."""
        sure = 1.0 - self.settings.family_prior
        for name, forms in verdicts.forms.items():
            fits = [choice.get((name, form)) for choice, form in zip(self.choices, forms, strict=True)]
            both = zip(self.outputs, fits, strict=True)
            shown = [fitted is not None and _is_shown(state, fitted) for state, fitted in both]
            if any(shown) and verdicts.names[name] < sure:
                carries = np.where(shown, 1.0, verdicts.carries[name])
                rest = (1.0 - sure) / (1.0 - verdicts.names[name])
                names = {other: sure if other == name else rest * each for other, each in verdicts.names.items()}
                return replace(verdicts, names=names, carries={**verdicts.carries, name: carries})
        return verdicts

    def list_carriers(self, name: str, forms: Sequence[str], carries: Array, mapped: bool) -> list[int]:
        """Return the outputs that carry a name: probable, and with a gain that is worth it; none if all are too small.

        A name that is likelier beside a static map has to gain beside it. In parts of one record, where a movement
        repeats and a map of it tells whatever follows from it, it has to gain alone, and beside a map only if that
        alone leaves clearly less than the name alone.
        """
        gains = {}
        for place, state in enumerate(self.outputs):
            fitted = self.choices[place].get((name, forms[place]))
            if fitted is None or carries[place] <= 0.5:
                continue
            alone, kept, key = (state.current.raw, fitted.raw), self.left[place], (name, forms[place])
            beside = (kept.beside[NONE, ""], kept.beside[key]) if mapped and key in kept.beside else alone
            better = NEAR_BEST * kept.families[STATIC_MAP].sum() < fitted.raw.sum()
            judged = [beside] if state.output.jitters else [alone, beside] if better else [alone]
            before = min(state.ratio(_level(*both), both[1]) for both in judged)
            if all(is_worth(state, *both, self.settings) for both in judged):
                gains[place] = before
            elif _is_shown(state, fitted):
                gains[place] = max(before, np.nextafter(self.settings.smallest_gap, np.inf))
        best = max(gains, key=gains.__getitem__, default=None)
        if best is None or gains[best] <= self.settings.smallest_gap:
            return []
        # one name at one place of the chain: where it gains most
        return [place for place in gains if self.outputs[place].output.channel == self.outputs[best].output.channel]

    def find_likeliest(self, verdicts: Verdicts, gaps: Mapping[str, float]) -> Named | None:
        """Return the most probable of the effects that close what matters, if any does."""
        carried = {
            name: self.list_carriers(name, forms, verdicts.carries[name], verdicts.mapped[name])
            for name, forms in verdicts.forms.items()
            if name not in verdicts.families
        }
        possible = [name for name in carried if carried[name]]
        if not possible:
            return None
        best = max(possible, key=lambda name: verdicts.names[name])
        closed = {name: gaps[NONE] - gaps[name] for name in possible}
        like = (1.0 - self.settings.ambiguous_share) * closed[best]
        carriers, states = carried[best], [self.outputs[place] for place in carried[best]]
        alternatives = tuple(
            name
            for name in sorted(possible, key=gaps.__getitem__)
            if name != best and closed[name] > like and {*carried[name]} & {*carriers}
        )
        forms = tuple(verdicts.forms[best][place] for place in carriers)
        fits = [self.choices[place][best, form] for place, form in zip(carriers, forms, strict=True)]
        site, shown = fits[0].forms[-1].site, any(map(_is_shown, states, fits))
        channel, elements = states[0].output.channel, tuple(each.output.element for each in states)
        return Named(best, forms, site, channel, elements, verdicts.names[best], alternatives[:2], shown)


def _is_shown(state: FittedChannel, fitted: Fitted) -> bool:
    """Return whether exactly repeated values show a form's level, and the simulation would exceed it."""
    before, after = (float((each.fit.residual**2).sum()) for each in (state.current, fitted))
    return state.output.shows(fitted.forms[-1]) and after < before


def _score_all(
    outputs: Sequence[FittedChannel],
    candidates: Sequence[Sequence[Screened]],
    choices: Sequence[Choice],
    settings: SearchSettings,
    divide: Divide,
) -> tuple[Beside, Beside, list[Left]]:
    """Return the scores of all models, a memory among them, without and with a static map, and what each leaves.

    A form that starts as a static map is not looked at beside one, and one that is fitted as such says nothing there.
    """
    corrected = _fit_corrected(outputs, choices)
    extended = [dict(choice) for choice in choices]
    for place, _, sensor, fitted in corrected:
        extended[place][sensor] = fitted
    open_channels = {
        state.output.channel
        for state, own in zip(outputs, choices, strict=True)
        for each in (state.current, *own.values())
        if state.ratio(state.current.raw, each.raw) > settings.smallest_gap
    }
    found = divide(
        lambda each: _score_output(*each, each[0].output.channel in open_channels, settings),
        list(zip(outputs, extended, strict=True)),
    )
    laws = np.log([1.0 - settings.static_prior, settings.static_prior])
    elsewhere: dict[tuple[str, str], dict[int, tuple[str, float]]] = {}
    for place, source, sensor, _ in corrected:
        without, having = ([here[each] for here in found[place][0]] for each in ((NONE, ""), sensor))
        gain = float(np.max(laws + having) - np.max(laws + without))
        elsewhere.setdefault(sensor, {})[source] = outputs[place].output.channel, gain
        for here in found[place][0]:
            del here[sensor]
    both = []
    for mapped, scores in zip((False, True), zip(*(scores for scores, _ in found), strict=True), strict=True):
        none = np.array([each[NONE, ""] for each in scores])
        forms: dict[tuple[str, str], dict[int, float]] = {}
        for place, (listed, own) in enumerate(zip(candidates, scores, strict=True)):
            looked = [each.form for each in listed if not (mapped and _is_static(outputs[place], each.form, settings))]
            for key in [*((form.name, form.form) for form in looked), *(key for key in own if key[0] == MEMORY)]:
                forms.setdefault(key, {})[place] = own.get(key, none[place])
        both.append(Beside(none, forms, elsewhere))
    return both[0], both[1], [left for _, left in found]


def _fit_corrected(
    outputs: Sequence[FittedChannel], choices: Sequence[Choice]
) -> list[tuple[int, int, tuple[str, str], Fitted]]:
    """Return what effects of sensors do to other outputs of the element: place, candidate's place, key and fit."""
    corrected = []
    for source, key, chosen in [(source, *each) for source, choice in enumerate(choices) for each in choice.items()]:
        form, values = chosen.effects[-1]
        for place, state in enumerate(outputs):
            if place == source or outputs[source].output.element != state.output.element:
                continue
            output = state.output.correct([(form.name, form.form, values)])
            if output is not state.output:
                fitted = state.current.put_in(output).refit(make_plain(state.current.fit.spread))
                corrected.append((place, source, key, fitted))
    return corrected


def _score_output(
    state: FittedChannel, choice: Choice, gap: bool, settings: SearchSettings
) -> tuple[list[dict[tuple[str, str], float]], Left]:
    """Return the scores of an output's models, under one noise if trials jitter, and what each leaves."""
    output, largest, far = state.output, settings.largest_jitter, settings.clear_ratio**2
    first: Choice = {(NONE, ""): state.current, **choice}
    if not choice and not gap:
        families = dict.fromkeys((NONE, STATIC_MAP, MEMORY), state.current.raw)
        return [dict.fromkeys(first, 0.0)] * 2, Left(families, {(NONE, ""): state.current.raw})

    def find_best(fits: Iterable[Fitted]) -> Array:
        residuals = [each.residual for each in fits]
        return min(residuals, key=lambda each: float((split_residual(each, output)[0] ** 2).sum()))

    def judge_by(each: Fitted) -> Noise | TrialNoise:
        return common if output.jitters else make_plain(each.fit.spread)

    alone, common = dict(first), estimate_trial_noise(find_best(first.values()), output, largest)
    for _ in range(PASSES if output.jitters else 0):
        alone = {key: each.refit(common) for key, each in first.items()}
        common = estimate_trial_noise(find_best(alone.values()), output, largest)
    beside, families = dict(alone), dict.fromkeys((NONE, STATIC_MAP, MEMORY), state.current.raw)
    if gap:
        beside = {key: each.refit(judge_by(each), state.map_beside(each)) for key, each in alone.items()}
        nothing = alone[NONE, ""]
        alone[MEMORY, ""] = nothing.refit(judge_by(nothing), state.memory)
        remembering = nothing.refit(judge_by(nothing), join(state.static_map, state.memory))
        if output.jitters:  # in parts of one record a movement repeats, and a map of it tells whatever follows from it
            scores = compare_by(output, find_best([*alone.values(), *beside.values()]), largest)
            beside = _share_maps(alone, beside, common, scores, settings)
            again = nothing.refit(common, join(beside[NONE, ""].blocks, state.memory))
            remembering = max(again, remembering, key=lambda each: scores.score(each.residual))
        beside[MEMORY, ""] = remembering
        lost = alone[MEMORY, ""].raw.sum() > far * nothing.raw.sum()
        families |= {STATIC_MAP: beside[NONE, ""].raw, MEMORY: (nothing if lost else alone[MEMORY, ""]).raw}
    scores = compare_by(output, find_best([*alone.values(), *beside.values()]), largest)
    added = [key for key in choice if choice[key].fit.model.output is output]
    telling = {key: each for key, each in beside.items() if key not in added or not _is_patch(each, settings)}
    told = [{key: scores.score(each.residual) for key, each in fits.items()} for fits in (alone, telling)]
    for own, fits in zip(told, (alone, telling), strict=True):
        most, at_most = far * fits[NONE, ""].raw.sum(), own[NONE, ""]
        own.update({key: min(own[key], at_most) for key, each in fits.items() if each.raw.sum() > most})
    return told, Left(families, {key: each.raw for key, each in beside.items()})


def _is_static(state: FittedChannel, form: NamedEffect, settings: SearchSettings) -> bool:
    """Return whether a form at the last of its starts is a static map itself."""
    start = {each.name: each.starts[-1] for each in form.parameters}
    return state.output.find_past_share(form, start) < settings.least_share


def _is_patch(fitted: Fitted, settings: SearchSettings) -> bool:
    """Return whether a form was added to an output, and as it was fitted it is a static map itself."""
    output = fitted.fit.model.output
    return any(output.find_past_share(*each) < settings.least_share for each in fitted.effects[-1:])


def _share_maps(
    alone: Choice, beside: Choice, noise: TrialNoise, scores: TrialScores, settings: SearchSettings
) -> Choice:
    """Return the better fits beside the static map that serves nothing best: no map owes its success to a name.

    A map's priors and a fit's constants have local optima. Those of a name are tried without it, and the best map found
    without any name is then tried beside each that is not a static map itself.
    """

    def measure(each: Fitted) -> float:
        return scores.score(each.residual)

    nothing = NONE, ""
    least = measure(beside[nothing])
    shared = [key for key in beside if key != nothing and beside[key].fit.model.output is scores.output]
    better = [beside[key] for key in shared if measure(beside[key]) > least]
    best = max([beside[nothing], *(each.drop_effects([each.forms[-1].name], noise) for each in better)], key=measure)
    looked = [key for key in shared if not _is_patch(beside[key], settings)]
    again = {key: alone[key].put_newest_in(best, noise) for key in looked}
    return {**beside, nothing: best, **{key: max(again[key], beside[key], key=measure) for key in looked}}


def _shortlist(
    outputs: Sequence[FittedChannel], candidates: Sequence[Sequence[Screened]], settings: SearchSettings
) -> set[tuple[str, str, str]]:
    """Return channel, name and form of the best screening results, summed over the muscles of a channel.

    Forms that are a static map, which a wrong law makes promising, are listed apart: they displace no other.
    """
    promised: dict[tuple[str, str, str], Array] = {}
    static: dict[tuple[str, str, str], bool] = {}
    kept: set[tuple[str, str, str]] = set()
    for state, listed in zip(outputs, candidates, strict=True):
        for each in listed:
            key = (state.output.channel, each.form.name, each.form.form)
            kept |= {key} if state.output.shows(each.form) else set()
            gains = np.maximum([each.gain, each.raw_gain], 0.0)
            promised[key] = promised.get(key, np.zeros(2)) + gains
            static[key] = static.get(key) or _is_static(state, each.form, settings)
    for kind in {(key[0], static[key]) for key in promised}:
        own = {key: each for key, each in promised.items() if (key[0], static[key]) == kind}
        for scale, most in ((0, settings.shortlist), (1, (settings.shortlist + 1) // 2)):
            kept |= _take_best({key: float(each[scale]) for key, each in own.items()}, most)
    return kept


def _take_best(promised: Mapping[tuple[str, str, str], float], most: int) -> set[tuple[str, str, str]]:
    """Return the best two forms of the best `most` names."""
    names: dict[str, list[tuple[str, str, str]]] = {}
    for key in sorted((key for key in promised if promised[key] > 0.0), key=lambda key: (-promised[key], key)):
        if key[1] in names or len(names) < most:
            names.setdefault(key[1], []).append(key)
    return {key for keys in names.values() for key in keys[:2]}


def extend(state: FittedChannel, chosen: Sequence[Screened]) -> Choice:
    """Fit an output channel with each form added in turn; those near the best also under their own noise."""
    spread = float(np.sqrt(state.current.raw.sum() / max(state.samples.sum(), 1.0)))
    plain: Choice = {}
    for each in chosen:
        model = replace(state.current.fit.model, forms=(*state.current.forms, each.form))
        start = np.concatenate([each.known, [each.start[own.name] for own in each.form.parameters]])
        plain[each.form.name, each.form.form] = fit_plain(model, start, spread)
    near = NEAR_BEST * min((float(fitted.raw.sum()) for fitted in plain.values()), default=0.0)
    return {key: fitted.refit_coloured() if fitted.raw.sum() < near else fitted for key, fitted in plain.items()}


def is_worth(state: FittedChannel, without: Array, having: Array, settings: SearchSettings) -> bool:
    """Return whether an effect takes enough of an output's gap, by squares (K,) that fits without and with it leave.

    Enough is a share of the first gap above the floor or, where that is less, of what is left: the first gap may be one
    beside which all is small. No trial counts for more than all others together.
    """
    before, after, first = (state.ratio(each, having) for each in (_level(without, having), having, state.nominal.raw))
    needed = min(settings.least_share * (first - 1.0), settings.least_rest * before)
    return before - after > max(settings.unexplained_share * (settings.smallest_gap - 1.0), needed)


def _level(without: Array, having: Array) -> Array:
    """Return the squares, (K,), of a fit without an effect, by which no trial gains more than all others together."""
    gain = without - having
    most = int(np.argmax(gain))
    gain[most] = min(gain[most], max(float(gain.sum() - gain[most]), 0.0))
    return having + gain
