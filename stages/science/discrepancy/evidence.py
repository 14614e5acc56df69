"""Which name the held-out trials speak for: pseudo-BMA+ weights over names, forms and the muscles that carry them.

Trial-wise log scores flow in; probabilities flow out. The unit of evidence is the trial: a Bayesian bootstrap draws
weights of trials, and each draw weighs all hypotheses by their prior times their score.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stages.science.signals.trajectories import Array

DRAWS = 1000
NONE = "none"


@dataclass(frozen=True)
class Verdicts:
    """Probabilities that sum to one, and for each name and output how it would be carried.

    Parameters
    ----------
    names : mapping of str to float
        With ``none`` among them.
    forms : mapping of str to list of str
        Most probable form of each name in every output; empty where no form was looked at.
    carries : mapping of str to (C,) ndarray
        Probability that each output is among those that carry the name, given the name.
    """

    names: Mapping[str, float]
    forms: Mapping[str, list[str]]
    carries: Mapping[str, Array]


Worth = Callable[[str, list[str], Array], bool]
"""Whether a name would close a gap that matters, given its form in every output and the probability of each output."""


def weigh_names(
    scores: Mapping[tuple[str, str], Mapping[int, Array]],
    none: Sequence[Array],
    priors: Mapping[str, float],
    generator: np.random.Generator,
    worth: Worth,
) -> Verdicts:
    """Return the probability of each name.

    Parameters
    ----------
    scores : mapping of (name, form) to mapping of output's place to (K_c,) ndarray
        Log scores of an output's trials if it carries this form; an output that is missing cannot carry it.
    none : sequence of (K_c,) ndarray
        Those of each output if it carries nothing more.
    priors : mapping of str to float
        Prior mass of each name. It is shared evenly by all sets of outputs, and in each output of a set by the forms.
    generator : numpy.random.Generator
        Draws the weights of trials.
    worth : callable
        A name that is not worth it has no probability, however sure its small gain is.

    Notes
    -----
    Yao, Vehtari, Simpson, Gelman, Using stacking to average Bayesian predictive distributions, Bayesian Analysis 13
    (2018): pseudo-BMA+. As outputs are fitted apart, the sum over all sets of outputs and forms is a product.
    """
    draws = [len(each) * generator.dirichlet(np.ones(len(each)), DRAWS) for each in none]
    gain = {
        key: {place: draws[place] @ (score - none[place]) for place, score in by_output.items()}
        for key, by_output in scores.items()
    }
    names = list(dict.fromkeys(name for name, _ in scores))
    log_weight, chosen, carries = {NONE: np.full(DRAWS, np.log(priors[NONE]))}, {}, {}
    for name in names:
        forms = {form: by_output for (each, form), by_output in gain.items() if each == name}
        pooled, chosen[name] = _pool_forms(forms, len(none))
        carries[name] = np.where(
            np.isfinite(pooled).all(axis=0), (1.0 / (1.0 + np.exp(-np.clip(pooled, -700, 700)))).mean(axis=0), 0.0
        )
        any_set = np.logaddexp(0.0, pooled).sum(axis=1)
        some = any_set + np.log(-np.expm1(np.minimum(-any_set, -1e-12)))
        weight = some - np.log(2.0 ** len(none) - 1.0) + np.log(priors[name])
        log_weight[name] = weight if worth(name, chosen[name], carries[name]) else np.full(DRAWS, -np.inf)
    stacked = np.column_stack(list(log_weight.values()))
    weights = np.exp(stacked - stacked.max(axis=1, keepdims=True))
    mean = (weights / weights.sum(axis=1, keepdims=True)).mean(axis=0)
    return Verdicts({name: float(each) for name, each in zip(log_weight, mean, strict=True)}, chosen, carries)


def _pool_forms(forms: Mapping[str, Mapping[int, Array]], outputs: int) -> tuple[Array, list[str]]:
    """Return the gain of a name in every output and draw, forms weighed alike, and the best form in each output."""
    pooled = np.full((DRAWS, outputs), -np.inf)
    best = [""] * outputs
    for place in range(outputs):
        there = {form: by_output[place] for form, by_output in forms.items() if place in by_output}
        if there:
            pooled[:, place] = np.logaddexp.reduce(list(there.values()), axis=0) - np.log(len(there))
            medians = {form: float(np.median(each)) for form, each in there.items()}
            best[place] = max(medians, key=medians.__getitem__)
    return pooled, best
