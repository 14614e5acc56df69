"""Fits and outputs rebuilt from the values that tables keep, and rows for those tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.discrepancy.fitted_channel import FittedChannel, resume
from stages.science.output_channels.fitting import Model
from stages.science.output_channels.flexible import Leftover
from stages.science.output_channels.noise import Noise
from stages.science.output_channels.output_channel import EffectForm, OutputChannel
from stages.science.signals.trajectories import Array


def list_residuals(states: Sequence[FittedChannel], trials: Sequence[int]) -> pd.DataFrame:
    """Return what the nominal model leaves of every sample, and what a flexible one would leave, trials left out.

    Parameters
    ----------
    states : sequence of FittedChannel
        Prepared.
    trials : sequence of int
        Numbers of their trials.

    Returns
    -------
    DataFrame
        Columns ``channel muscle trial sample residual left``.
    """
    frames = []
    for state in states:
        place, sample = np.nonzero(state.output.present.T)
        rows = {
            "channel": state.output.channel,
            "muscle": state.output.element,
            "trial": np.asarray(trials)[place],
            "sample": sample,
            "residual": state.nominal.residual[sample, place],
            "left": state.leftover.residual[sample, place],
        }
        frames.append(pd.DataFrame(rows))
    return pd.concat(frames, ignore_index=True)


def restore_states(
    outputs: Sequence[OutputChannel],
    trials: Sequence[int],
    nominal_fit: pd.DataFrame,
    channels: pd.DataFrame,
    residuals: pd.DataFrame,
) -> list[FittedChannel]:
    """Return outputs as they were after the nominal fit.

    Parameters
    ----------
    outputs : sequence of OutputChannel
        With the fitted trials.
    trials : sequence of int
        Their numbers, in the order of the outputs' last axis.
    nominal_fit, channels, residuals : DataFrame
        Constants, noise, and what was left, by channel and muscle.
    """
    place = {trial: k for k, trial in enumerate(trials)}
    constants, noises, samples = (
        dict(iter(table.groupby(["channel", "muscle"], sort=False))) for table in (nominal_fit, channels, residuals)
    )
    states = []
    for output in outputs:
        key = (output.channel, output.element)
        values = constants[key].set_index("constant")["value"]
        known, rows = noises[key].iloc[0], samples[key]
        at = (rows["sample"].to_numpy(), rows["trial"].map(place).to_numpy())
        residual, left = np.zeros(output.measured.shape), np.zeros(output.measured.shape)
        residual[at], left[at] = rows["residual"], rows["left"]
        line_hz = None if np.isnan(known["line_hz"]) else float(known["line_hz"])
        states.append(
            resume(
                output,
                np.array([float(values[each.name]) for each in output.constants]),
                Noise(*(float(known[name]) for name in Noise._fields)),
                residual,
                Leftover((left**2).sum(axis=0), left, line_hz, bool(known["remembered"])),
            )
        )
    return states


def restore(output: OutputChannel, steps: pd.DataFrame, step: int) -> tuple[Model, Array]:
    """Return an output's model and values after a number of additions, its inputs corrected by what is known then.

    Parameters
    ----------
    output : OutputChannel
        With any of the session's trials.
    steps : DataFrame
        Columns ``step channel muscle effect form parameter value``.
    step : int
        Effects added.
    """
    now = steps[(steps["step"] == step) & (steps["muscle"] == output.element)]
    rows = now[now["channel"] == output.channel]
    upstream = now[(now["channel"] != output.channel) & (now["effect"] != "")]
    output = output.correct([(effect, form, values) for effect, form, values in _group(upstream)])
    constants = rows[rows["effect"] == ""].set_index("parameter")["value"]
    values = [float(constants[each.name]) for each in output.constants]
    forms: list[EffectForm] = []
    for effect, form, by_name in _group(rows[rows["effect"] != ""]):
        found = find_form(output, effect, form)
        forms.append(found)
        values += [by_name[each.name] for each in found.parameters]
    return Model(output, tuple(forms)), np.array(values)


def _group(rows: pd.DataFrame) -> list[tuple[str, str, dict[str, float]]]:
    """Return each effect's name, form and parameters."""
    return [
        (str(effect), str(form), {str(n): float(v) for n, v in zip(given["parameter"], given["value"], strict=True)})
        for (effect, form), given in rows.groupby(["effect", "form"], sort=False)
    ]


def find_form(output: OutputChannel, name: str, form: str) -> EffectForm:
    """Return one of the output's forms.

    Raises
    ------
    ValueError
        When the output offers none of that name.
    """
    for each in output.forms:
        if (each.name, each.form) == (name, form):
            return each
    raise ValueError(f"{output.channel} of {output.element}: no effect {name} of form {form}")
