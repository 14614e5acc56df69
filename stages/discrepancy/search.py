"""The search for what is missing: locate, name, add, and repeat until what is left is noise or has no name.

Cells with their trials flow in; out flow the rounds of the search, each with its ranking, and for every cell the
nominal fit, the fit with what was named, and what a flexible model would leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stages.discrepancy.cell import Cell, Form
from stages.discrepancy.evidence import NONE, Verdicts, weigh_names
from stages.discrepancy.fitting import Fit, Model, begin, fit
from stages.discrepancy.flexible import Leftover, explain_residual
from stages.discrepancy.noise import Noise, estimate_noise, log_density
from stages.discrepancy.screening import Screened, screen
from stages.signals.trajectories import Array


@dataclass(frozen=True)
class SearchSettings:
    """What the search was told; see the configuration for units and reasons."""

    smallest_gap: float
    least_gain: float
    least_share: float
    unexplained_share: float
    temper: float
    shortlist: int
    most_effects: int
    absorbed: float
    none_prior: float
    certain: float


@dataclass(frozen=True)
class Fitted:
    """A fit of one cell, judged on its trials, each left out.

    Parameters
    ----------
    fit : Fit
        Values and what leaving trials out changes.
    noise : Noise
        That the residuals of trials left out most likely are.
    density : (K,) ndarray
        Log density of those residuals under it.
    raw : (K,) ndarray
        Their sums of squares, in the channel's unit.
    """

    fit: Fit
    noise: Noise
    density: Array
    raw: Array

    @property
    def forms(self) -> tuple[Form, ...]:
        """Effects in the model."""
        return self.fit.model.forms


@dataclass
class CellState:
    """One cell along the search."""

    cell: Cell
    noise: Noise
    nominal: Fitted
    current: Fitted
    leftover: Leftover

    @property
    def samples(self) -> Array:
        """Samples of each trial, (K,)."""
        return self.cell.present.sum(axis=0).astype(float)

    @property
    def floor(self) -> float:
        """Root mean square that nothing reproducible explains, in the channel's unit."""
        least = min(self.leftover.raw.sum(), self.current.raw.sum(), self.nominal.raw.sum())
        return float(np.sqrt(least / self.samples.sum()))

    def ratio(self, raw: Array, best: Array | None = None) -> float:
        """Return a gap over the floor, or over what the best fit known leaves, if that is less."""
        floor = self.floor if best is None else min(self.floor, float(np.sqrt(best.sum() / self.samples.sum())))
        return float(np.sqrt(raw.sum() / self.samples.sum())) / floor


@dataclass(frozen=True)
class Named:
    """One effect that was added."""

    name: str
    form: str
    site: str
    channel: str
    elements: tuple[str, ...]
    probability: float
    alternatives: tuple[str, ...]


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
    plain = Noise(max(0.01 * cell.range, 1e-9), 1e-12, 0.03, 1e-12, 1.0)
    rough = fit(model, plain, begin(model))
    noise: Noise | None = None
    for _ in range(2):  # the better the noise is known, the better the flexible model tells it from the rest
        noise = estimate_noise(explain_residual(rough, noise).residual, cell.present, cell.step_s)
    assert noise is not None
    nominal = assess(fit(model, noise, rough.values), noise)
    return CellState(cell, noise, nominal, nominal, explain_residual(nominal.fit, noise))


def assess(found: Fit, noise: Noise) -> Fitted:
    """Judge a fit on its trials, each left out, under the noise that they then most likely have."""
    cell = found.model.cell
    residual = np.where(cell.present, found.leave_each_out(), 0.0)
    own = estimate_noise(residual, cell.present, cell.step_s, noise)
    density = log_density(residual, cell.present, own, cell.step_s)
    return Fitted(found, own, density, (residual**2).sum(axis=0))


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
        found.rounds.append(looked)
        if looked.named is None:
            break
        _add(found, looked.named, choices)
        found.named.append(looked.named)
        _take_out_redundant(found, settings)
        found.steps.append([state.current.fit for state in found.cells])
    return found


NOT_WORTH = 1.0
"""Fall of a trial's score, in a cell, of a form that did not seem worth a full fit there."""

Choice = dict[tuple[str, str], Fitted]
"""By name and form: the fit of one cell that carries it."""


