"""Small data sets that the tests of the GP share."""

import numpy as np

from stages.gp import Hyperprior


def make_data(generator, count, dimensions=3, noise=0.1):
    """Return (N, D) inputs and (N,) outputs of a smooth law with noise."""
    x = generator.uniform(-1.5, 1.5, (count, dimensions))
    y = np.sin(1.5 * x[:, 0]) + 0.4 * (x**2).sum(axis=1) - 0.5 * dimensions
    return x, y + noise * generator.standard_normal(count)


def make_prior(dimensions=3, mean="zero", log_noise=-2.0, variance=0.5):
    """Return a hyperprior around lengths and a signal of 1."""
    means = [0.0] * (dimensions + 1) + [log_noise] + [0.0] * (mean == "constant")
    return Hyperprior(np.array(means), np.full(len(means), variance))


def differences(function, at, step):
    """Return central differences of a function of a vector, one row for each entry."""
    rows = []
    for index in range(at.size):
        shift = np.zeros_like(at)
        shift[index] = step
        rows.append((np.asarray(function(at + shift)) - np.asarray(function(at - shift))) / (2 * step))
    return np.array(rows)
