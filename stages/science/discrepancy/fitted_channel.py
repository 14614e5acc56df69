"""One output along the search: its fits, each judged on trials left out, and what a flexible model would leave.

Outputs with their trials flow in; outputs with a nominal and a present fit, their noise and their leftover flow out.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stages.science.discrepancy.screening import Screened
from stages.science.output_channels.families import Blocks, build_memory, build_static_map, choose_family
from stages.science.output_channels.features import build_features
from stages.science.output_channels.fitting import Fit, Model, fit
from stages.science.output_channels.flexible import Leftover, explain, explain_changing, keep_least
from stages.science.output_channels.grams import Columns
from stages.science.output_channels.noise import Noise, estimate_noise, make_plain
from stages.science.output_channels.output_channel import Counts, Divide, OutputChannel, compute_here
from stages.science.output_channels.trial_noise import TrialNoise
from stages.science.plant.effect import NamedEffect
from stages.science.signals.trajectories import Array

FAR, LARGE = 4.0, 0.1
"""Sum of squares of a left-out trial over its own when fitted, and over that of all trials, above both of which the
model is fitted again without the trial."""

AGAIN = 4
"""Iterations of a fit under another noise or beside a family, from the fit before."""


@dataclass(frozen=True)
class Fitted:
    """A fit of one output, with the residual, (T, K), of its trials, each left out, and its sums of squares, (K,)."""

    fit: Fit
    residual: Array
    raw: Array

    @property
    def forms(self) -> tuple[NamedEffect, ...]:
        """Effects in the model."""
        return self.fit.model.forms

    @property
    def effects(self) -> list[tuple[NamedEffect, dict[str, float]]]:
        """Effects with their fitted parameters."""
        return self.fit.model.name_values(self.fit.values)[1]

    @property
    def blocks(self) -> Blocks:
        """The family beside which it was fitted, with its priors; that of a fit beside none has no columns."""
        family = self.fit.model.family
        return (Columns(np.empty((*self.residual.shape, 0))), []) if family is None else (family.columns, [[family.sd]])

    def put_in(self, output: OutputChannel) -> "Fitted":
        """Return the same values and residual as those of another version of the output."""
        return replace(self, fit=replace(self.fit, model=replace(self.fit.model, output=output)))

    def estimate_noise(self) -> Noise:
        """Return the noise that the residual most likely is."""
        output = self.fit.model.output
        return estimate_noise(self.residual, output.present, output.step_s, output.limits)

    def refit(self, noise: Noise | TrialNoise, blocks: Blocks | None = None) -> "Fitted":
        """Return the model fitted under another noise, beside a family without a name if one is given, from here."""
        model, start = self.fit.model, self.fit.values
        if blocks is not None:
            family = choose_family(self.fit, noise, *blocks)
            model, start = replace(model, family=family), np.append(start, np.zeros(len(family.sd)))
        return assess(fit(model, noise, start, iterations=AGAIN), noise)

    def refit_coloured(self) -> "Fitted":
        """Fit the model once more, under the noise that it left; return what predicts better."""
        return min(self, self.refit(self.estimate_noise()), key=lambda each: float(each.raw.sum()))

    def put_newest_in(self, beside: "Fitted", noise: Noise | TrialNoise) -> "Fitted":
        """Return the model beside the family of a fit without its newest effect, from where that and the effect are."""
        newest, known = self.forms[-1], len(beside.fit.model.parameters)
        effect = self.fit.values[-len(newest.parameters) :]
        start = np.concatenate([beside.fit.values[:known], effect, beside.fit.values[known:]])
        model = replace(beside.fit.model, forms=self.forms)
        return assess(fit(model, noise, start, iterations=AGAIN), noise)

    def add_counts(self, counts: Counts, noise: Noise) -> "Fitted":
        """Return the same fit with a sensor's counts among its effects, which change nothing that is fitted."""
        model = replace(self.fit.model, forms=(*self.forms, counts.form))
        values = np.append(self.fit.values, list(counts.parameters.values()))
        return replace(self, fit=fit(model, noise, values, iterations=0))

    def drop_effects(self, names: Collection[str], noise: Noise | TrialNoise) -> "Fitted":
        """Return the fit of the model without some effects, beside its family; the same where it has none of them."""
        model = self.fit.model
        kept = tuple(form for form in model.forms if form.name not in names)
        if len(kept) == len(model.forms):
            return self
        constants, effects = model.name_values(self.fit.values)
        own = [constants, *(values for form, values in effects if form in kept)]
        named = [value for values in own for value in values.values()]
        start = np.append(named, self.fit.values[len(model.parameters) :])
        return assess(fit(replace(model, forms=kept), noise, start), noise)


