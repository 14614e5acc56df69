"""The gap on the test trials: before, after each addition, and the noise floor.

Outputs with all trials and the values of each step flow in; predictions and gaps flow out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stages.science.discrepancy.bands import Band, find_band, measure_coverage
from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.resampling import find_interval, resample
from stages.science.discrepancy.restoring import SearchTables, list_samples
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.features import evaluate_map
from stages.science.output_channels.fitting import Fit, Model, fit
from stages.science.output_channels.flexible import Mask, find_floor
from stages.science.output_channels.muscle_channels import PRESSURES, ForceChannel, MuscleChannel
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import Divide, OutputChannel, compute_here
from stages.science.plant.learned_map import LearnedMap
from stages.science.signals.trajectories import Array
from stages.science.statistics.sign_flips import compare_signs, least_p

DRIVEN = "measured upstream"
Maps = Mapping[tuple[str, str], LearnedMap]
"""Learned maps by channel and element."""


@dataclass
class Verified:
    """One output on all trials, simulated after each number of additions, and with what was learnt, (T, K) each.

    `steps` are simulated from measured upstream signals; `free` from the command and the joint's motion alone, empty
    where nothing measured is upstream. `floor`, (K,), is the sum of squares, over the range squared, that a flexible
    model beside the last one leaves of each trial; a learned map, where it leaves less of fitted trials left out.
    """

    output: OutputChannel
    steps: list[Array]
    free: list[Array]
    floor: Array = field(init=False)
    band: Band = field(init=False)
    """About the last step."""

    def squares(self, simulated: Array) -> Array:
        """Return each trial's sum of squares over the range squared."""
        residual = np.where(self.output.present, self.output.measured - simulated, 0.0)
        return np.asarray((residual**2).sum(axis=0) / self.output.range**2)


def verify(
    outputs: Sequence[OutputChannel],
    fitted: Sequence[int],
    found: SearchTables,
    learned: Maps,
    weights: Array,
    divide: Divide = compute_here,
) -> list[Verified]:
    """Simulate every output channel, with all trials, after each addition, and last with maps, where there are any.

    `fitted` are positions of trials, which weights, (B, F), draw again.
    """
    learnt = np.isin(np.arange(outputs[0].trials), list(fitted))
    pressures: dict[tuple[str, int], Array] = {}
    additions: list[tuple[int, Maps]] = [(step, {}) for step in range(found.last_step + 1)]
    if learned:
        additions.append((found.last_step, learned))
    opened: list[Verified] = []
    last: list[tuple[Model, Array, Noise]] = []
    for output in sorted(outputs, key=lambda each: each.channel != "pressure_kpa"):
        simulated, free = [], []
        for place, (step, maps) in enumerate(additions):
            model, values = found.restore(output, step)
            simulated.append(_simulate(model.output, model, values, maps))
            driven: OutputChannel = model.output
            if isinstance(output, ForceChannel) and (output.element, place) in pressures:
                driven = output.from_signals(dict.fromkeys(PRESSURES, pressures[output.element, place]))
            if isinstance(output, MuscleChannel):
                free.append(_simulate(driven, model, values, maps))
            if output.channel == "pressure_kpa":
                pressures[output.element, place] = simulated[-1]
        opened.append(Verified(output, simulated, free))
        last.append((model, values, found.read_noise(output)))
    for each, (floor, band) in zip(opened, divide(lambda one: _judge(*one, learnt, weights), last), strict=True):
        known = learned.get((each.output.channel, each.output.element))
        each.floor, each.band = floor / each.output.range**2, band if known is None else band.beside(known.deviation)
        if known is not None and known.deviation < found.read_channel(each.output)["noise_floor"]:
            each.floor = each.squares(each.steps[-1])
    return opened


def _simulate(output: OutputChannel, model: Model, values: Array, maps: Maps) -> Array:
    """Return an output, (T, K), of a model's values, with what a map adds to it."""
    constants, effects = model.name_values(values)
    simulated = output.simulate(constants, effects)
    learned = maps.get((output.channel, output.element))
    return simulated if learned is None else simulated + evaluate_map(learned, output.told_by(constants))


def _judge(model: Model, values: Array, noise: Noise, learnt: Mask, weights: Array) -> tuple[Array, Band]:
    """Return what a flexible model beside a model leaves of each trial, (K,), and the band about it; zero without data.

    The weights are of the learnt trials.
    """
    seen, still = _keep_values(model, values, noise)
    band = find_band(still, learnt[seen], weights[:, np.isin(np.flatnonzero(learnt), seen)])
    simulated = np.zeros((len(band.simulated), len(learnt)))
    simulated[:, seen] = band.simulated
    return _find_floor(seen, still, noise, learnt), band._replace(simulated=simulated)


