"""What a channel's residual depends on, for the table, the figure and the report; it names no effect.

A fitted model, the noise floor and trials drawn again flow in; a row and averages along the first input flow out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.dependence import Dependence, find_dependence, find_range
from stages.science.discrepancy.resampling import find_interval, resample
from stages.science.discrepancy.residuals import LEAST_SHARE, LOOP_BINS, average_in_bins, equal_edges
from stages.science.discrepancy.restoring import SearchTables
from stages.science.discrepancy.settings import DescriptionSettings, DiscrepancySettings
from stages.science.discrepancy.symbolic_regression import Sketch, sketch_residual
from stages.science.output_channels.features import list_inputs
from stages.science.output_channels.fitting import Fit, fit
from stages.science.output_channels.flexible import Drift, find_drift, find_floor
from stages.science.output_channels.output_channel import Divide, Driver, OutputChannel, compute_here
from stages.science.plant.learned_map import LearnedMap
from stages.science.recording.signal_names import name_signal
from stages.science.signals.trajectories import Array

MOST = 0.5
"""Share of a residual's squares, at the interval's lower end, from which a drift of one value is told."""


class Share(NamedTuple):
    """Of a residual's squares, the share that is taken away, with an interval over resampled trials."""

    value: float
    low: float
    high: float


def measure_share(before: Array, after: Array, weights: Array, level: float) -> Share:
    """Return the share that is taken away of the squares of each trial, (K,) ndarrays, trials resampled by (B, K)."""
    low, high = find_interval(1.0 - (weights @ after) / np.maximum(weights @ before, 1e-300), level)
    return Share(float(1.0 - after.sum() / max(before.sum(), 1e-300)), float(low), float(high))


@dataclass(frozen=True)
class Description:
    """One output's residual, described.

    Residual, (T, K), and noise floor are in the channel's unit; `share`, `sketched` and `drifted` are what the GP, the
    formula and the drift of one value take away of trials left out, and `range_part` is the part of the first which the
    GP's range is to hold.
    """

    output: OutputChannel
    residual: Array
    floor: float
    dependence: Dependence
    share: Share
    sketch: Sketch
    sketched: Share
    drift: Drift
    drifted: Share
    range_part: float
    patch: LearnedMap | None
    """Map of inputs that a simulator knows, where one is asked for and trials left out confirm it."""

    @property
    def is_confirmed(self) -> bool:
        """Whether trials left out confirm the inputs: the interval of the share does not reach zero."""
        return bool(self.dependence.inputs) and self.share.low > 0.0

    @property
    def gap(self) -> float:
        """Root mean square of the residual, in the channel's unit."""
        return float(np.sqrt((self.residual**2).sum() / max(int(self.output.present.sum()), 1)))

    @property
    def above_floor(self) -> float:
        """Share of the residual's squares above the noise floor."""
        return max(1.0 - self.floor**2 / max(self.gap**2, 1e-300), 0.0)


def describe_above_floor(
    dataset: Dataset,
    found: SearchTables,
    settings: DiscrepancySettings,
    how: DescriptionSettings,
    draw: Callable[..., np.random.Generator],
    divide: Divide = compute_here,
) -> list[Description]:
    """Return a description, by `describe`, of each output channel whose gap after all additions is above the floor.

    Where an effect was added, the floor is what flexible models leave with it, if that is less: they do better beside
    the right name than alone. A gap below the smallest that matters is passed over. The generators that are drawn are
    for trials and for pseudo-inputs.
    """
    smallest_gap, generator = settings.search.smallest_gap, draw("pseudo-inputs")
    unnamed = found.unexplained.set_index("channel")["probability"] >= settings.search.certain
    weights = resample(len(dataset.fitted), settings.bootstraps, draw("resample"))
    above = [each for each in dataset.fitted_outputs if found.read_channel(each)["gap_over_floor"] > smallest_gap]
    restored = [(each, found.restore(each, found.last_step)) for each in above]
    fits = [fit(model, found.read_noise(each), values, iterations=0) for each, (model, values) in restored]
    described = []
    for fitted, floor in zip(fits, divide(lambda each: _find_floor(each, found), fits), strict=True):
        output = fitted.model.output
        if fitted.spread > smallest_gap * floor:
            patched = settings.patch == "always" or (settings.patch != "none" and unnamed[output.channel])
            described.append(describe(fitted, floor, how, weights, settings.level, generator, patched))
    return described


def _find_floor(fitted: Fit, found: SearchTables) -> float:
    """Return the noise floor of an output, with the effects in the model, if that is less."""
    output, floor = fitted.model.output, float(found.read_channel(fitted.model.output)["noise_floor"])
    if not fitted.model.forms:
        return floor
    least = find_floor(fitted, found.read_noise(output), np.ones(output.trials, dtype=bool)).raw.sum()
    return min(floor, float(np.sqrt(least / max(int(output.present.sum()), 1))))


