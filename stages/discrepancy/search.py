"""The search for what is missing: locate, name, add, and repeat until what is left is noise or has no name.

Cells with their trials flow in; out flow the rounds of the search, each with its ranking, and for every cell the
nominal fit, the fit with what was named, and what a flexible model would leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from stages.discrepancy.cell import Cell, Form, list_starts
from stages.discrepancy.evidence import NONE, Verdicts, weigh_names
from stages.discrepancy.features import build_features
from stages.discrepancy.fitting import Fit, Model, begin, fit
from stages.discrepancy.flexible import (
    Leftover,
    explain_by_features,
    explain_by_memory,
    explain_by_trees,
    keep_least,
)
from stages.discrepancy.noise import Noise, estimate_noise, log_density, make_plain
from stages.discrepancy.screening import Screened, screen
from stages.signals.trajectories import Array


@dataclass(frozen=True)
class SearchSettings:
    """What the search was told; see the configuration for units and reasons."""

    smallest_gap: float
    least_gain: float
    least_share: float
    later_share: float
    later_gain: float
    later_rest: float
    unexplained_share: float
    imitation_share: float
    temper: float
    shortlist: int
    most_effects: int
    absorbed: float
    none_prior: float
    certain: float
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fitted:
    """A fit of one cell, judged on its trials, each left out.

    Parameters
    ----------
    fit : Fit
        Values and what leaving trials out changes.
    residual : (T, K) ndarray
        Of trials left out.
    raw : (K,) ndarray
        Its sums of squares, in the channel's unit.
    """

    fit: Fit
    residual: Array
    raw: Array

    @property
    def forms(self) -> tuple[Form, ...]:
        """Effects in the model."""
        return self.fit.model.forms

    @property
    def spread(self) -> float:
        """Root mean square of the residual of all trials, none left out, in the channel's unit."""
        return float(np.sqrt((self.fit.residual**2).sum() / max(self.fit.model.cell.present.sum(), 1)))

    def estimate_noise(self) -> Noise:
        """Return the noise that the residual most likely is."""
        cell = self.fit.model.cell
        return estimate_noise(self.residual, cell.present, cell.step_s)

    def density(self, noise: Noise) -> Array:
        """Return the log density of each trial's residual under a noise, (K,) ndarray."""
        cell = self.fit.model.cell
        return log_density(self.residual, cell.present, noise, cell.step_s)


@dataclass
class CellState:
    """One cell along the search."""

    cell: Cell
    noise: Noise
    nominal: Fitted
    current: Fitted
    leftover: Leftover

    @cached_property
    def features(self) -> Array:
        """Generic features of the cell, for a flexible model."""
        return build_features(self.cell)

    @cached_property
    def promises(self) -> list[Screened]:
        """What each form that it does not hold yet promises."""
        held = {form.name for form in self.current.forms}
        forms = [form for form in self.cell.forms if form.name not in held]
        return screen(self.current.fit, self.noise, forms)

    @property
    def samples(self) -> Array:
        """Samples of each trial, (K,)."""
        return self.cell.present.sum(axis=0).astype(float)

    @property
    def floor(self) -> float:
        """Root mean square that nothing reproducible explains, in the channel's unit."""
        least = min(self.leftover.raw.sum(), self.current.raw.sum(), self.nominal.raw.sum())
        return max(float(np.sqrt(least / self.samples.sum())), self.cell.resolution)

    def ratio(self, raw: Array, best: Array | None = None) -> float:
        """Return a gap over the floor, or over what the best fit known leaves, if that is less."""
        floor = self.floor if best is None else min(self.floor, float(np.sqrt(best.sum() / self.samples.sum())))
        floor = max(floor, self.cell.resolution)
        return float(np.sqrt(raw.sum() / self.samples.sum())) / floor


@dataclass(frozen=True)
class Named:
    """One effect that was added, in a form of its own on each element that carries it."""

    name: str
    forms: tuple[str, ...]
    site: str
    channel: str
    elements: tuple[str, ...]
    probability: float
    alternatives: tuple[str, ...]
    shown: bool = False

    def doubt(self, doubt: float) -> float:
        """Return its probability, less that of something without a name; what exact values show stays sure."""
        return min(self.probability * (1.0 if self.shown else 1.0 - doubt), 1.0)