def find_test_floor(model: Model, values: Array, noise: Noise, learnt: Mask) -> Array:
    """Return each trial's sum of squares left by a flexible model fitted to the `learnt` trials; zero without data."""
    return _find_floor(*_keep_values(model, values, noise), noise, learnt)


def _keep_values(model: Model, values: Array, noise: Noise) -> tuple[NDArray[np.intp], Fit]:
    """Return the trials with data, by position, and the model of these at its values."""
    seen = np.flatnonzero(model.output.present.any(axis=0))
    return seen, fit(replace(model, output=model.output.take(seen.tolist())), noise, values, iterations=0)


def _find_floor(seen: NDArray[np.intp], still: Fit, noise: Noise, learnt: Mask) -> Array:
    floor = np.zeros(len(learnt))
    floor[seen] = find_floor(still, noise, learnt[seen]).raw
    return floor


@dataclass(frozen=True)
class Opened:
    """Outputs that count; `draw` returns the generator of a purpose and a part: to resample trials, to flip signs."""

    found: Sequence[Verified]
    settings: DiscrepancySettings
    draw: Callable[..., np.random.Generator]

    def compare_steps(self, labels: Sequence[str], part: str, trials: Sequence[int]) -> list[dict[str, Any]]:
        """Return the gap of some trials before and after each addition, and the noise floor: rows of `verification`.

        `labels` are the names of the steps; the part says what the trials, given by their positions, are for.
        """
        rows: list[dict[str, Any]] = []
        weights = resample(len(trials), self.settings.bootstraps, self.draw("resample", part))
        generator = self.draw("signs", part)
        for kind in (DRIVEN, "free run") if any(each.free for each in self.found) else (DRIVEN,):
            simulated = [each.steps if kind == DRIVEN else each.free for each in self.found]
            squares = [
                [each.squares(own[step]) for each, own in zip(self.found, simulated, strict=True)]
                for step in range(len(labels))
            ]
            if kind == DRIVEN:
                squares.append([each.floor for each in self.found])
            gaps = [_pool(self.found, each, trials) for each in squares]
            for step, (gap, label) in enumerate(zip(gaps, [*labels, "noise floor"], strict=False)):
                drawn = np.sqrt(weights @ gap**2 / len(trials))
                low, high = find_interval(drawn, self.settings.level) if len(trials) > 1 else (np.nan, np.nan)
                falls = (gaps[0] - gap)[:, None], (gaps[max(step - 1, 0)] - gap)[:, None]
                rows.append(
                    {
                        "part": part,
                        "simulation": kind,
                        "step": step,
                        "label": label,
                        "trials": len(trials),
                        "gap": float(np.sqrt(np.mean(gap**2))),
                        "low": float(low),
                        "high": float(high),
                        "p_value": float(compare_signs(falls[0], generator, two_sided=True)[0]) if step else 1.0,
                        "p_step": float(compare_signs(falls[1], generator)[0]) if step else 1.0,
                        "gap_over_std": _pool_over_std(self.found, squares[step], trials),
                    }
                )
        return rows

    def bound_ratio(self, step: int, part: str, trials: Sequence[int]) -> dict[str, float]:
        """Return the gap of some trials over the floor in the worst channel, with one-sided limits over drawn ones."""
        ratios, level = [], self.settings.level
        weights = resample(len(trials), self.settings.bootstraps, self.draw("resample", part))
        for channel in dict.fromkeys(each.output.channel for each in self.found):
            outputs = [each for each in self.found if each.output.channel == channel]
            gap = _pool(outputs, [each.squares(each.steps[step]) for each in outputs], trials) ** 2
            floor = np.maximum(_pool(outputs, [each.floor for each in outputs], trials) ** 2, 1e-300)
            drawn = np.sqrt((weights @ gap) / (weights @ floor))
            low, high = np.quantile(drawn, [1.0 - level, level])
            ratios.append({"value": float(np.sqrt(gap.sum() / floor.sum())), "low": float(low), "high": float(high)})
        return max(ratios, key=lambda each: each["value"])

    def measure_maps(self, learned: Maps, last: int, trials: Sequence[int]) -> list[dict[str, Any]]:
        """Return what learned maps do on some trials, by channel: the gap with what was named, and with them too.

        The p-value is of no change, signs flipped.
        """
        rows, generator = [], self.draw("signs", "learned maps")
        for channel in dict.fromkeys(channel for channel, _ in learned):
            own = [each for each in self.found if each.output.channel == channel]
            own = [each for each in own if (channel, each.output.element) in learned]
            before, after = (_pool(own, [each.squares(each.steps[k]) for each in own], trials) for k in (last, -1))
            maps = [learned[channel, each.output.element] for each in own]
            rows.append(
                {
                    "channel": channel,
                    "muscles": [each.output.element for each in own],
                    "kinds": sorted({each.kind for each in maps}),
                    "inputs": list(dict.fromkeys(told.name for each in maps for told in each.inputs)),
                    "before": float(np.sqrt(np.mean(before**2))),
                    "after": float(np.sqrt(np.mean(after**2))),
                    "p_value": float(compare_signs((before - after)[:, None], generator, two_sided=True)[0]),
                    "least_p": least_p(len(trials), two_sided=True),
                }
            )
        return rows

    def find_coverage(self, trials: Sequence[int]) -> dict[str, float | None]:
        """Return the share of the samples of some trials that bands hold, with its interval over trials drawn again."""
        chosen, within = list(trials), []
        for each in self.found:
            misses = np.abs(each.output.measured - each.steps[-1]) > each.band.reach(self.settings.level)
            within.append((each.output.present & ~misses).sum(axis=0)[chosen])
        counts = sum(each.output.present.sum(axis=0)[chosen] for each in self.found)
        weights = resample(len(chosen), self.settings.bootstraps, self.draw("resample", "coverage"))
        return measure_coverage(sum(within), counts, weights, self.settings.level)

    def list_predictions(self, dataset: Dataset, last: int) -> pd.DataFrame:
        """Return every sample as measured, as simulated before and after the `last` addition, and with learned maps.

        The latter with the band in which a measurement is expected, and the simulation's own deviation apart.
        """
        frames, parts = [], dict(zip(dataset.trials, dataset.parts, strict=True))
        for each in self.found:
            output, half, patched = each.output, each.band.reach(self.settings.level), each.steps[-1]
            rows = list_samples(
                output,
                dataset.trials,
                measured=output.measured,
                before=each.steps[0],
                after=each.steps[last],
                patched=patched,
                low=patched - half,
                high=patched + half,
                deviation=each.band.simulated,
            )
            frames.append(rows.assign(part=rows["trial"].map(parts), time_s=rows["sample"] * output.step_s))
        return pd.concat(frames, ignore_index=True)