@dataclass
class FittedChannel:
    """One output along the search."""

    output: OutputChannel
    noise: Noise
    nominal: Fitted
    current: Fitted
    leftover: Leftover
    promises: list[Screened] | None = field(default=None, init=False)
    """What `screen` told of the present fit, if it was asked."""

    @cached_property
    def static_map(self) -> Blocks:
        """A static map of the signals that act under the effects of the present fit."""
        return build_static_map(self.output.acting(self.current.effects))

    def map_beside(self, fitted: Fitted) -> Blocks:
        """Return a static map of the signals that act by a model, which adds effects to the present one."""
        output, added = fitted.fit.model.output, fitted.effects[len(self.current.forms) :]
        if output is self.output and output.acting(added) is output:
            return self.static_map
        return build_static_map(output.acting([*self.current.effects, *added]))

    @cached_property
    def memory(self) -> Blocks:
        """A memory of them."""
        return build_memory(self.output)

    def list_absent(self) -> list[NamedEffect]:
        """Return the forms whose effects, and others of the same cause, are not in the model yet."""
        held = {name for form in self.current.forms for name in (form.name, form.instead_of) if name}
        return [form for form in self.output.forms if held.isdisjoint((form.name, form.instead_of))]

    @property
    def samples(self) -> Array:
        """Samples of each trial, (K,)."""
        return self.output.present.sum(axis=0).astype(float)

    @property
    def floor(self) -> float:
        """Root mean square that nothing reproducible explains, in the channel's unit."""
        least = min(self.leftover.raw.sum(), self.current.raw.sum(), self.nominal.raw.sum())
        return max(float(np.sqrt(least / self.samples.sum())), self.output.resolution)

    def ratio(self, raw: Array, best: Array | None = None) -> float:
        """Return a gap over the floor, or over what the best fit known leaves, if that is less."""
        floor = self.floor if best is None else min(self.floor, float(np.sqrt(best.sum() / self.samples.sum())))
        floor = max(floor, self.output.resolution)
        return float(np.sqrt(raw.sum() / self.samples.sum())) / floor

    @property
    def is_calm(self) -> bool:
        """Whether nothing but noise is left by the nominal fit."""
        return self.ratio(self.nominal.raw) <= self.output.limits.calm_gap

    def continue_from(self, current: Fitted) -> "FittedChannel":
        """Return the channel with another present fit; one without effects is its nominal fit too."""
        noise = current.estimate_noise()
        changing = explain_changing(current.fit, build_features(self.output), noise)
        leftover = keep_least([*explain(self.output, current.residual), *changing], self.output)
        nominal = self.nominal if current.forms else current
        return replace(self, noise=noise, nominal=nominal, current=current, leftover=leftover)


