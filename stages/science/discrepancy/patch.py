"""Learned maps of what has no name: which are taken, and rows that keep them.

Descriptions of what is left flow in; rows of `learned_maps` flow out, and maps from these rows.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from stages.science.discrepancy.description import Description
from stages.science.plant.learned_map import LearnedInput, LearnedMap

VALUES = ("deviation", "lowest", "highest")
INPUT = tuple(name for name in LearnedInput.model_fields if name != "name")


def list_patches(described: Sequence[Description]) -> list[dict[str, Any]]:
    """Return the rows of `learned_maps`: an input of a bump of each map that trials left out confirm."""
    return [
        {
            "channel": learned.channel,
            "muscle": learned.element,
            "point": place,
            "input": told.name,
            "value": at,
            **{name: getattr(told, name) for name in INPUT},
            "weight": weight,
            **{name: getattr(learned, name) for name in VALUES},
        }
        for learned in (each.patch for each in described)
        if learned is not None
        for place, (point, weight) in enumerate(zip(learned.points, learned.weights, strict=True))
        for at, told in zip(point, learned.inputs, strict=True)
    ]


def read_patches(rows: pd.DataFrame) -> dict[tuple[str, str], LearnedMap]:
    """Return the maps of the table `learned_maps`, by channel and muscle."""
    return {
        (str(channel), str(muscle)): LearnedMap(
            channel=str(channel),
            element=str(muscle),
            inputs=[_read_input(row) for row in own[own["point"] == 0].to_dict("records")],
            **{name: float(own[name].iloc[0]) for name in VALUES},
            points=[each["value"].tolist() for _, each in own.groupby("point")],
            weights=own.groupby("point")["weight"].first().tolist(),
        )
        for (channel, muscle), own in rows.groupby(["channel", "muscle"], sort=False)
    }


def _read_input(row: Mapping[Any, Any]) -> LearnedInput:
    return LearnedInput(name=str(row["input"]), **{name: float(row[name]) for name in INPUT})