def _pool(found: Sequence[Verified], squares: Sequence[Array], trials: Sequence[int]) -> Array:
    """Return each trial's gap, RMSE over range, root mean square over outputs with data in it, (K,) ndarray."""
    counts = np.stack([each.output.present.sum(axis=0) for each in found])[:, list(trials)]
    mean = np.stack(squares)[:, list(trials)] / np.maximum(counts, 1)
    return np.asarray(np.sqrt(np.where(counts > 0, mean, 0.0).sum(axis=0) / np.maximum((counts > 0).sum(axis=0), 1)))


def _pool_over_std(found: Sequence[Verified], squares: Sequence[Array], trials: Sequence[int]) -> float:
    """Return the gap over what was measured, in its standard deviations; root mean square over outputs that vary."""
    chosen, known = list(trials), []
    for each, own in zip(found, squares, strict=True):
        measured = each.output.measured[:, chosen][each.output.present[:, chosen]]
        if measured.size and measured.std() != 0.0:
            ratio = float(np.sqrt(own[chosen].sum() / measured.size) * each.output.range / measured.std())
            known += [ratio] if np.isfinite(ratio) else []
    return float(np.sqrt(np.mean(np.square(known)))) if known else np.nan


def find_odd_trials(predictions: pd.DataFrame, least_ratio: float) -> pd.DataFrame:
    """Return the trials of `list_predictions` whose error is many times the usual one, as after a loose cable.

    Columns are ``channel muscle trial ratio``: error over the median over the channel's trials; the worst first.
    """
    square = (predictions["measured"] - predictions["after"]) ** 2
    by_trial = square.groupby([predictions[name] for name in ("channel", "muscle", "trial")]).mean() ** 0.5
    usual = by_trial.groupby(["channel", "muscle"]).transform("median")
    ratio = (by_trial / usual.where(usual > 0.0)).rename("ratio").reset_index()
    return ratio[ratio["ratio"] > least_ratio].sort_values("ratio", ascending=False).reset_index(drop=True)


def find_unsettled(predictions: pd.DataFrame, least_ratio: float, least_kpa: float) -> dict[int, float]:
    """Return by trial how far its first pressure is from the simulated one, kPa, where that is far more than later on.

    Far is by more than `least_kpa`, and by so many times the median error of the trial's second half.
    """
    pressure = predictions[predictions["channel"] == "pressure_kpa"].dropna(subset="measured")
    off: dict[int, float] = {}
    for _, rows in pressure.groupby(["trial", "muscle"]):
        trial = int(rows["trial"].iloc[0])
        error = (rows["measured"] - rows["after"]).abs().to_numpy()
        if error[0] > max(least_kpa, least_ratio * float(np.median(error[len(error) // 2 :]))):
            off[trial] = max(off.get(trial, 0.0), float(error[0]))
    return off
