"""A flexible residual model: what could still be explained, by whatever function of the measured signals.

A fitted model and its cell flow in; out flows what each trial's residual would be if many generic features, with
weights of their own but no names, were fitted to the others. It has a name for nothing, so it names nothing: it tells
the noise from what is reproducible.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stages.discrepancy.cell import Cell, Driver
from stages.discrepancy.fitting import Fit, Grams
from stages.discrepancy.noise import Noise, whiten
from stages.signals.trajectories import Array

LAGS_S = (0.02, 0.06, 0.2, 0.6, 2.0)
WIDTHS = (0.03, 0.1, 0.3, 1.0)
"""Half-widths of stop operators, in standard deviations of the signal."""
KINKS = (-1.0, 0.0, 1.0)
Mask = NDArray[np.bool_]
PENALTIES = (1e-1, 1.0, 1e1, 1e2, 1e3, 1e4)


@dataclass(frozen=True)
class Leftover:
    """What a flexible model finds in a residual, trial by trial, each left out in turn.

    Parameters
    ----------
    white, raw : (K,) ndarray
        Sums of squares left.
    residual : (T, K) ndarray
        What it leaves of each trial that it was not fitted to.
    """

    white: Array
    raw: Array
    residual: Array


def explain_residual(fit: Fit, noise: Noise | None, learnt: Mask | None = None) -> Leftover:
    """Return what is left of each trial's residual when the others' is fitted by generic features.

    Parameters
    ----------
    fit : Fit
        The model whose residual it is; its own values may change along with the features' weights.
    noise : Noise or None
        Of the channel; None takes the residual as white.
    learnt : (K,) ndarray of bool, optional
        Trials that it may be fitted to; all, unless told.
    """
    cell = fit.model.cell
    present = cell.present
    features = np.where(present[:, :, None], cell.respond(build_features(cell)), 0.0)
    slopes = fit.model.differentiate(fit.values, np.where(present, cell.measured - fit.residual, 0.0))
    slopes = np.where(present[:, :, None], slopes, 0.0)
    together = np.concatenate([slopes, features, fit.residual[:, :, None]], axis=2)
    if noise is None:
        spread = float(np.sqrt((fit.residual**2).sum() / max(present.sum(), 1))) or 1.0
        white = together / spread
    else:
        white = whiten(together, present, noise, cell.step_s)
    first = slopes.shape[2]
    known = np.ones(cell.trials, dtype=bool) if learnt is None else learnt
    return _leave_each_out(white, together, first, 1.0 / fit.model.prior[1] ** 2, known)


def _leave_each_out(white: Array, raw: Array, first: int, precision: Array, learnt: Mask) -> Leftover:
    scale = np.sqrt(np.maximum((white[:, :, :-1] ** 2).mean(axis=(0, 1)), 1e-300))
    scale[:first] = 1.0
    by_trial = np.ascontiguousarray(white.transpose(1, 0, 2))
    by_trial[:, :, :-1] /= scale
    grams = Grams(
        by_trial[:, :, :-1].transpose(0, 2, 1) @ by_trial[:, :, :-1],
        (by_trial[:, :, -1][:, None, :] @ by_trial[:, :, :-1])[:, 0, :],
        (by_trial[:, :, -1] ** 2).sum(axis=1),
        np.zeros(len(by_trial)),
    )
    total, cross = grams.slopes[learnt].sum(axis=0), grams.cross[learnt].sum(axis=0)
    best: tuple[float, Array, Array] | None = None
    for penalty in PENALTIES:
        ridge = np.concatenate([precision, np.full(total.shape[0] - first, penalty)])
        weights = np.stack(
            [
                np.linalg.solve(total - known * grams.slopes[k] + np.diag(ridge), cross - known * grams.cross[k])
                for k, known in enumerate(learnt.astype(float))
            ]
        )
        left = grams.left_out(weights)
        if best is None or left[learnt].sum() < best[0]:
            best = (float(left[learnt].sum()), left, weights)
    assert best is not None
    _, left, weights = best
    explained = np.matmul(raw[:, :, :-1].transpose(1, 0, 2), (weights / scale)[:, :, None])[:, :, 0]
    residual = raw[:, :, -1] - explained.T
    return Leftover(left, (residual**2).sum(axis=0), residual)


def build_features(cell: Cell) -> Array:
    """Return generic features of a cell's drivers, (T, K, F): powers, products, lags, stops, directions, time."""
    drivers = cell.drivers()
    own = [(each, _standardise(each.values)) for each in drivers if each.own]
    columns: list[Array] = []
    for degree in (1, 2, 3):
        for chosen in combinations_with_replacement([signal for _, signal in own], degree):
            columns.append(np.prod(chosen, axis=0))
    scales = [np.ones_like(own[0][1]), *(signal for driver, signal in own if not driver.rate)]
    for driver, signal in own:
        remembered = _remember(driver, signal, cell.step_s)
        columns += [each * scale for each in remembered for scale in scales]
    for each in [driver for driver in drivers if not driver.own]:
        signal = _standardise(each.values)
        columns += [signal, signal**2, _lag(signal, LAGS_S[1], cell.step_s), _lag(signal, LAGS_S[3], cell.step_s)]
    columns += _session(cell, own[0][1])
    return np.stack([_standardise(column) for column in columns], axis=2)


def _remember(driver: Driver, signal: Array, step_s: float) -> list[Array]:
    """Return what one signal was: recent means, and stops that follow its changes up to a width; or its direction."""
    if driver.rate:
        directions = [np.tanh(signal / width) for width in (0.1, 0.5)]
        return [*directions, signal * np.abs(signal), _lag(signal, LAGS_S[0], step_s), _lag(signal, LAGS_S[1], step_s)]
    lags = [_lag(signal, tau, step_s) for tau in LAGS_S]
    kinks = [np.maximum(signal - kink, 0.0) for kink in KINKS]
    return [*lags, *(_stop(signal, width) for width in WIDTHS), *kinks]


def _session(cell: Cell, first: Array) -> list[Array]:
    samples = cell.measured.shape[0]
    within = np.repeat((np.arange(samples) * cell.step_s)[:, None], cell.trials, axis=1)
    session = _standardise(within + cell.start_s)
    order = _standardise(np.repeat(np.arange(cell.trials)[None, :], samples, axis=0).astype(float))
    time = _standardise(within)
    return [time, time**2, session, session**2, session * first, order, np.exp(-within / 0.5)]


def _standardise(signal: Array) -> Array:
    spread = float(signal.std())
    return (signal - signal.mean()) / spread if spread > 0.0 else np.zeros_like(signal)


def _lag(signal: Array, tau_s: float, step_s: float) -> Array:
    from scipy.signal import lfilter

    decay = float(np.exp(-step_s / tau_s))
    lagged: Array = lfilter([1.0 - decay], [1.0, -decay], signal, axis=0, zi=decay * signal[:1])[0]
    return lagged


@njit(cache=True, error_model="numpy")
def _stop(signal: Array, width: float) -> Array:
    stop = np.zeros_like(signal)
    for t in range(1, signal.shape[0]):
        for k in range(signal.shape[1]):
            stop[t, k] = min(max(stop[t - 1, k] + signal[t, k] - signal[t - 1, k], -width), width)
    return stop
