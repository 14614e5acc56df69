"""Which name the held-out trials speak for: pseudo-BMA+ weights over names, forms and the muscles that carry them.

Trial-wise log scores flow in; probabilities flow out. The unit of evidence is the trial: a Bayesian bootstrap draws
weights of trials, and each draw weighs all hypotheses by their prior times their score.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stages.signals.trajectories import Array

DRAWS = 1000
NONE = "none"


@dataclass(frozen=True)
class Verdicts:
    """Probabilities that sum to one, and for each name that of every cell to carry it.

    Parameters
    ----------
    names : mapping of str to float
        With ``none`` among them.
    forms : mapping of str to str
        Most probable form of each name.
    carries : mapping of str to (C,) ndarray
        Probability that each cell is among those that carry the name, given the name.
    """

    names: Mapping[str, float]
    forms: Mapping[str, str]
    carries: Mapping[str, Array]


def weigh_names(
    scores: Mapping[tuple[str, str], Sequence[Array]],
    none: Sequence[Array],
    priors: Mapping[str, float],
    generator: np.random.Generator,
) -> Verdicts:
    """Return the probability of each name.

    Parameters
    ----------
    scores : mapping of (name, form) to sequence of (K_c,) ndarray
        Log scores of each cell's trials if the cell carries this form.
    none : sequence of (K_c,) ndarray
        The same if it carries nothing more.
    priors : mapping of str to float
        Prior mass of each name; a name's mass is shared evenly by its forms, a form's by the sets of cells.
    generator : numpy.random.Generator
        Draws the weights of trials.

    Notes
    -----
    Yao, Vehtari, Simpson, Gelman, Using stacking to average Bayesian predictive distributions, Bayesian Analysis 13
    (2018): pseudo-BMA+. As cells are fitted apart, the sum over all sets of cells is a product.
    """
    keys = list(scores)
    forms_of = {name: [key for key in keys if key[0] == name] for name in dict.fromkeys(name for name, _ in keys)}
    draws = [len(each) * generator.dirichlet(np.ones(len(each)), DRAWS) for each in none]
    base = np.stack([weights @ each for weights, each in zip(draws, none, strict=True)], axis=1)
    gain = {
        key: np.stack([w @ each for w, each in zip(draws, scores[key], strict=True)], axis=1) - base for key in keys
    }
    sets = 2.0 ** base.shape[1] - 1.0
    log_weight = {}
    for name, forms in forms_of.items():
        for key in forms:
            any_set = np.logaddexp(0.0, gain[key]).sum(axis=1)
            some = any_set + np.log(-np.expm1(np.minimum(-any_set, -1e-12)))
            log_weight[key] = some - np.log(sets) + np.log(priors[name] / len(forms))
    stacked = np.column_stack([np.full(len(base), np.log(priors[NONE])), *(log_weight[key] for key in keys)])
    weights = np.exp(stacked - stacked.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    mean = dict(zip([(NONE, ""), *keys], weights.mean(axis=0), strict=True))
    names = {NONE: float(mean[NONE, ""])}
    chosen, carries = {}, {}
    for name, forms in forms_of.items():
        names[name] = float(sum(mean[key] for key in forms))
        best = max(forms, key=lambda key: float(np.median(log_weight[key])))
        chosen[name] = best[1]
        carries[name] = (1.0 / (1.0 + np.exp(-np.clip(gain[best], -700, 700)))).mean(axis=0)
    return Verdicts(names, chosen, carries)
