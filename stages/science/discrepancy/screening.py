"""Screening of all forms: how much of the residual each could take away, and its confounding with the constants.

A fitted model flows in. Each form is simulated once from each of its starts; the change that it makes, less what the
free constants could imitate, is regressed on the residual, trials left out in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.fitting import Fit, find_least
from stages.science.output_channels.fitting import fit as fit_values
from stages.science.output_channels.grams import Grams, collect_grams
from stages.science.output_channels.noise import Noise, make_plain, whiten
from stages.science.plant.effect import NamedEffect
from stages.science.signals.trajectories import Array

TRIED = 12
"""Iterations of the fit by which a form with a threshold is screened."""
SMALL = 1e-3
"""Size of an effect for which none was found, when it is compared with the constants."""


@dataclass(frozen=True)
class Screened:
    """Screening result of one form in one output channel, at the best of its starts, scaled to the residual.

    `gain` is the fall of the whitened sum of squares of trials left out; `raw_gain` the same in the channel's unit,
    fitted so, over what there is; `confounded_with_constants` the share of its change, squared, that the free constants
    imitate; `known` the values, (P,), of the model without it from which it begins.
    """

    form: NamedEffect
    start: dict[str, float]
    gain: float
    raw_gain: float
    confounded_with_constants: float
    known: Array


def split_forms(forms: Sequence[NamedEffect]) -> list[list[NamedEffect]]:
    """Return forms in parts, each of which `screen` judges alone as beside the others; what is fitted comes first."""
    fitted = [form for form in forms if form.tried or not form.scales]
    return [*([form] for form in fitted), [form for form in forms if form.scales and not form.tried]]


def screen(fit: Fit, noise: Noise, forms: Sequence[NamedEffect]) -> list[Screened]:
    """Return the screening result of each form, from the best of its starts."""
    output = fit.model.output
    present = output.present
    constants, placed = fit.model.name_values(fit.values)
    simulated = output.simulate(constants, placed)
    *fitted, scaled = split_forms(forms)
    best = _try_starts(fit, [form for (form,) in fitted])
    tried = []
    for form in scaled:
        for start in output.starts(form, constants):
            change = output.simulate(constants, [*placed, (form, start)]) - simulated
            if np.isfinite(change).all() and np.abs(change[present]).max(initial=0.0) > 0.0:
                tried.append((form, start, np.where(present, change, 0.0)))
    if not tried:
        return list(best.values())
    changes = np.stack([change for _, _, change in tried], axis=2)
    columns = np.concatenate([fit.slopes, changes, fit.residual[:, :, None]], axis=2)
    white = whiten(columns, present, noise, output.step_s)
    grams, raw = (collect_grams(each[:, :, :-1], each[:, :, -1], present) for each in (white, columns))
    unit = raw.square.sum() / max(raw.samples.sum(), 1.0)
    plain = Grams(raw.slopes / unit, raw.cross / unit, raw.square / unit, raw.samples)
    known = len(fit.values)
    for index, (form, start, _) in enumerate(tried):
        first = form.parameters[0]
        signed = first.low < 0.0
        gain, scale, confounded = _regress(fit, grams, known + index, signed)
        raw_gain = _regress(fit, plain, known + index, signed)[0]
        if output.shows(form):
            scale = 1.0
            gain, raw_gain = (  # of a change that is taken as it is
                float(2.0 * each.cross[:, known + index].sum() - each.slopes[:, known + index, known + index].sum())
                for each in (grams, plain)
            )
        raw_gain /= float(plain.square.sum())
        magnitude = float(np.clip(scale * start[first.name], first.low, first.high))
        started = {**start, first.name: magnitude if magnitude != 0.0 else start[first.name]}
        key = (form.name, form.form)
        if key not in best or gain > best[key].gain:
            best[key] = Screened(form, started, gain, raw_gain, confounded, fit.values)
    return list(best.values())


def _try_starts(found: Fit, forms: Sequence[NamedEffect]) -> dict[tuple[str, str], Screened]:
    """Return the screening results of forms by a few iterations of a fit from each of their starts."""
    output, model = found.model.output, found.model
    before = np.sum(np.where(output.present, found.leave_each_out(), 0.0) ** 2)
    noise = make_plain(found.spread)
    fixed = len(output.constants)
    # without an effect that has a threshold, constants may be far off: they start at their prior means too
    bases = (found.values, np.concatenate([model.prior[0][:fixed], found.values[fixed:]]))
    best: dict[tuple[str, str], Screened] = {}
    for form in forms:
        constants, known = model.name_values(found.values)[0], len(found.values)
        for base, start in product(bases[:1] if form.scales else bases, output.starts(form, constants)):
            extended = replace(model, forms=(*model.forms, form))
            begun = [start.get(each.name, value) for each, value in zip(output.constants, base[:fixed], strict=True)]
            values = np.concatenate([begun, base[fixed:], [start[each.name] for each in form.parameters]])
            tried = fit_values(extended, noise, values, iterations=TRIED)
            share = 1.0 - float(np.sum(np.where(output.present, tried.leave_each_out(), 0.0) ** 2) / before)
            key = (form.name, form.form)
            gain = found.cost(noise) - tried.cost(noise)
            if key not in best or gain > best[key].gain:
                reached = {each.name: float(v) for each, v in zip(form.parameters, tried.values[known:], strict=True)}
                free = np.flatnonzero(tried.free[:known])
                chosen = np.append(free, known)
                total = tried.white.slopes.sum(axis=0)[np.ix_(chosen, chosen)]
                confounded = _find_confounded(tried, free, total, float(tried.values[known]))
                best[key] = Screened(form, reached, gain, share, confounded, tried.values[:known])
    return best


def _find_confounded(found: Fit, free: NDArray[np.int_], total: Array, size: float) -> float:
    """Return the share of a column's square that some free values of a fit, (F,), imitate within their bounds.

    Summed products of slopes, (F + 1, F + 1), are those of the values and last of the column, which has a size.
    """
    size = size or SMALL  # an effect that was fitted to nothing is judged as a small one
    square = size**2 * float(total[-1, -1])
    if square <= 0.0:  # it changes nothing in these data
        return 0.0
    (low, high), sd = found.model.bounds, found.model.prior[1]
    room = (low - found.values)[free], (high - found.values)[free]
    shared, among = size * total[:-1, -1], total[:-1, :-1]
    change = find_least(among, shared, sd[free], *room)
    return 1.0 - max(square - float(change @ (2.0 * shared - among @ change)), 0.0) / square


def _regress(fit: Fit, grams: Grams, column: int, signed: bool) -> tuple[float, float, float]:
    """Return the gain of one change beside the free constants: in all, its scale, share confounded with them."""
    free = np.flatnonzero(fit.free)
    chosen = np.append(free, column)
    precision = np.append(fit.precision[free], 0.0)
    mean = fit.model.prior[0]
    pull = np.append((mean - fit.values)[free] * fit.precision[free], 0.0)
    slopes = grams.slopes[:, chosen[:, None], chosen]
    cross = grams.cross[:, chosen]
    total = slopes.sum(axis=0)
    size = total[-1, -1]
    if size <= 0.0:  # it changes nothing in these data
        return 0.0, 0.0, 0.0
    curvature = total + np.diag(precision) + np.diag(np.append(np.zeros(len(free)), 1e-9 * size))
    whole = np.linalg.solve(curvature, cross.sum(axis=0) + pull)
    scale = float(whole[-1]) if whole[-1] > 0.0 or signed else 1.0
    confounded = _find_confounded(fit, free, total, scale)
    if whole[-1] <= 0.0 and not signed:
        return 0.0, 0.0, confounded
    changes = np.stack(
        [np.linalg.solve(curvature - slopes[k], (cross.sum(axis=0) - cross[k]) + pull) for k in range(len(slopes))]
    )
    left = Grams(slopes, cross, grams.square, grams.samples).left_out(changes)
    return float(grams.square.sum() - left.sum()), float(whole[-1]), confounded