@dataclass(frozen=True)
class Round:
    """One round of the search: every candidate's probability and what it would leave, and what was done."""

    verdicts: Verdicts
    absorbed: Mapping[str, float]
    gaps: Mapping[str, float]
    heldout: Mapping[str, float]
    sites: Mapping[str, str]
    named: Named | None


@dataclass
class Search:
    """How the search went: its cells now, what each round found, what was named, and all cells' fits at each step."""

    cells: list[CellState]
    rounds: list[Round] = field(default_factory=list)
    named: list[Named] = field(default_factory=list)
    steps: list[list[Fit]] = field(default_factory=list)


def prepare(cell: Cell) -> CellState:
    """Fit a cell's nominal constants, and estimate its noise from what a flexible model leaves."""
    model = Model(cell)
    rough = _fit_constants(model)
    features, by_trees = build_features(cell), explain_by_trees(cell, rough.residual)
    by_memory = explain_by_memory(cell, rough.residual)
    least = keep_least([by_trees, explain_by_features(rough.fit, features, None)], cell, by_memory=by_memory)
    noise = estimate_noise(least.residual, cell.present, cell.step_s)
    nominal = refine(model, rough.fit.values, rough.spread)
    by_features = explain_by_features(nominal.fit, features, noise)
    leftover = keep_least([by_trees, by_features], cell, by_memory=by_memory)
    return CellState(cell, noise, nominal, nominal, leftover)


def _fit_constants(model: Model) -> Fitted:
    """Fit constants as if their residual were white, from where they begin, and from wherever else a cell says."""
    cell, names = model.cell, [each.name for each in model.cell.constants]
    starts = [begin(model)]
    for other in cell.other_starts:
        told = dict(zip(names, begin(model), strict=True)) | other
        starts.append(np.array([told[name] for name in names]))
    return min((fit_plain(model, each, 0.01 * cell.range) for each in starts), key=lambda each: float(each.raw.sum()))


def resume(cell: Cell, values: Array, noise: Noise, residual: Array, left: Leftover) -> CellState:
    """Return a cell as `prepare` left it.

    Parameters
    ----------
    cell : Cell
        The same.
    values : (P,) ndarray
        Its fitted constants.
    noise : Noise
        Of the channel.
    residual : (T, K) ndarray
        Of each trial, left out of the fit.
    left : Leftover
        What a flexible model left of it.
    """
    found = fit(Model(cell), noise, values, iterations=0)
    nominal = Fitted(found, residual, (residual**2).sum(axis=0))
    return CellState(cell, noise, nominal, nominal, left)


def refine(model: Model, start: Array, spread: float) -> Fitted:
    """Fit a model as if its residual were white, then under the noise that it leaves; return what predicts better."""
    return colour(fit_plain(model, start, spread))


def fit_plain(model: Model, start: Array, spread: float) -> Fitted:
    """Fit a model as if its residual were white, of a root mean square `spread`.

    What another model left says little of this one's noise: a missing effect passes for wander, and under so much
    wander only steps would count.
    """
    plain = make_plain(spread)
    return assess(fit(model, plain, start), plain)


def colour(plain: Fitted) -> Fitted:
    """Fit a model once more, under the noise that it left; return what predicts better."""
    noise = plain.estimate_noise()
    coloured = assess(fit(plain.fit.model, noise, plain.fit.values, iterations=4), noise)
    return min(plain, coloured, key=lambda each: float(each.raw.sum()))


def assess(found: Fit, noise: Noise) -> Fitted:
    """Judge a fit on its trials, each left out; where that changes much, by fitting once more without the trial."""
    cell = found.model.cell
    residual = np.where(cell.present, found.leave_each_out(), 0.0)
    squares, inside = (residual**2).sum(axis=0), (found.residual**2).sum(axis=0)
    far = np.flatnonzero((squares > FAR * inside) & (squares > LARGE * squares.sum()))
    for trial in far if cell.trials > 2 else ():
        others = [k for k in range(cell.trials) if k != trial]
        without = fit(replace(found.model, cell=cell.take(others)), noise, found.values)
        alone = cell.take([int(trial)])
        left = alone.measured - replace(found.model, cell=alone).simulate(without.values)
        residual[:, trial] = np.where(alone.present, left, 0.0)[:, 0]
    return Fitted(found, residual, (residual**2).sum(axis=0))


