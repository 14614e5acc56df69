"""A point utility by its name: one of `UTILITIES`, or a function of the user's own by its dotted path.

A name flows in; what scores `PredictiveTerms` flows out. Of a function of one's own, all scores are checked.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from stages.science.gp.kernel import Array
from stages.science.gp.utilities import UTILITIES, PredictiveTerms

TRIED = PredictiveTerms(
    variance=np.array([0.01, 0.1, 1.0]),
    hyperparameter_variance=np.array([0.001, 0.1, 2.0]),
    noise_variance=0.01,
    mean_variance=np.array([0.0, 0.1, 2.0]),
    variance_slope=np.array([[0.0, 0.1, 2.0]]),
    noise_slope=np.array([0.1]),
)
"""Terms of three points that a function of one's own is tried with before anything is measured."""


@dataclass(frozen=True)
class OwnUtility:
    """A utility of the user's own: its dotted path, and the function, which takes `PredictiveTerms` of B points."""

    path: str
    function: Callable[[PredictiveTerms], object]

    def __call__(self, terms: PredictiveTerms) -> Array:
        """Return the scores, (B,); a `ValueError` tells in one line what the function raises or returns instead."""
        try:
            scores = np.asarray(self.function(terms), dtype=float)
        except Exception as error:
            told = " ".join(f"{type(error).__name__}: {error}".split())
            raise ValueError(f"{self.path}: expected scores, but it raises {told}") from error
        if scores.shape != terms.variance.shape:
            raise ValueError(
                f"{self.path}: expected a score for each of {len(terms.variance)} points, shape "
                f"{terms.variance.shape}, got shape {scores.shape}"
            )
        wrong = np.flatnonzero(~np.isfinite(scores))
        if wrong.size:
            at, v, q = scores[wrong[0]], terms.variance[wrong[0]], terms.hyperparameter_variance[wrong[0]]
            raise ValueError(
                f"{self.path}: expected finite scores, got {at} at variance {v:.3g}, hyperparameter_variance {q:.3g}, "
                f"noise_variance {terms.noise_variance:.3g}"
            )
        return scores


def find_utility(name: str, also: Sequence[str] = ()) -> Callable[[PredictiveTerms], Array]:
    """Return a point utility; a `ValueError` tells an unknown name all that there are, and those known besides."""
    if "." in name:
        return load_utility(name)
    if name not in UTILITIES:
        raise ValueError(f"utility: expected one of {', '.join([*UTILITIES, *also])}, got {name!r}")
    return UTILITIES[name]


def load_utility(path: str) -> OwnUtility:
    """Return a function of one's own by its dotted path, ``package.module.function``.

    A `ValueError` tells a module that cannot be imported, and one that has no such function.
    """
    module_name, _, name = path.rpartition(".")
    if not module_name or not all(part.isidentifier() for part in path.split(".")):
        raise ValueError(f"expected the dotted name of a function, as package.module.function, got {path!r}")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever a module of one's own raises
        told = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"cannot import {module_name} of {path} ({told})") from error
    if not hasattr(module, name):
        near = get_close_matches(name, [each for each, value in vars(module).items() if callable(value)], n=1)
        raise ValueError(f"{module_name} has no {name}" + (f"; did you mean {near[0]}?" if near else ""))
    function = getattr(module, name)
    if not callable(function):
        raise ValueError(
            f"{path}: expected a function of PredictiveTerms, got a value of type {type(function).__name__}"
        )
    return OwnUtility(path, function)


def name_utility(utility: str) -> str:
    """Return what a utility is called, by its name or its dotted path."""
    return utility.rpartition(".")[2]
