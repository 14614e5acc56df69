"""The whole search on one dataset, up to the decision, and the search that knows the true names as its upper bound.

Outputs with all trials flow in, with the positions of the test trials; out flow the search, the decision, and the gap
on the test trials before, after, at the noise floor, and with the true names known; and how well one form reproduces an
effect that was simulated elsewhere, without noise.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.science.discrepancy.decision import Decision, decide
from stages.science.discrepancy.fitted_channel import Fitted, FittedChannel, correct_inputs, prepare_all
from stages.science.discrepancy.screening import screen
from stages.science.discrepancy.search import Search, search
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.discrepancy.verification import find_test_floor
from stages.science.output_channels.fitting import Fit, Model, fit
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import NamedEffect, OutputChannel
from stages.science.signals.trajectories import Array
from stages.science.statistics.intervals import bound_mean

FINE = 1e-3
"""Standard deviation over the range by which noise-free records are fitted; small, so that priors hardly matter."""
STEPS = 40


@dataclass(frozen=True)
class Judgement:
    """What was found in outputs with all trials, nothing being fitted to the test trials, and what is said of it."""

    outputs: list[OutputChannel]
    test: list[int]
    prepared: list[FittedChannel]
    found: Search
    decision: Decision
    settings: DiscrepancySettings

    @property
    def unexplained(self) -> str:
        """Channel in which most probably something without a name is left."""
        return max(self.decision.remainders, key=lambda channel: self.decision.remainders[channel].unknown)

    def gap(self, fits: Sequence[Fitted], channels: Collection[str]) -> float:
        """Return the gap on the test trials, RMSE over range, root mean square over outputs of some channels."""
        squares = []
        for recorded, each in zip(self.outputs, fits, strict=True):
            output = correct_inputs(recorded, fits)
            if output.channel in channels:
                means, counts = _square_residual(output, each, self.test)
                squares.append(means[counts > 0].mean() / output.range**2 if counts.any() else 0.0)
        return float(np.sqrt(np.mean(squares)))

    def compare_further(
        self, outputs: Sequence[OutputChannel], trials: Sequence[int], level: float
    ) -> tuple[float, float, float]:
        """Return the share of the squared gap on further trials that the decision removes, with its interval.

        They are those at positions `trials` of the same outputs of a longer session; the interval is Student's, of the
        mean difference, paired by trial.
        """
        before, after = (
            sum(
                _square_residual(output, each, trials)[0] / output.range**2
                for output, each in zip([correct_inputs(output, fits) for output in outputs], fits, strict=True)
            )
            for fits in (self.decision.steps[0], self.decision.steps[-1])
        )
        return bound_mean(np.asarray((before - after) / np.mean(before)), level)

    def floor(self, channels: Collection[str]) -> float:
        """Return the noise floor of the test trials, in the same unit."""
        means = []
        learnt = ~np.isin(np.arange(self.outputs[0].trials), self.test)
        for recorded, state, each in zip(self.outputs, self.prepared, self.decision.steps[-1], strict=True):
            output = correct_inputs(recorded, self.decision.steps[-1])
            if output.channel in channels:
                model = replace(each.fit.model, output=output)
                left = find_test_floor(model, each.fit.values, state.noise, learnt)[self.test]
                counts = output.present.sum(axis=0)[self.test]
                means.append((left / np.maximum(counts, 1))[counts > 0].mean() / output.range**2)
        return float(np.sqrt(np.mean(means)))


def judge(
    outputs: Sequence[OutputChannel],
    test: Sequence[int],
    settings: DiscrepancySettings,
    draw: Callable[..., np.random.Generator],
) -> Judgement:
    """Return what the search finds in outputs with all trials, those at positions `test` not fitted, and says of it.

    `draw` returns the generator of a purpose, or of a purpose and a part of the trials.
    """
    fitted = [trial for trial in range(outputs[0].trials) if trial not in set(test)]
    prepared = prepare_all([output.take(fitted) for output in outputs])
    found = search(prepared, settings.search, draw("trials"))
    return Judgement(list(outputs), list(test), prepared, found, decide(found, settings, draw("unexplained")), settings)


def search_with_truth(judged: Judgement, names: Collection[str], generator: np.random.Generator) -> Search:
    """Return the search that has the true names alone for a library and adds them however little they gain.

    `generator` draws weights of trials.
    """
    easy = {"smallest_gap": 1.0, "least_share": 0.0, "least_rest": 0.0, "none_prior": 1e-9, "most_effects": len(names)}
    states = [replace(state, output=_restrict(state.output, names)) for state in judged.prepared]
    return search(states, judged.settings.search.model_copy(update=easy), generator)


def _restrict(output: OutputChannel, names: Collection[str]) -> OutputChannel:
    """Return an output that offers only the effects of these names."""
    forms = tuple(form for form in output.forms if form.name in names)
    kind = type(output.__class__.__name__, (output.__class__,), {"forms": forms})
    narrow: OutputChannel = object.__new__(kind)
    vars(narrow).update(vars(output))
    return narrow


def _square_residual(output: OutputChannel, fitted: Fitted, trials: Sequence[int]) -> tuple[Array, Array]:
    """Return the mean square of the residual of each of some trials, zero without samples, and the samples of each."""
    simulated = replace(fitted.fit.model, output=output).simulate(fitted.fit.values)
    present = output.present[:, trials]
    counts = present.sum(axis=0)
    squares = np.where(present, output.measured[:, trials] - simulated[:, trials], 0.0) ** 2
    return squares.sum(axis=0) / np.maximum(counts, 1), counts


def explain_exactly(form: NamedEffect, with_it: OutputChannel, without: OutputChannel) -> tuple[float, float]:
    """Return an effect's size and what a form leaves of it, root mean squares over the range.

    What the nominal model itself leaves without the effect, as of filters and geometry, is taken off both residuals.
    """
    noise = Noise(FINE * with_it.range, 1e-12, 0.03, 1e-12, 1.0)
    nominal, plain = (fit(Model(output), noise, Model(output).start, STEPS) for output in (with_it, without))

    def differ(first: Fit) -> float:
        difference = (first.residual - plain.residual)[with_it.present]
        return float(np.sqrt((difference**2).mean()) / with_it.range)

    effect = differ(nominal)
    promised = screen(nominal, noise, [form])
    if not promised:
        return effect, effect
    added = [promised[0].start[each.name] for each in form.parameters]
    amended = fit(Model(with_it, (form,)), noise, np.concatenate([nominal.values, added]), STEPS)
    return effect, min(differ(amended), effect)
