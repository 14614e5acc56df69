"""Fits, outputs and learned maps rebuilt from the tables that keep them, and rows for those tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.fitted_channel import FittedChannel, assess, resume
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.flexible import Leftover
from stages.science.output_channels.noise import Noise, make_plain
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.plant.effect import NamedEffect
from stages.science.plant.learned_map import LearnedInput, LearnedMap
from stages.science.signals.trajectories import Array

MAP_VALUES = ("deviation", "lowest", "highest")
INPUT_VALUES = tuple(name for name in LearnedInput.model_fields if name != "name")


@dataclass(frozen=True)
class NominalTables:
    """The nominal fit: constants, noise, and what was left; each field is named as its table."""

    nominal_fit: pd.DataFrame
    channels: pd.DataFrame
    residuals: pd.DataFrame


@dataclass(frozen=True)
class SearchTables:
    """What the search found, and the channels that it began with; each field is named as its table."""

    channels: pd.DataFrame
    decision: pd.DataFrame
    named_effects: pd.DataFrame
    suspected_effects: pd.DataFrame
    unexplained: pd.DataFrame
    steps: pd.DataFrame

    @property
    def last_step(self) -> int:
        """Number of effects that stand."""
        return int(self.steps["step"].max())

    @property
    def status(self) -> str:
        """What is said of the dataset."""
        return str(self.decision["status"].iloc[0])

    def read_noise(self, output: OutputChannel) -> Noise:
        """Return the noise of an output channel."""
        row = self.read_channel(output)
        return Noise(*(float(row[name]) for name in Noise._fields))

    def read_channel(self, output: OutputChannel) -> pd.Series:
        """Return the row of an output channel."""
        rows = self.channels
        return rows[(rows["channel"] == output.channel) & (rows["muscle"] == output.element)].iloc[0]

    def restore(self, output: OutputChannel, step: int) -> tuple[Model, Array]:
        """Return an output's model and values after some additions, its inputs corrected by what is known then."""
        steps = self.steps
        now = steps[(steps["step"] == step) & (steps["muscle"] == output.element)]
        rows = now[now["channel"] == output.channel]
        upstream = now[(now["channel"] != output.channel) & (now["effect"] != "")]
        output = output.correct(group_effects(upstream))
        constants = name_values(rows[rows["effect"] == ""])
        values = [constants[each.name] for each in output.constants]
        forms: list[NamedEffect] = []
        for effect, form, by_name in group_effects(rows[rows["effect"] != ""]):
            found = next((each for each in output.forms if (each.name, each.form) == (effect, form)), None)
            if found is None:
                raise ValueError(f"no effect {effect} of form {form} at this output")
            fitted = tuple(each for each in found.parameters if each.name in by_name)  # of a sensor with one end alone
            forms.append(replace(found, parameters=fitted))
            values += [by_name[each.name] for each in fitted]
        return Model(output, tuple(forms)), np.array(values)

    def resume(self, state: FittedChannel, step: int) -> FittedChannel:
        """Return an output channel as it was after some additions."""
        if step == 0:
            return state
        model, values = self.restore(state.output, step)
        noise = make_plain(state.current.fit.spread)
        return replace(state, current=assess(fit(model, noise, values, iterations=0), noise))


def list_residuals(states: Sequence[FittedChannel], trials: Sequence[int]) -> pd.DataFrame:
    """Return the rows of the table `residuals`; `trials` are the numbers of the outputs' trials."""
    rows = [
        list_samples(each.output, trials, residual=each.nominal.residual, left=each.leftover.residual)
        for each in states
    ]
    return pd.concat(rows, ignore_index=True)


def list_samples(output: OutputChannel, trials: Sequence[int], **signals: Array) -> pd.DataFrame:
    """Return a row for each measured sample, trial by trial: ``channel muscle trial sample`` and signals, (T, K)."""
    place, sample = np.nonzero(output.present.T)
    told = {"channel": output.channel, "muscle": output.element, "trial": np.asarray(trials)[place], "sample": sample}
    return pd.DataFrame(told | {name: values[sample, place] for name, values in signals.items()})


def restore_states(dataset: Dataset, tables: NominalTables) -> list[FittedChannel]:
    """Return the output channels as they were after the nominal fit, with the fitted trials."""
    place = {trial: k for k, trial in enumerate(dataset.fitted_trials)}
    constants, noises, samples = (
        dict(iter(table.groupby(["channel", "muscle"], sort=False)))
        for table in (tables.nominal_fit, tables.channels, tables.residuals)
    )
    states = []
    for output in dataset.fitted_outputs:
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
                Leftover((left**2).sum(axis=0), left, line_hz, str(known["family"])),
            )
        )
    return states


def group_effects(rows: pd.DataFrame) -> list[tuple[str, str, dict[str, float]]]:
    """Return each effect's name, form and parameters."""
    return [
        (str(effect), str(form), name_values(given))
        for (effect, form), given in rows.groupby(["effect", "form"], sort=False)
    ]


def name_values(rows: pd.DataFrame) -> dict[str, float]:
    """Return the values of rows by the names of their parameters."""
    return {str(name): float(value) for name, value in zip(rows["parameter"], rows["value"], strict=True)}


def list_maps(maps: Iterable[LearnedMap]) -> list[dict[str, Any]]:
    """Return the rows of the table `learned_maps`: an input of a bump of each map."""
    return [
        {
            "channel": learned.channel,
            "muscle": learned.element,
            "point": place,
            "input": told.name,
            "value": at,
            **{name: getattr(told, name) for name in INPUT_VALUES},
            "weight": weight,
            **{name: getattr(learned, name) for name in MAP_VALUES},
        }
        for learned in maps
        for place, (point, weight) in enumerate(zip(learned.points, learned.weights, strict=True))
        for at, told in zip(point, learned.inputs, strict=True)
    ]


def read_maps(rows: pd.DataFrame) -> dict[tuple[str, str], LearnedMap]:
    """Return the maps of the table `learned_maps`, by channel and muscle."""
    return {
        (str(channel), str(muscle)): LearnedMap(
            channel=str(channel),
            element=str(muscle),
            inputs=[_read_input(row) for row in own[own["point"] == 0].to_dict("records")],
            **{name: float(own[name].iloc[0]) for name in MAP_VALUES},
            points=[each["value"].tolist() for _, each in own.groupby("point")],
            weights=own.groupby("point")["weight"].first().tolist(),
        )
        for (channel, muscle), own in rows.groupby(["channel", "muscle"], sort=False)
    }


def _read_input(row: Mapping[Any, Any]) -> LearnedInput:
    return LearnedInput(name=str(row["input"]), **{name: float(row[name]) for name in INPUT_VALUES})
