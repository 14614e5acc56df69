"""The amended plant: fitted constants and named effects, written as the simulator's own configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.resampling import find_interval, resample
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import Noise
from stages.science.plant.effect import Parameter
from stages.science.plant.plant import MuscleModel, Plant
from stages.science.plant.record_plant import RecordPlant
from stages.science.signals.trajectories import Array


def amend_plant(
    plant: Plant | RecordPlant, values: pd.DataFrame, channels: pd.DataFrame, muscles: pd.DataFrame
) -> dict[str, Any]:
    """Return the configuration of a plant with fitted constants and added effects.

    Parameters
    ----------
    plant : Plant, or one of records
        What was configured; what it left open is resolved from the data.
    values : DataFrame
        Columns ``muscle effect form parameter value``; an empty effect marks a nominal constant.
    channels : DataFrame
        Columns ``muscle channel white``: the white noise of each sensor.
    muscles : DataFrame
        Columns ``muscle type``; empty for a machine without muscles.
    """
    if isinstance(plant, RecordPlant):
        return _amend_records(plant, values).model_dump()
    return _amend_muscles(plant, values, channels, dict(zip(muscles["muscle"], muscles["type"], strict=True)))


def _amend_records(plant: RecordPlant, values: pd.DataFrame) -> RecordPlant:
    constants = _by_name(values[values["effect"] == ""])
    chosen = [
        (str(name), str(form), _by_name(rows))
        for (name, form), rows in values[values["effect"] != ""].groupby(["effect", "form"], sort=False)
    ]
    return plant.amend(constants, chosen)


def _by_name(rows: pd.DataFrame) -> dict[str, float]:
    return {str(name): float(value) for name, value in zip(rows["parameter"], rows["value"], strict=True)}


def _amend_muscles(
    plant: Plant, values: pd.DataFrame, channels: pd.DataFrame, types: Mapping[str, str]
) -> dict[str, Any]:
    """Return a plant's configuration with fitted constants, noises and added effects; `types` are by muscle.

    Effects that the plant had along its muscles' chains are left out: the constants were fitted without them.
    """
    noise = channels.set_index(["channel", "muscle"])["white"]
    muscles: dict[str, Any] = {name: model.model_dump() for name, model in plant.muscles.items()}
    for muscle, kind in types.items():
        base = plant.muscles.get(muscle) or plant.muscles.get(kind) or next(iter(plant.muscles.values()))
        muscles[muscle] = _amend_muscle(base, values[values["muscle"] == muscle], noise, muscle)
    entries = [entry.model_dump() for entry in plant.effects if entry.effect.site == "joint"]
    chosen = values[values["effect"] != ""]
    for (effect, form, carrier), rows in chosen.groupby(["effect", "form", "muscle"], sort=False):
        parameters = dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))
        entries.append({"name": str(effect), "form": str(form), "muscles": [str(carrier)], **parameters})
    return {**plant.model_dump(), "muscles": muscles, "effects": entries}


def _amend_muscle(base: MuscleModel, rows: pd.DataFrame, noise: Any, muscle: str) -> dict[str, Any]:
    constants = rows[rows["effect"] == ""].set_index("parameter")["value"]
    fitted = {str(name): float(value) for name, value in constants.items()}
    for channel, name in (("pressure_kpa", "pressure_noise_kpa"), ("force_n", "force_noise_n")):
        if (channel, muscle) in noise.index:
            fitted[name] = float(noise[channel, muscle])
    return {**base.model_dump(), **fitted}


def estimate_intervals(
    model: Model, values: Array, noise: Noise, settings: DiscrepancySettings, generator: np.random.Generator
) -> list[dict[str, Any]]:
    """Return every value of a fitted model with its interval over resampled trials, and the bound it stands at, if any.

    Parameters
    ----------
    model : Model
        Of the fitted trials.
    values : (P,) ndarray
        Fitted.
    noise : Noise
        Of the channel.
    settings : DiscrepancySettings
        Number of resamplings and level.
    generator : numpy.random.Generator
        Draws the trials.
    """
    found = fit(model, noise, values, iterations=0)
    weights = resample(model.output.trials, settings.bootstraps, generator)
    low, high = find_interval(found.drawn_values(weights), settings.level)
    bounds = np.where(found.free, "", np.where(2.0 * values < sum(model.bounds), "low", "high"))
    owners: list[tuple[str, str, Parameter]] = [("", "", each) for each in model.output.constants]
    owners += [(form.name, form.form, each) for form in model.forms for each in form.parameters]
    return [
        {
            "channel": model.output.channel,
            "muscle": model.output.element,
            "effect": effect,
            "form": form,
            "parameter": parameter.name,
            "unit": parameter.unit,
            "value": float(values[index]),
            "low": float(min(low[index], values[index])),
            "high": float(max(high[index], values[index])),
            "at_bound": str(bounds[index]),
        }
        for index, (effect, form, parameter) in enumerate(owners)
    ]
