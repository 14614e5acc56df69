"""The amended plant: fitted constants and named effects, written as the simulator's own configuration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.resampling import find_interval, resample
from stages.science.discrepancy.restoring import group_effects, name_values
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.fitting import Model, fit
from stages.science.output_channels.noise import Noise
from stages.science.plant.effect import Parameter
from stages.science.plant.learned_map import LearnedMap
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant
from stages.science.signals.trajectories import Array


def amend_plant(
    plant: Plant | RecordPlant,
    values: pd.DataFrame,
    learned: Sequence[LearnedMap],
    channels: pd.DataFrame,
    muscles: pd.DataFrame,
) -> dict[str, Any]:
    """Return the configuration of a plant with fitted constants, added effects and learned maps.

    Effects and maps that a plant had along its muscles' chains are left out: constants were fitted without. What the
    plant left open is resolved from the data. The values have columns ``muscle effect form parameter value``, with an
    empty effect for a nominal constant; channels ``muscle channel white``, the white noise of each sensor; muscles
    ``muscle type``, and no rows for a machine without muscles.
    """
    constants, added = values[values["effect"] == ""], values[values["effect"] != ""]
    if isinstance(plant, RecordPlant):
        return plant.amend(name_values(constants), group_effects(added), learned).model_dump()
    noise = channels.set_index(["channel", "muscle"])["white"]
    models: dict[str, Any] = {name: model.model_dump() for name, model in plant.muscles.items()}
    for muscle, kind in zip(muscles["muscle"], muscles["type"], strict=True):
        base = plant.muscles.get(muscle) or plant.muscles.get(kind) or next(iter(plant.muscles.values()))
        models[muscle] = base.model_dump() | name_values(constants[constants["muscle"] == muscle])
        for channel, name in (("pressure_kpa", "pressure_noise_kpa"), ("force_n", "force_noise_n")):
            if (channel, muscle) in noise.index:
                models[muscle][name] = float(noise[channel, muscle])
    entries = [entry.model_dump() for entry in plant.effects if entry.effect.site == "joint"]
    for carrier, rows in added.groupby("muscle", sort=False):
        own = group_effects(rows)
        entries += [{"name": name, "form": form, "muscles": [str(carrier)], **told} for name, form, told in own]
    maps = [each.model_dump() for each in learned]
    return {**plant.model_dump(), "muscles": models, "effects": entries, "learned": maps}


def estimate_intervals(
    model: Model, values: Array, noise: Noise, settings: DiscrepancySettings, generator: np.random.Generator
) -> list[dict[str, Any]]:
    """Return the values, (P,), of a model of the fitted trials as rows of `amended_values`, with their intervals."""
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