def search(cells: Sequence[CellState], settings: SearchSettings, generator: np.random.Generator) -> Search:
    """Name and add effects until none is worth it.

    Parameters
    ----------
    cells : sequence of CellState
        Prepared.
    settings : SearchSettings
        When a gap matters and a name is accepted.
    generator : numpy.random.Generator
        Draws weights of trials.
    """
    found = Search(list(cells))
    found.steps.append([state.nominal.fit for state in cells])
    while len(found.named) < settings.most_effects:
        candidates = _list_candidates(found, settings)
        looked, choices = rank(found, candidates, settings, generator)
        if _find_better_constants(found, choices):
            continue
        found.rounds.append(looked)
        if looked.named is None:
            break
        _add(found, looked.named, choices, generator)
        found.named.append(looked.named)
        _take_out_redundant(found, settings)
        found.steps.append([state.current.fit for state in found.cells])
    return found


FRESH_STARTS, LONG = 4, 30
"""Other starts from which a named effect is fitted once more, and steps of such a fit."""

NEARBY_STARTS, NEARBY = 8, 0.1
"""Starts about a fit of what sets in somewhere, as its cost has small hollows; how far off, in deviations of priors."""

AS_MUCH, LIKE = 0.985, 0.95
"""Shares of what the best name closes: above the first, a simpler name is preferred; above the second, not excluded."""

NOT_WORTH = 1.0
"""Fall of a trial's score, in a cell, of a form that did not seem worth a full fit there."""

BETTER = 0.9
"""Sum of squares, over the present one, below which constants that a candidate has found are taken alone."""

FAR, LARGE = 4.0, 0.1
"""Sum of squares of a trial left out, over that when it is not, and over all trials', above which a fit is repeated."""

SURE = 0.99
"""Probability of what exact values show."""

SHOWN = 0.98
"""Sum of squares of all trials, none left out, over that before, below which a level that they show takes effect."""

NEAR = 1.25
"""Sum of squares, over that of the best form in a cell, up to which a form is fitted under its own noise too."""

Choice = dict[tuple[str, str], Fitted]
"""By name and form: the fit of one cell that carries it."""


def _find_better_constants(found: Search, choices: Sequence[Choice]) -> bool:
    """Let a cell go on from the constants of a candidate, where these alone are better; return whether one does.

    A form that sets in somewhere is tried from several constants, and may have found a better place for them by chance.
    """
    better = False
    for place, state in enumerate(found.cells):
        least = BETTER * float(state.current.raw.sum())
        for fitted in choices[place].values():
            if fitted.forms[-1].scales or fitted.raw.sum() >= least:
                continue
            known = len(state.current.fit.values)
            again = refine(state.current.fit.model, fitted.fit.values[:known], fitted.spread)
            if again.raw.sum() < least:
                found.cells[place] = _go_on(state, again)
                better, least = True, BETTER * float(again.raw.sum())
    if better:
        found.steps[-1] = [state.current.fit for state in found.cells]
    return better


def _list_candidates(found: Search, settings: SearchSettings) -> list[list[Screened]]:
    """Return, for each cell, what each form that it does not hold yet promises: nothing where no gap matters.

    A cell is looked at even where no gap is seen: some gaps show only to the form that closes them, and what the
    constants absorb is to be told in any case.
    """
    least = 0.5 * (settings.smallest_gap - 1.0)
    worth = {
        state.cell.channel
        for state in found.cells
        if state.ratio(state.current.raw) > 1.0 + least or state.cell.gives_away()
    }
    listed: list[list[Screened]] = []
    for state in found.cells:
        listed.append([each for each in state.promises if each.form.name not in settings.left_out])
        if any(each.raw_gain > least for each in listed[-1]):
            worth.add(state.cell.channel)
    idle = [state.cell.channel not in worth for state in found.cells]
    return [
        [replace(each, gain=0.0, raw_gain=0.0) for each in promised] if still else promised
        for promised, still in zip(listed, idle, strict=True)
    ]


