"""What an added effect does, beside what was measured, along the variable that explains most of it.

Outputs with all trials and the last step's values flow in; averages along that variable flow out.
"""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.residuals import LOOP_BINS, average_by_direction, average_in_bins, split_by_direction
from stages.science.discrepancy.restoring import SearchTables
from stages.science.output_channels.muscle_channels import QUANTISATION
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.signals.trajectories import Array


def trace_effects(dataset: Dataset, found: SearchTables) -> pd.DataFrame:
    """Return each added effect's share of the signal and the residual without it, averaged in the same bins.

    Columns are ``effect form channel muscle unit variable direction x measured error added``, over the test trials:
    mean residual of the amended model without the effect, its standard error over trials, what the effect adds.
    """
    frames = []
    effects = found.steps[(found.steps["step"] == found.last_step) & ~found.steps["effect"].isin(["", QUANTISATION])]
    for (name, channel), rows in effects.groupby(["effect", "channel"], sort=False):
        muscles = set(rows["muscle"])
        concerned = [each for each in dataset.outputs if each.channel == channel and each.element in muscles]
        traced = [_trace(each.take(dataset.test), found, str(name)) for each in concerned]
        shares = {variable: sum(_explain(each, variable) for each in traced) for variable in traced[0].variables}
        variable = max(shares, key=shares.__getitem__)
        for each in traced:
            along, output = each.variables[variable], each.output
            seen = average_by_direction(*along, each.without, output).rename(columns={"mean": "measured"})
            model = average_by_direction(*along, each.added, output)
            told: dict[str, Any] = {"effect": name, "form": each.form, "channel": channel, "variable": variable}
            told |= {"muscle": output.element, "unit": output.unit}
            frames.append(seen.assign(added=model["mean"].to_numpy(), **told))
    frames = [each for each in frames if len(each)] or frames
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=["effect"])


class _Traced(NamedTuple):
    """One output: the residual without an effect, what the effect adds, and signals in which it may show.

    Each signal has the rate that gives its direction, or none.
    """

    output: OutputChannel
    form: str
    without: Array
    added: Array
    variables: dict[str, tuple[Array, Array | None]]


def _trace(output: OutputChannel, found: SearchTables, name: str) -> _Traced:
    model, values = found.restore(output, found.last_step)
    output = model.output
    constants, effects = model.name_values(values)
    whole = output.simulate(constants, effects)
    without = output.simulate(constants, [each for each in effects if each[0].name != name])
    form = next(each.form for each, _ in effects if each.name == name)
    signals, rates = output.list_signals(), {each.name for each in output.drivers() if each.rate}
    rate = signals[output.loop[1]]
    variables = {name: (signal, None if name in rates else rate) for name, signal in signals.items()}
    variables["simulated"] = (without, rate)
    variables["simulated_rate"] = (np.gradient(without, output.step_s, axis=0), None)
    times = np.broadcast_arrays(np.arange(len(whole))[:, None] * output.step_s, output.start_s[None, :])
    variables |= {"time_s": (times[0], None), "start_s": (times[1], None)}
    return _Traced(output, form, output.measured - without, whole - without, variables)


def _explain(traced: _Traced, variable: str) -> float:
    """Return the share of variance (correlation ratio) of what an effect adds between bins of equal count."""
    present, (values, rate), added = traced.output.present, traced.variables[variable], traced.added
    edges = np.unique(np.quantile(values[present], np.linspace(0.0, 1.0, LOOP_BINS + 1)))
    if len(edges) < 3:
        return 0.0
    middle, between = float(np.mean(added[present])), 0.0
    for mask in split_by_direction(rate, present).values():
        mean, _, count = average_in_bins(values, added, mask, edges)
        between += float((count * (mean - middle) ** 2).sum())
    return between / (float(present.sum()) * float(np.var(added[present])) + 1e-300)
