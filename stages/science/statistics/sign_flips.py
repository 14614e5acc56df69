"""Exact paired test over trials: under no difference, each trial's difference is as likely with the other sign."""

import numpy as np

from stages.science.statistics.paired import Array

MOST_ENUMERATED = 12
RANDOM_FLIPS = 8191


def compare_signs(differences: Array, generator: np.random.Generator, two_sided: bool = False) -> Array:
    """Return the p-value of each column's mean difference.

    Parameters
    ----------
    differences : (K, R) ndarray
        A row per trial, a column per question; a missing value takes no part.
    generator : numpy.random.Generator
        Draws sign flips when there are more than 2**12 of them.
    two_sided : bool
        Whether a mean below zero counts as well as one above.

    Returns
    -------
    (R,) ndarray
        Never below ``least_p(K)``; one where nothing could be compared.

    Notes
    -----
    Fisher's randomisation test; with drawn flips, the observed signs count as one of them (Phipson and Smyth, Stat.
    Appl. Genet. Mol. Biol. 9, 2010).
    """
    values = np.where(np.isfinite(differences), differences, 0.0)
    trials = len(values)
    if trials <= MOST_ENUMERATED:
        signs = 1.0 - 2.0 * ((np.arange(2**trials)[:, None] >> np.arange(trials)) & 1)
    else:
        signs = np.vstack([np.ones(trials), generator.choice((-1.0, 1.0), size=(RANDOM_FLIPS, trials))])
    flipped = signs @ values
    observed = values.sum(axis=0)
    if two_sided:
        flipped, observed = np.abs(flipped), np.abs(observed)
    tiny = 1e-12 * np.abs(values).sum(axis=0)
    p: Array = (flipped >= observed - tiny).mean(axis=0)
    return np.where((values != 0.0).any(axis=0), p, 1.0)


def least_p(trials: int, two_sided: bool = False) -> float:
    """Return the smallest p-value that this many trials can give."""
    flips = 2**trials if trials <= MOST_ENUMERATED else RANDOM_FLIPS + 1
    return (1 + two_sided) / flips


def fewest_trials(significance: float) -> int:
    """Return from how many trials on a two-sided test of all sign flips can reach a significance."""
    return int(np.ceil(np.log2(2.0 / significance)))