def rank(
    found: Search, candidates: Sequence[Sequence[Screened]], settings: SearchSettings, generator: np.random.Generator
) -> tuple[Round, list[Choice]]:
    """Return the names' probabilities and, for each cell, the fits with every form that was looked at closely."""
    close = _shortlist(found, candidates, settings)
    choices = [
        _extend(state, [each for each in listed if (state.cell.channel, each.form.name, each.form.form) in close])
        for state, listed in zip(found.cells, candidates, strict=True)
    ]
    temper = settings.temper
    noises = [_least_noise(state, fitted) for state, fitted in zip(found.cells, choices, strict=True)]
    none = [state.current.density(noise) / temper for state, noise in zip(found.cells, noises, strict=True)]
    scores: dict[tuple[str, str], dict[int, Array]] = {}
    for place, listed in enumerate(candidates):
        for each in listed:
            by_cell = scores.setdefault((each.form.name, each.form.form), {})
            fitted = choices[place].get((each.form.name, each.form.form))
            by_cell[place] = fitted.density(noises[place]) / temper if fitted else none[place] - NOT_WORTH
    names = sorted({name for name, _ in scores})
    sizes = _count_parameters(candidates)
    halved = {name: 0.5 ** sizes[name] for name in names}
    every = sum(halved.values()) / (1.0 - settings.none_prior)
    priors = {NONE: settings.none_prior, **{name: each / every for name, each in halved.items()}}

    def worth(name: str, forms: list[str], carries: Array) -> bool:
        return bool(_carriers(found, choices, name, forms, carries, settings))

    verdicts = _choose_forms(weigh_names(scores, none, priors, generator, worth), choices)
    verdicts = _believe_exact(found, choices, verdicts)
    raws = {name: _raw_with(found, choices, verdicts, name) for name in names}
    raws[NONE] = [state.current.raw for state in found.cells]
    gaps = {name: _pool(found, each) for name, each in raws.items()}
    heldout = {name: pool_over_range(found, each) for name, each in raws.items()}
    sites = {
        each.form.name: each.form.site
        for place, listed in enumerate(candidates)
        for each in listed
        if verdicts.forms[each.form.name][place] == each.form.form
    }
    named = _decide(found, choices, verdicts, gaps, sizes, settings)
    spoken = (named.name, *named.alternatives) if named else ()
    absorbed = {name: each for name, each in _absorb(candidates, verdicts).items() if name not in spoken}
    return Round(verdicts, absorbed, gaps, heldout, sites, named), choices


def _choose_forms(verdicts: Verdicts, choices: Sequence[Choice]) -> Verdicts:
    """Return the verdicts with the form of each name that predicts best in each cell, of those that were fitted.

    How probable a name is, its scores say; of its forms, the one is added that leaves least.
    """
    forms = {}
    for name, chosen in verdicts.forms.items():
        forms[name] = list(chosen)
        for place, fitted in enumerate(choices):
            own = {form: float(each.raw.sum()) for (known, form), each in fitted.items() if known == name}
            if own:
                forms[name][place] = min(own, key=own.__getitem__)
    return replace(verdicts, forms=forms)


def _believe_exact(found: Search, choices: Sequence[Choice], verdicts: Verdicts) -> Verdicts:
    """Return the verdicts with what exact values show taken as nearly sure, however little of the residual it takes."""
    for name, forms in verdicts.forms.items():
        carries = verdicts.carries[name].copy()
        for place, state in enumerate(found.cells):
            fitted = choices[place].get((name, forms[place]))
            if fitted is not None and _is_shown(state, fitted):
                carries[place] = 1.0
        if verdicts.names[name] < SURE and (carries > verdicts.carries[name]).any():
            rest = (1.0 - SURE) / (1.0 - verdicts.names[name])
            names = {other: SURE if other == name else rest * each for other, each in verdicts.names.items()}
            return replace(verdicts, names=names, carries={**verdicts.carries, name: carries})
    return verdicts


def _is_shown(state: CellState, fitted: Fitted) -> bool:
    """Return whether the measured values themselves show a form's level, and the simulation would pass it."""
    cell = state.cell
    if not cell.is_exact(fitted.forms[-1]) or not cell.gives_away():
        return False
    return float((fitted.fit.residual**2).sum()) < SHOWN * float((state.current.fit.residual**2).sum())