def _list_candidates(found: Search, settings: SearchSettings) -> list[list[Screened]]:
    """Return, for each cell, what each form that it does not hold yet promises."""
    worth = {
        state.cell.channel
        for state in found.cells
        if state.ratio(state.current.raw) > 1.0 + 0.5 * (settings.smallest_gap - 1.0)
    }
    listed = []
    for state in found.cells:
        held = {form.name for form in state.current.forms}
        forms = [form for form in state.cell.forms if form.name not in held]
        listed.append(screen(state.current.fit, state.noise, forms) if state.cell.channel in worth else [])
    return listed


def rank(
    found: Search, candidates: Sequence[Sequence[Screened]], settings: SearchSettings, generator: np.random.Generator
) -> tuple[Round, list[Choice]]:
    """Return the names' probabilities and, for each cell, the fits with every form that was looked at closely."""
    close = _shortlist(found, candidates, settings)
    choices = [
        {
            (each.form.name, each.form.form): _extend(state, each)
            for each in listed
            if (state.cell.channel, each.form.name, each.form.form) in close
        }
        for state, listed in zip(found.cells, candidates, strict=True)
    ]
    temper = settings.temper
    none = [state.current.density / temper for state in found.cells]
    scores: dict[tuple[str, str], list[Array]] = {}
    for place, listed in enumerate(candidates):
        for each in listed:
            key = (each.form.name, each.form.form)
            fitted = choices[place].get(key)
            apart = scores.setdefault(key, [score - NOT_WORTH for score in none])
            apart[place] = fitted.density / temper if fitted else apart[place]
    names = sorted({name for name, _ in scores})
    share = (1.0 - settings.none_prior) / max(len(names), 1)
    verdicts = weigh_names(scores, none, {NONE: settings.none_prior, **dict.fromkeys(names, share)}, generator)
    absorbed = _absorb(candidates, verdicts)
    raws = {name: _raw_with(found, choices, verdicts, name) for name in names}
    raws[NONE] = [state.current.raw for state in found.cells]
    gaps = {name: _pool(found, each) for name, each in raws.items()}
    heldout = {name: pool_over_range(found, each) for name, each in raws.items()}
    sites = {each.form.name: each.form.site for listed in candidates for each in listed}
    named = _decide(found, choices, verdicts, absorbed, gaps, sites, settings)
    return Round(verdicts, absorbed, gaps, heldout, sites, named), choices


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


def _extend(state: CellState, chosen: Screened) -> Fitted:
    """Fit a cell with one more effect, from where it stands, then once more under the noise that is left."""
    model = replace(state.current.fit.model, forms=(*state.current.forms, chosen.form))
    added = [chosen.start[each.name] for each in chosen.form.parameters]
    first = assess(fit(model, state.noise, np.concatenate([state.current.fit.values, added])), state.noise)
    return assess(fit(model, first.noise, first.fit.values, iterations=4), first.noise)


def _absorb(candidates: Sequence[Sequence[Screened]], verdicts: Verdicts) -> dict[str, float]:
    """Return for each name the least share that constants absorb, over the cells that would carry it."""
    shares: dict[str, list[tuple[float, float]]] = {}
    for place, listed in enumerate(candidates):
        for each in listed:
            if verdicts.forms.get(each.form.name) == each.form.form:
                carried = float(verdicts.carries[each.form.name][place])
                shares.setdefault(each.form.name, []).append((carried, each.absorbed))
    return {name: min(share for _, share in found) for name, found in shares.items()}


def _raw_with(
    found: Search,
    choices: Sequence[Choice],
    verdicts: Verdicts,
    name: str,
) -> list[Array]:
    key = (name, verdicts.forms[name])
    raws = []
    for place, state in enumerate(found.cells):
        fitted = choices[place].get(key)
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
    absorbed: Mapping[str, float],
    gaps: Mapping[str, float],
    sites: Mapping[str, str],
    settings: SearchSettings,
) -> Named | None:
    """Return the name to add, if one is probable, not absorbed, and closes a gap that matters."""
    fitted = [
        name
        for name in verdicts.names
        if name != NONE and absorbed.get(name, 0.0) <= settings.absorbed and _is_fitted(name, choices, verdicts)
    ]
    carried = {name: _carriers(found, choices, verdicts, name, settings) for name in fitted}
    possible = [name for name in fitted if carried[name]]
    if not possible:
        return None
    best = max(possible, key=lambda name: verdicts.names[name])
    if verdicts.names[best] <= verdicts.names[NONE]:
        return None
    carriers = carried[best]
    alternatives = tuple(
        name
        for name in sorted(possible, key=lambda each: gaps[each])
        if name != best and (gaps[NONE] - gaps[name]) > 0.95 * (gaps[NONE] - gaps[best])
    )
    return Named(
        best,
        verdicts.forms[best],
        sites[best],
        found.cells[carriers[0]].cell.channel,
        tuple(found.cells[place].cell.element for place in carriers),
        verdicts.names[best],
        alternatives[:2],
    )


