"""How large a gap is, in which regimes of motion and time it lies, and how sure that is.

Fits, and what a flexible model leaves, flow in; rows flow out. The unit of every test is the trial.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.science.discrepancy.fitted_channel import FittedChannel
from stages.science.discrepancy.settings import RegimeSettings
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.recording.signal_names import name_signal
from stages.science.signals.trajectories import Array
from stages.science.statistics.sign_flips import compare_signs, least_p

Mask = NDArray[np.bool_]


def locate(
    states: Sequence[FittedChannel], settings: RegimeSettings, generator: np.random.Generator
) -> list[dict[str, Any]]:
    """Return a row for each channel, element and regime; the generator is for tests with many trials.

    Notes
    -----
    Compared are, trial by trial, the nominal model's squared residual and what a flexible model leaves of that trial
    when it is left out; p-values are corrected for all rows by Benjamini and Yekutieli (Ann. Stat. 29, 2001), which
    bears that rows depend on each other.
    """
    from statsmodels.stats.multitest import multipletests

    rows = [row for state in states for row in _locate_in(state, settings, generator)]
    if rows:
        adjusted = multipletests([row["p_value"] for row in rows], method="fdr_by")[1]
        for row, p in zip(rows, adjusted, strict=True):
            row["p_adjusted"] = float(p)
    return rows


def _locate_in(state: FittedChannel, settings: RegimeSettings, generator: np.random.Generator) -> list[dict[str, Any]]:
    output, nominal = state.output, state.nominal.fit.residual
    least = np.where(output.present, state.leftover.residual, 0.0)
    whole = float((nominal**2 * output.present).sum())
    regimes = {"everywhere": output.present, **_find_regimes(output, settings.around_reversal)}
    looks = [(name, mask, mask.sum(axis=0), nominal, least) for name, mask in regimes.items()]
    bands = [_split_bands(each, settings.band_edges, output.step_s, output.time_scale_s) for each in (nominal, least)]
    length = np.full(output.trials, len(nominal))
    looks += [(name, output.present, length, part, bands[1][name]) for name, part in bands[0].items()]
    columns, rows = [], []
    for name, mask, counts, gap, rest in looks:
        excess = np.where(mask, gap**2 - rest**2, 0.0)
        columns.append(np.where(counts > 0, excess.sum(axis=0) / np.maximum(counts, 1), np.nan))
        samples = int(mask.sum())
        rows.append(
            {
                "channel": output.channel,
                "muscle": output.element,
                "regime": name,
                "samples": samples,
                "share_of_time": samples / max(int(output.present.sum()), 1),
                "gap": float(np.sqrt((gap**2 * mask).sum() / max(samples, 1))),
                "noise_floor": float(np.sqrt((rest**2 * mask).sum() / max(samples, 1))),
                "largest": float(np.quantile(np.abs(gap[mask]), settings.largest_quantile)) if samples else 0.0,
                "share_of_gap": min(1.0, float((gap**2 * mask).sum() / whole)) if whole > 0.0 else 0.0,
            }
        )
    p = compare_signs(np.column_stack(columns), generator)
    floor = least_p(output.trials)
    return [{**row, "p_value": float(each), "p_least": floor} for row, each in zip(rows, p, strict=True)]


def _find_regimes(output: OutputChannel, around_reversal: float) -> dict[str, Mask]:
    """Return for each regime the samples in it, (T, K); a reversal reaches over some usual movements on both sides."""
    present = output.present
    around = max(round(around_reversal / (output.step_s / output.time_scale_s)), 1)
    regimes: dict[str, Mask] = {}
    for driver in [each for each in output.drivers() if each.own]:
        if driver.rate:
            usual = np.abs(driver.values[present & (driver.values != 0.0)])
            moving = 0.05 * float(np.quantile(usual, 0.95)) if usual.size else 0.0
            forth, back, reversal = _format_motion(driver.name)
            regimes[forth] = driver.values > moving
            regimes[back] = driver.values < -moving
            regimes[reversal] = _around_reversals(driver.values, moving, around)
        else:
            name, _ = name_signal(driver.name)
            middle = float(np.median(driver.values[present])) if present.any() else 0.0
            regimes[f"high {name}"] = driver.values > middle
            regimes[f"low {name}"] = driver.values <= middle
    shape = output.measured.shape
    for whole, place, length in zip(("trial", "session"), np.indices(shape), shape, strict=True):
        regimes[f"early in the {whole}"] = place < 0.5 * length
        regimes[f"late in the {whole}"] = place >= 0.5 * length
    return {name: mask & present for name, mask in regimes.items()}


def _split_bands(residual: Array, edges: Sequence[float], step_s: float, time_scale_s: float) -> dict[str, Array]:
    """Return a residual's parts by frequency band, (T, K) ndarrays that sum to it; edges are over the usual rate."""
    spectrum = np.fft.rfft(residual, axis=0)
    frequency = np.fft.rfftfreq(len(residual), step_s)
    parts = {}
    for slow, quick in zip([0.0, *edges], [*edges, np.inf], strict=True):
        low, high = slow / time_scale_s, quick / time_scale_s
        inside = (frequency >= low) & (frequency < high)
        name = f"above {low:.3g} Hz" if high == np.inf else f"{low:.3g} to {high:.3g} Hz"
        parts[name] = np.fft.irfft(spectrum * inside[:, None], n=len(residual), axis=0)
    return parts


def _format_motion(name: str) -> tuple[str, str, str]:
    """Return the words for a rate above zero, below zero, and turning."""
    if name == "contraction_velocity_per_s":
        return "shortening", "lengthening", "velocity reversal"
    what, _ = name_signal(name.removesuffix("_rate"))
    forth, back = ("rising", "falling") if name.endswith("_rate") else ("positive", "negative")
    return f"{what} {forth}", f"{what} {back}", f"{what} reversal"


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