def _is_given(state: CellState, name: str) -> bool:
    """Return whether exact values of a cell show what a named effect does."""
    own = [form for form in state.current.forms if form.name == name]
    return state.cell.gives_away() and any(state.cell.is_exact(form) for form in own)


def _least_noise(state: CellState, choices: Choice) -> Noise:
    """Return the noise under which all candidates of a cell are judged: what the one that predicts best leaves.

    Under a noise of its own, a model that leaves a smooth gap would be preferred to one that leaves a small rough one.
    """
    best = min([state.current, *choices.values()], key=lambda each: float(each.raw.sum()))
    return best.estimate_noise()


def _count_parameters(candidates: Sequence[Sequence[Screened]]) -> dict[str, int]:
    """Return how many parameters the simplest form of each name has."""
    sizes: dict[str, int] = {}
    for each in [each for listed in candidates for each in listed]:
        size = len(each.form.parameters)
        sizes[each.form.name] = min(size, sizes.get(each.form.name, size))
    return sizes


def _shortlist(
    found: Search, candidates: Sequence[Sequence[Screened]], settings: SearchSettings
) -> set[tuple[str, str, str]]:
    """Return channel, name and form of those that promise most, over all of a channel's cells."""
    promised: dict[tuple[str, str, str], Array] = {}
    for state, listed in zip(found.cells, candidates, strict=True):
        for each in listed:
            key = (state.cell.channel, each.form.name, each.form.form)
            gains = np.maximum([each.gain, each.raw_gain], 0.0)
            promised[key] = promised.get(key, np.zeros(2)) + gains
    kept: set[tuple[str, str, str]] = set()
    for channel in {key[0] for key in promised}:
        for scale, most in ((0, settings.shortlist), (1, (settings.shortlist + 1) // 2)):
            kept |= _take_best({key: float(each[scale]) for key, each in promised.items() if key[0] == channel}, most)
    for state, listed in zip(found.cells, candidates, strict=True):
        if state.cell.gives_away():
            exact = [each.form for each in listed if state.cell.is_exact(each.form)]
            kept |= {(state.cell.channel, form.name, form.form) for form in exact}
    return kept


def _take_best(promised: Mapping[tuple[str, str, str], float], most: int) -> set[tuple[str, str, str]]:
    """Return the best two forms of the names that promise most."""
    names: dict[str, int] = {}
    kept = set()
    for key in sorted((key for key in promised if promised[key] > 0.0), key=lambda key: (-promised[key], key)):
        if key[1] in names or len(names) < most:
            names[key[1]] = names.get(key[1], 0) + 1
            if names[key[1]] <= 2:
                kept.add(key)
    return kept


def _extend(state: CellState, chosen: Sequence[Screened]) -> Choice:
    """Fit a cell with one more effect, each in turn, from where it stands; those that are near the best, twice."""
    spread = float(np.sqrt(state.current.raw.sum() / max(state.samples.sum(), 1.0)))
    plain: Choice = {}
    for each in chosen:
        model = replace(state.current.fit.model, forms=(*state.current.forms, each.form))
        start = np.concatenate([each.known, [each.start[own.name] for own in each.form.parameters]])
        plain[each.form.name, each.form.form] = fit_plain(model, start, spread)
    near = NEAR * min((float(fitted.raw.sum()) for fitted in plain.values()), default=0.0)
    return {key: colour(fitted) if fitted.raw.sum() < near else fitted for key, fitted in plain.items()}


def _absorb(candidates: Sequence[Sequence[Screened]], verdicts: Verdicts) -> dict[str, float]:
    """Return for each name the least share that constants absorb, over cells and forms that would carry it."""
    shares: dict[str, list[float]] = {}
    for place, listed in enumerate(candidates):
        for each in listed:
            if verdicts.forms[each.form.name][place] == each.form.form:
                shares.setdefault(each.form.name, []).append(each.absorbed)
    return {name: min(found) for name, found in shares.items()}


def _raw_with(found: Search, choices: Sequence[Choice], verdicts: Verdicts, name: str) -> list[Array]:
    """Return the raw sums of squares of all cells if those that would carry a name do."""
    raws = []
    for place, state in enumerate(found.cells):
        fitted = choices[place].get((name, verdicts.forms[name][place]))
        carried = fitted is not None and verdicts.carries[name][place] > 0.5
        raws.append(fitted.raw if fitted is not None and carried else state.current.raw)
    return raws


def _pool(found: Search, raws: Sequence[Array]) -> float:
    """Return the gap over the floor, root mean square over cells."""
    return float(np.sqrt(np.mean([state.ratio(raw) ** 2 for state, raw in zip(found.cells, raws, strict=True)])))


def pool_over_range(found: Search, raws: Sequence[Array]) -> float:
    """Return the gap over the channels' ranges, root mean square over cells."""
    each = [raw.sum() / state.samples.sum() / state.cell.range**2 for state, raw in zip(found.cells, raws, strict=True)]
    return float(np.sqrt(np.mean(each)))


def _decide(
    found: Search,
    choices: Sequence[Choice],
    verdicts: Verdicts,
    gaps: Mapping[str, float],
    sizes: Mapping[str, int],
    settings: SearchSettings,
) -> Named | None:
    """Return the name to add, if one is probable and closes a gap that matters; of equals, the simpler."""
    carried = {
        name: _carriers(found, choices, name, forms, verdicts.carries[name], settings)
        for name, forms in verdicts.forms.items()
    }
    possible = [name for name in carried if carried[name]]
    best = max(possible, key=lambda name: verdicts.names[name], default=NONE)
    if verdicts.names[best] <= verdicts.names[NONE]:
        return None
    closed = {name: gaps[NONE] - gaps[name] for name in possible}
    equals = [name for name in possible if name == best or closed[name] > AS_MUCH * closed[best]]
    best = min(equals, key=lambda name: (sizes[name], -verdicts.names[name]))
    equals = [name for name in equals if sizes[name] > sizes[best] or name == best]
    alternatives = tuple(
        name for name in sorted(possible, key=gaps.__getitem__) if name != best and closed[name] > LIKE * closed[best]
    )
    carriers = carried[best]
    forms = tuple(verdicts.forms[best][place] for place in carriers)
    first = next(form for form in found.cells[carriers[0]].cell.forms if (form.name, form.form) == (best, forms[0]))
    return Named(
        best,
        forms,
        first.site,
        found.cells[carriers[0]].cell.channel,
        tuple(found.cells[place].cell.element for place in carriers),
        sum(verdicts.names[name] for name in equals),
        alternatives[:2],
        any(_is_shown(found.cells[place], choices[place][best, verdicts.forms[best][place]]) for place in carriers),
    )


def _carriers(
    found: Search,
    choices: Sequence[Choice],
    name: str,
    forms: Sequence[str],
    carries: Array,
    settings: SearchSettings,
) -> list[int]:
    """Return the cells that carry a name: probable, and with a gain that is worth it; none if all are too small."""
    gains = {}
    for place, state in enumerate(found.cells):
        fitted = choices[place].get((name, forms[place]))
        if fitted is None or carries[place] <= 0.5:
            continue
        before, after, initial = (
            state.ratio(raw, fitted.raw) for raw in (state.current.raw, fitted.raw, state.nominal.raw)
        )
        needed = settings.least_share * (initial - 1.0)
        if state.current.forms:
            needed = min(settings.later_share * (initial - 1.0), max(settings.later_gain, settings.later_rest * before))
        if before - after > max(settings.least_gain, needed):
            gains[place] = before
        elif _is_shown(state, fitted):
            gains[place] = max(before, np.nextafter(settings.smallest_gap, np.inf))
    channel = {found.cells[place].cell.channel for place in gains}
    if len(channel) > 1:  # one name at one place of the chain: where it gains most
        best = max(gains, key=lambda place: gains[place])
        gains = {p: g for p, g in gains.items() if found.cells[p].cell.channel == found.cells[best].cell.channel}
    return list(gains) if gains and max(gains.values()) > settings.smallest_gap else []


def _add(found: Search, named: Named, choices: Sequence[Choice], generator: np.random.Generator) -> None:
    form_of = dict(zip(named.elements, named.forms, strict=True))
    for place, state in enumerate(found.cells):
        if state.cell.channel == named.channel and state.cell.element in form_of:
            chosen = choices[place][named.name, form_of[state.cell.element]]
            found.cells[place] = _update(state, _start_anew(chosen, generator.spawn(1)[0]))
            _correct_others(found, place)


def _start_anew(chosen: Fitted, generator: np.random.Generator) -> Fit:
    """Return the best of fits that begin at other values of the newest effect, the chosen one among them."""
    model, noise = chosen.fit.model, chosen.estimate_noise()
    newest = model.forms[-1]
    known, fixed = len(chosen.fit.values) - len(newest.parameters), len(model.cell.constants)
    found = [chosen.fit]
    bases = [chosen.fit.values[:known]]
    if not newest.scales:  # what sets in somewhere may leave constants far astray
        bases.append(np.concatenate([model.prior[0][:fixed], chosen.fit.values[fixed:known]]))
    for base, start in product(bases, list_starts(newest, 1 if model.cell.is_exact(newest) else FRESH_STARTS)):
        values = np.concatenate([base, [start[each.name] for each in newest.parameters]])
        found.append(fit(model, noise, values, iterations=LONG))
    if not newest.scales:
        noise = make_plain(chosen.spread)
        best = min(found, key=lambda each: each.cost(noise)).values
        for drawn in generator.standard_normal((NEARBY_STARTS, len(best))):
            found.append(fit(model, noise, best + NEARBY * model.prior[1] * drawn, iterations=LONG))
    return min(found, key=lambda each: each.cost(noise))


def _correct_others(found: Search, place: int) -> None:
    """Let what is known of a sensor count where its signal is an input: prepare cells anew that it feeds."""
    source = found.cells[place].current.fit
    for other, state in enumerate(found.cells):
        if other != place and state.cell.element == source.model.cell.element and not state.current.forms:
            effects = source.model.name_values(source.values)[1]
            corrected = state.cell.correct([(form.name, form.form, values) for form, values in effects])
            if corrected is not state.cell:
                found.cells[other] = prepare(corrected)


def _update(state: CellState, found: Fit) -> CellState:
    """Go on from a fit: refine it, and estimate the noise anew from what a flexible model leaves of it."""
    spread = float(np.sqrt((found.residual**2).sum() / max(state.cell.present.sum(), 1)))
    return _go_on(state, refine(found.model, found.values, spread))


def _go_on(state: CellState, current: Fitted) -> CellState:
    """Return a cell that stands at a fit; without an effect, that is the nominal one."""
    noise = current.estimate_noise()
    by_features = explain_by_features(current.fit, state.features, noise)
    by_trees, by_memory = (explain(state.cell, current.residual) for explain in (explain_by_trees, explain_by_memory))
    leftover = keep_least([by_trees, by_features], state.cell, by_memory=by_memory)
    nominal = state.nominal if current.forms else current
    return replace(state, noise=noise, nominal=nominal, current=current, leftover=leftover)


def _take_out_redundant(found: Search, settings: SearchSettings) -> None:
    """Take out an earlier effect that a later one has made superfluous."""
    for named in found.named[:-1]:
        keep: list[tuple[int, Fitted]] = []
        worth = False
        for place, state in enumerate(found.cells):
            if state.cell.channel != named.channel or state.cell.element not in named.elements:
                continue
            without = _without(state, named.name)
            keep.append((place, without))
            worth |= _is_given(state, named.name)
            worth |= state.ratio(without.raw) - state.ratio(state.current.raw) > settings.least_gain
        if not worth:
            for place, without in keep:
                found.cells[place] = replace(found.cells[place], current=without)
            del found.steps[1 + found.named.index(named)]
            found.named.remove(named)
            return


def _without(state: CellState, name: str) -> Fitted:
    model = state.current.fit.model
    start = list(state.current.fit.values[: len(model.cell.constants)])
    place = len(start)
    for form in model.forms:
        if form.name != name:
            start += list(state.current.fit.values[place : place + len(form.parameters)])
        place += len(form.parameters)
    kept = replace(model, forms=tuple(form for form in model.forms if form.name != name))
    return assess(fit(kept, state.noise, np.array(start)), state.noise)