def _is_fitted(name: str, choices: Sequence[Choice], verdicts: Verdicts) -> bool:
    return any((name, verdicts.forms[name]) in each for each in choices)


def _carriers(
    found: Search, choices: Sequence[Choice], verdicts: Verdicts, name: str, settings: SearchSettings
) -> list[int]:
    """Return the cells that carry a name: probable, and with a gain that is worth it; none if all are too small."""
    key = (name, verdicts.forms[name])
    gains = {}
    for place, state in enumerate(found.cells):
        fitted = choices[place].get(key)
        if fitted is None or verdicts.carries[name][place] <= 0.5:
            continue
        before, after, initial = (
            state.ratio(raw, fitted.raw) for raw in (state.current.raw, fitted.raw, state.nominal.raw)
        )
        initial -= 1.0
        if before - after > max(settings.least_gain, settings.least_share * initial):
            gains[place] = before
    channel = {found.cells[place].cell.channel for place in gains}
    if len(channel) > 1:  # one name at one place of the chain: where it gains most
        best = max(gains, key=lambda place: gains[place])
        gains = {p: g for p, g in gains.items() if found.cells[p].cell.channel == found.cells[best].cell.channel}
    return list(gains) if gains and max(gains.values()) > settings.smallest_gap else []


def _add(found: Search, named: Named, choices: Sequence[Choice]) -> None:
    key = (named.name, named.form)
    for place, state in enumerate(found.cells):
        if state.cell.channel == named.channel and state.cell.element in named.elements:
            found.cells[place] = _update(state, choices[place][key].fit)


def _update(state: CellState, found: Fit) -> CellState:
    """Go on from a fit: estimate the noise anew from what a flexible model leaves of it, and fit once more."""
    cell = state.cell
    noise = estimate_noise(explain_residual(found, state.noise).residual, cell.present, cell.step_s)
    current = assess(fit(found.model, noise, found.values), noise)
    nominal = assess(fit(state.nominal.fit.model, noise, state.nominal.fit.values), noise)
    return CellState(cell, noise, nominal, current, explain_residual(current.fit, noise))


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
            worth |= state.ratio(without.raw) - state.ratio(state.current.raw) > settings.least_gain
        if not worth:
            for place, without in keep:
                found.cells[place] = replace(found.cells[place], current=without)
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


def unexplained_share(
    found: Search, settings: SearchSettings, generator: np.random.Generator, draws: int = 1000
) -> dict[str, tuple[float, float]]:
    """Return by channel the share of the initial gap that a flexible model would still remove, and its probability.

    Returns
    -------
    dict of str to (float, float)
        Median share over a Bayesian bootstrap of trials, and how often it is above the settings' limit while the gap
        left is one that matters.
    """
    shares = {}
    for channel in dict.fromkeys(state.cell.channel for state in found.cells):
        states = [state for state in found.cells if state.cell.channel == channel]
        weights = generator.dirichlet(np.ones(len(states[0].samples)), draws)
        initial = _drawn_gap(states, weights, lambda state: state.nominal.raw)
        now = _drawn_gap(states, weights, lambda state: state.current.raw)
        least = _drawn_gap(states, weights, lambda state: state.leftover.raw)
        share = np.where(initial > least, (now - least) / np.maximum(initial - least, 1e-9), 0.0)
        matters = (share > settings.unexplained_share) & (now > settings.smallest_gap * least)
        shares[channel] = (float(np.median(share)), float(matters.mean()))
    return shares


def _drawn_gap(states: Sequence[CellState], weights: Array, raw_of: object) -> Array:
    ratios = []
    for state in states:
        own = weights[:, : len(state.samples)]
        mean = (own @ raw_of(state)) / (own @ state.samples)  # type: ignore[operator]
        ratios.append(mean / state.floor**2)
    gap: Array = np.sqrt(np.mean(ratios, axis=0))
    return gap
