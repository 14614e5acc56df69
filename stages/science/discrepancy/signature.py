"""What an added effect does, beside what was measured, along the variable that explains most of it.

Outputs with all trials and the last step's values flow in; averages along that variable flow out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.residuals import (
    LOOP_BINS,
    average_by_direction,
    average_in_bins,
    list_signals,
    split_by_direction,
)
from stages.science.discrepancy.restoring import SearchTables
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array


def trace_effects(dataset: Dataset, found: SearchTables) -> pd.DataFrame:
    """Return each added effect's share of the signal and the residual without it, averaged in the same bins.

    Returns
    -------
    DataFrame
        Columns ``effect form channel muscle unit variable direction x measured error added``, over the test trials:
        mean residual of the amended model without the effect, its standard error over trials, what the effect adds.
    """
    frames = []
    effects = found.steps[(found.steps["step"] == found.last_step) & (found.steps["effect"] != "")]
    for (name, channel), rows in effects.groupby(["effect", "channel"], sort=False):
        concerned = [
            each for each in dataset.outputs if each.channel == channel and each.element in set(rows["muscle"])
        ]
        traced = [_trace(each.take(dataset.test), found, str(name)) for each in concerned]
        variable = _choose_variable(traced)
        for each in traced:
            told: dict[str, Any] = {"effect": name, "form": each.form, "channel": channel, "variable": variable}
            told |= {"muscle": each.output.element, "unit": each.output.unit}
            frames.append(_average(each, variable).assign(**told))
    return pd.concat([each for each in frames if len(each)] or frames, ignore_index=True)


@dataclass(frozen=True)
class _Traced:
    """One output: the residual without an effect, what the effect adds, and signals in which it may show."""

    output: OutputChannel
    form: str
    without: Array
    added: Array
    variables: dict[str, Array]
    levels: frozenset[str]
    rate: Array


def _trace(output: OutputChannel, found: SearchTables, name: str) -> _Traced:
    model, values = found.restore(output, found.last_step)
    output = model.output
    constants, effects = model.name_values(values)
    whole = output.simulate(constants, effects)
    without = output.simulate(constants, [each for each in effects if each[0].name != name])
    form = next(each.form for each, _ in effects if each.name == name)
    own = [each for each in output.drivers() if each.own]
    times = np.broadcast_arrays(np.arange(len(whole))[:, None] * output.step_s, output.start_s[None, :])
    variables = list_signals(output)
    variables |= {"simulated": without, "simulated_rate": np.gradient(without, output.step_s, axis=0)}
    variables |= dict(zip(("time_s", "start_s"), times, strict=True))
    levels = frozenset({"simulated", *(each.name for each in own if not each.rate)})
    rate = variables[output.loop[1]]
    return _Traced(output, form, output.measured - without, whole - without, variables, levels, rate)


def _choose_variable(traced: Sequence[_Traced]) -> str:
    """Return the variable whose bins, by direction, hold most of the variance of what the effect adds."""
    shares = {name: sum(_explain(each, name) for each in traced) for name in traced[0].variables}
    return max(shares, key=lambda name: shares[name])


def _explain(traced: _Traced, variable: str) -> float:
    """Return the share of variance (correlation ratio) of what an effect adds between bins of equal count."""
    present, values, added = traced.output.present, traced.variables[variable], traced.added
    edges = np.unique(np.quantile(values[present], np.linspace(0.0, 1.0, LOOP_BINS + 1)))
    if len(edges) < 3:
        return 0.0
    rate = traced.rate if variable in traced.levels else None
    middle, between = float(np.mean(added[present])), 0.0
    for mask in split_by_direction(rate, present).values():
        mean, _, count = average_in_bins(values, added, mask, edges)
        between += float((count * (mean - middle) ** 2).sum())
    return between / (float(present.sum()) * float(np.var(added[present])) + 1e-300)


def _average(traced: _Traced, variable: str) -> pd.DataFrame:
    values, rate = traced.variables[variable], traced.rate if variable in traced.levels else None
    seen = average_by_direction(values, rate, traced.without, traced.output).rename(columns={"mean": "measured"})
    model = average_by_direction(values, rate, traced.added, traced.output)
    return seen.assign(added=model["mean"].to_numpy())