def describe(
    fitted: Fit,
    floor: float,
    settings: DescriptionSettings,
    weights: Array,
    level: float,
    generator: np.random.Generator,
    patched: bool = False,
) -> Description:
    """Return on what the residual of a model that is fitted to the trials that may be looked at depends.

    The noise floor is in the channel's unit; the weights, (B, K), are of resampled trials, for intervals of the
    `level`; the generator draws pseudo-inputs. A patch is asked for or not.
    """
    output, residual = fitted.model.output.told_by(fitted.model.name_values(fitted.values)[0]), fitted.residual
    before = (residual**2).sum(axis=0)

    def look(offered: Sequence[Driver]) -> tuple[Dependence, Share]:
        found = find_dependence(output, offered, residual, settings, generator)
        left = ((residual - found.heldout) ** 2).sum(axis=0)
        return found, measure_share(before, left, weights, level)

    inputs = list_inputs(output)
    known = [each for each in inputs if output.can_tell(each.name)]
    found, share = look(inputs)
    patch, patch_share = found, share
    if patched and not all(output.can_tell(each.name) for each in found.inputs):
        patch, patch_share = look(known)
    sketch = sketch_residual(fitted, found.inputs, settings)
    sketched = measure_share(sketch.before, sketch.after, weights, level)
    drift = find_drift(fitted)
    drifted = measure_share(min(before, drift.without, key=np.sum), drift.left, weights, level)
    kept = patch.learned if patched and patch_share.low > 0.0 else None
    told = (found, share, sketch, sketched, drift, drifted)
    return Description(output, residual, floor, *told, settings.range_part, kept)


def tabulate(described: Description) -> dict[str, Any]:
    """Return a description as a row; what trials left out do not confirm is left empty."""
    output, share, sketched = described.output, described.share, described.sketched
    inputs = described.dependence.inputs if described.is_confirmed else ()
    row = {
        "channel": output.channel,
        "muscle": output.element,
        "unit": output.unit,
        "gap": described.gap,
        "noise_floor": described.floor,
        "above_floor": described.above_floor,
        "inputs": ", ".join(each.name for each in inputs),
        **dict(zip(("share", "low", "high"), share, strict=True)),
        **dict.fromkeys(("range_low", "range_high", "range_part", "range_time"), nan),
        **dict.fromkeys(("hint_share", "hint_low", "hint_high", "drift_first", "drift_last", "drift_share"), nan),
        **dict.fromkeys(("hint", "drift", "drift_unit"), ""),
    }
    if inputs:
        rest = described.residual - described.dependence.heldout
        taken = (described.residual**2 - rest**2)[output.present]
        where = find_range(described.dependence.along[output.present], taken, described.range_part)
        row |= {f"range_{name}": value for name, value in where._asdict().items()}
    if inputs and described.sketch.terms and sketched.low > 0.0:
        row |= {"hint": described.sketch.formula}
        row |= dict(zip(("hint_share", "hint_low", "hint_high"), sketched, strict=True))
    if described.drifted.low > MOST:
        drift = described.drift
        row |= {"drift": drift.name, "drift_unit": drift.unit, "drift_first": drift.first, "drift_last": drift.last}
        row |= {"drift_share": described.drifted.value}
    return row


def average_dependence(described: Sequence[Description]) -> pd.DataFrame:
    """Return confirmed residuals, and what the GP says of them, averaged along the first input.

    Columns are ``channel muscle unit variable beside x mean error said deviation``: mean residual, its standard error
    over trials, mean and standard deviation of the GP; ``beside`` tells the half of the second input, or is empty.
    """
    columns = ["channel", "muscle", "unit", "variable", "beside", "x", "mean", "error", "said", "deviation"]
    frames = []
    for each in [each for each in described if each.is_confirmed]:
        output, found = each.output, each.dependence
        first, edges = found.inputs[0], equal_edges(found.along[output.present], LOOP_BINS)
        centres, variable = 0.5 * first.factor * (edges[1:] + edges[:-1]), first.label
        for half, mask in found.split(output.present).items():
            mean, error, count = average_in_bins(found.along, each.residual, mask, edges)
            said, deviation = (average_in_bins(found.along, v, mask, edges)[0] for v in (found.mean, found.deviation))
            kept = count >= max(LEAST_SHARE * output.present.sum(), 3.0)
            told = (output.channel, output.element, output.unit, variable, name_signal(half)[0])
            averages = (values[kept] for values in (centres, mean, error, said, deviation))
            frames.append(pd.DataFrame(dict(zip(columns, (*told, *averages), strict=True))))
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)