def prepare(output: OutputChannel) -> FittedChannel:
    """Fit an output's nominal constants, and estimate its noise from what a flexible model leaves.

    A flexible model that sees noisy inputs may average out what noise the simulation has of them. Where one that cannot
    do so finds nothing, there is nothing to find.
    """
    model, calm = Model(output), output.calm()
    begun = {each.name: value for each, value in zip(output.constants, model.start, strict=True)}
    starts = [np.array(list((begun | other).values())) for other in ({}, *output.other_starts)]
    plain = [fit_plain(model, start, 0.01 * output.range) for start in starts]
    rough = min(plain, key=lambda each: float(each.raw.sum()))
    nominal = refine(model, rough.fit.values, rough.fit.spread)
    state = _estimate_floor(rough.put_in(calm), nominal.put_in(calm))
    return state if calm is output or state.is_calm else _estimate_floor(rough, nominal)


def _estimate_floor(rough: Fitted, nominal: Fitted) -> FittedChannel:
    output = nominal.fit.model.output
    plain, features = explain(output, rough.residual), build_features(output)
    least = keep_least([*plain, *explain_changing(rough.fit, features, None)], output)
    noise = estimate_noise(least.residual, output.present, output.step_s, output.limits)
    leftover = keep_least([*plain, *explain_changing(nominal.fit, features, noise)], output)
    return FittedChannel(output, noise, nominal, nominal, leftover)


def prepare_all(outputs: Sequence[OutputChannel], divide: Divide = compute_here) -> list[FittedChannel]:
    """Return outputs with their nominal fits, each by `prepare`."""
    return divide(prepare, outputs, [held for each in outputs for held in (each, *each.forms)])


def list_kept(states: Sequence[FittedChannel]) -> list[object]:
    """Return what results about outputs hold of these, which `divide` need not copy."""
    return [held for each in states for held in (each.output, *each.output.forms, each.current, each.nominal)]


def resume(output: OutputChannel, values: Array, noise: Noise, residual: Array, left: Leftover) -> FittedChannel:
    """Return an output as `prepare` left it: its constants, (P,), and the residual of trials left out, (T, K)."""
    for each in (output.calm(), output):
        found = fit(Model(each), noise, values, iterations=0)
        nominal = Fitted(found, residual, (residual**2).sum(axis=0))
        state = FittedChannel(each, noise, nominal, nominal, left)
        if state.is_calm:
            break
    return state


def refine(model: Model, start: Array, spread: float) -> Fitted:
    """Fit a model as if its residual were white, then under the noise that it leaves; return what predicts better."""
    return fit_plain(model, start, spread).refit_coloured()


def fit_plain(model: Model, start: Array, spread: float) -> Fitted:
    """Fit a model as if its residual were white, of a root mean square `spread`.

    The noise estimated from another model's residual does not serve: it takes a missing effect for slow noise, under
    which only steps would count.
    """
    plain = make_plain(spread)
    return assess(fit(model, plain, start), plain)


def assess(found: Fit, noise: Noise | TrialNoise) -> Fitted:
    """Evaluate a fit on each trial left out; where that changes much, by a new fit without the trial."""
    output = found.model.output
    residual = np.where(output.present, found.leave_each_out(), 0.0)
    squares, inside = (residual**2).sum(axis=0), (found.residual**2).sum(axis=0)
    far = np.flatnonzero((squares > FAR * inside) & (squares > LARGE * squares.sum()))
    for trial in far if output.trials > 2 else ():
        others = [k for k in range(output.trials) if k != trial]
        their = noise.take(others) if isinstance(noise, TrialNoise) else noise
        without, alone = fit(found.model.take(others), their, found.values), found.model.take([int(trial)])
        left = alone.output.measured - alone.simulate(without.values)
        residual[:, trial] = np.where(alone.output.present, left, 0.0)[:, 0]
    return Fitted(found, residual, (residual**2).sum(axis=0))


def correct_inputs(output: OutputChannel, fits: Sequence[Fitted]) -> OutputChannel:
    """Return a recorded output with its inputs corrected for effects of sensors in the fits of its element's others."""
    effects = [
        (form.name, form.form, values)
        for each in fits
        if each.fit.model.output.element == output.element and each.fit.model.output.channel != output.channel
        for form, values in each.effects
    ]
    return output.correct(effects)
