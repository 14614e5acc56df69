"""Where in the regimes of motion and time a gap lies.

An output flows in; out flow the samples of each regime, by name, and the residual's frequency bands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array

Mask = NDArray[np.bool_]


def find_regimes(output: OutputChannel, around_reversal: float) -> dict[str, Mask]:
    """Return for each regime the samples in it, (T, K) ndarrays of bool.

    Regimes come from the output's own drivers: the sign of each rate and the moments at which it turns, each signal's
    high and low half, time within the trial, and the trial's place in the session.

    Parameters
    ----------
    output : OutputChannel
        With its drivers.
    around_reversal : float
        Time on both sides of a reversal that belongs to it, in usual movements.
    """
    present = output.present
    regimes: dict[str, Mask] = {}
    for driver in [each for each in output.drivers() if each.own]:
        if driver.rate:
            usual = np.abs(driver.values[present & (driver.values != 0.0)])
            moving = 0.05 * float(np.quantile(usual, 0.95)) if usual.size else 0.0
            forth, back, reversal = _format_motion(driver.name)
            regimes[forth] = driver.values > moving
            regimes[back] = driver.values < -moving
            regimes[reversal] = _around_reversals(
                driver.values, moving, max(round(around_reversal / (output.step_s / output.time_scale_s)), 1)
            )
        else:
            name = _format_name(driver.name)
            middle = float(np.median(driver.values[present])) if present.any() else 0.0
            regimes[f"high {name}"] = driver.values > middle
            regimes[f"low {name}"] = driver.values <= middle
    samples, trials = output.measured.shape
    early = np.arange(samples)[:, None] < 0.5 * samples
    regimes["early in the trial"] = np.repeat(early, trials, axis=1)
    regimes["late in the trial"] = ~regimes["early in the trial"]
    first = np.arange(trials)[None, :] < 0.5 * trials
    regimes["early in the session"] = np.repeat(first, samples, axis=0)
    regimes["late in the session"] = ~regimes["early in the session"]
    return {name: mask & present for name, mask in regimes.items()}


def split_bands(residual: Array, edges: Sequence[float], step_s: float, time_scale_s: float = 1.0) -> dict[str, Array]:
    """Return a residual's parts by frequency band; they sum to it.

    Parameters
    ----------
    residual : (T, K) ndarray
        In any unit.
    edges : sequence of float
        Between bands, over the rate of usual movements.
    step_s, time_scale_s : float
        Time between samples, and of a usual movement, s.
    """
    spectrum = np.fft.rfft(residual, axis=0)
    frequency = np.fft.rfftfreq(len(residual), step_s)
    parts = {}
    for slow, quick in zip([0.0, *edges], [*edges, None], strict=True):
        low, high = slow / time_scale_s, None if quick is None else quick / time_scale_s
        inside = (frequency >= low) & (frequency < (np.inf if high is None else high))
        name = f"above {low:g} Hz" if high is None else f"{low:g} to {high:g} Hz"
        parts[name] = np.fft.irfft(spectrum * inside[:, None], n=len(residual), axis=0)
    return parts


def _format_name(name: str) -> str:
    """Return a level's name in words, without its unit."""
    words = {"pressure_command_kpa": "command", "pressure_kpa": "pressure"}
    return words.get(name, name.replace("_", " "))


def _format_motion(name: str) -> tuple[str, str, str]:
    """Return the words for a rate above zero, below zero, and turning."""
    if name == "contraction_velocity_per_s":
        return "shortening", "lengthening", "velocity reversal"
    what = _format_name(name.removesuffix("_rate")) if name.endswith("_rate") else _format_name(name)
    if name.endswith("_rate"):
        return f"{what} rising", f"{what} falling", f"{what} reversal"
    return f"{what} positive", f"{what} negative", f"{what} reversal"


def _around_reversals(rate: Array, moving: float, around: int) -> Mask:
    """Return the samples within `around` samples of a change of sign between two movements."""
    mask = np.zeros(rate.shape, dtype=bool)
    for k in range(rate.shape[1]):
        direction = np.where(np.abs(rate[:, k]) > moving, np.sign(rate[:, k]), 0.0)
        at = np.flatnonzero(direction)
        turned = np.flatnonzero(np.diff(direction[at]) != 0.0)
        for left, right in zip(at[turned], at[turned + 1], strict=True):
            mask[max(left - around, 0) : right + around, k] = True
    return mask
