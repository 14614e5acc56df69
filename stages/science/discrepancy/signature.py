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
from stages.science.plant.learned_map import SESSION_TIME, TIME
from stages.science.recording.signal_names import label, name_signal, per_second
from stages.science.signals.trajectories import Array


def trace_effects(dataset: Dataset, found: SearchTables) -> pd.DataFrame:
    """Return each added effect's share of the signal and the residual without it, averaged in the same bins.

    Columns are ``effect form channel muscle unit rate x_label direction x measured error added``, over the test trials:
    the signal that tells the direction, what an axis of the other one says, mean residual of the amended model without
    the effect, its standard error over trials, what the effect adds.
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
            (along, rate, words), output = each.variables[variable], each.output
            seen = average_by_direction(along, rate, each.without, output).rename(columns={"mean": "measured"})
            model = average_by_direction(along, rate, each.added, output)
            told: dict[str, Any] = {"effect": name, "form": each.form, "channel": channel, "x_label": words}
            told |= {"muscle": output.element, "unit": output.unit, "rate": output.loop[1]}
            frames.append(seen.assign(added=model["mean"].to_numpy(), **told))
    frames = [each for each in frames if len(each)] or frames
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=["effect"])


class _Traced(NamedTuple):
    """One output: the residual without an effect, what the effect adds, and signals in which it may show.

    Each signal has the rate that gives its direction, or none, and what an axis of it says.
    """

    output: OutputChannel
    form: str
    without: Array
    added: Array
    variables: dict[str, tuple[Array, Array | None, str]]


def _trace(output: OutputChannel, found: SearchTables, name: str) -> _Traced:
    model, values = found.restore(output, found.last_step)
    output = model.output
    constants, effects = model.name_values(values)
    whole = output.simulate(constants, effects)
    without = output.simulate(constants, [each for each in effects if each[0].name != name])
    form = next(each.form for each, _ in effects if each.name == name)
    own = output.list_own()
    rate = own[output.loop[1]].shown
    variables = {name: (each.shown, None if each.rate else rate, each.label) for name, each in own.items()}
    simulated, unit = f"simulated {output.channel}", per_second(name_signal(output.channel)[1])
    variables[simulated] = (without, rate, label(simulated))
    change = np.gradient(without, output.step_s, axis=0)
    variables[f"rate of {simulated}"] = (change, None, label(f"rate of {simulated}", unit))
    times = np.broadcast_arrays(np.arange(len(whole))[:, None] * output.step_s, output.start_s[None, :])
    for name, values in zip((TIME, SESSION_TIME), times, strict=True):
        variables[name] = (values, None, label(name))
    return _Traced(output, form, output.measured - without, whole - without, variables)


def _explain(traced: _Traced, variable: str) -> float:
    """Return the share of variance (correlation ratio) of what an effect adds between bins of equal count."""
    present, (values, rate, _), added = traced.output.present, traced.variables[variable], traced.added
    edges = np.unique(np.quantile(values[present], np.linspace(0.0, 1.0, LOOP_BINS + 1)))
    if len(edges) < 3:
        return 0.0
    middle, between = float(np.mean(added[present])), 0.0
    for mask in split_by_direction(rate, present).values():
        mean, _, count = average_in_bins(values, added, mask, edges)
        between += float((count * (mean - middle) ** 2).sum())
    return between / (float(present.sum()) * float(np.var(added[present])) + 1e-300)
