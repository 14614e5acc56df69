"""What stays unexplained, described: on which measured signals it depends, and a formula as a hint.

In: what was measured, what was named and the values after the last addition. Out: `remainder`, a row for each channel
of a muscle whose gap is still above the noise floor; and `learned_maps`, which mend it without a name. Only fitted
trials are looked at, and nothing is named.
"""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.dataset import DatasetTables, build_dataset
from stages.science.discrepancy.description import Description, average_dependence, describe_above_floor, tabulate
from stages.science.discrepancy.effect_file import choose_formula, write_effect
from stages.science.discrepancy.restoring import SearchTables, list_maps
from stages.science.discrepancy.settings import DescriptionSettings, DiscrepancySettings
from stages.science.figures.located_gap import draw_unexplained
from stages.science.plant.machine import Machine
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant

REMAINDER = Table(
    "remainder",
    "What stays unexplained in a channel of a muscle, and on what it depends",
    {
        "channel": column(str, "measured channel"),
        "muscle": column(str, "muscle, or name of the machine"),
        "unit": column(str, "unit of the channel"),
        "gap": column(float, "root mean square of what the amended model leaves", unit="of the channel", low=0),
        "noise_floor": column(float, "what of it nothing reproducible explains", unit="of the channel", low=0),
        "above_floor": column(float, "share of its variance above the floor", low=0, high=1),
        "inputs": column(str, "signals on which it depends, the most telling first, by comma; empty: none confirmed"),
        "share": column(float, "of its variance, what a Gaussian process of these takes away, trials left out", high=1),
        "low": column(float, "lower end of the interval over resampled trials", high=1),
        "high": column(float, "upper end of it", high=1),
        "range_low": column(float, "where: of the first input, from", unit="of the input", nullable=True),
        "range_high": column(float, "to", unit="of the input", nullable=True),
        "range_part": column(float, "part of what is taken away that lies there", low=0, high=1, nullable=True),
        "range_time": column(float, "share of the time spent there", low=0, high=1, nullable=True),
        "hint": column(str, "formula, fitted together with the constants; a hint, no finding; empty: none confirmed"),
        "hint_share": column(float, "of its variance, what the formula takes away, trials left out", nullable=True),
        "hint_low": column(float, "lower end of the interval over resampled trials", nullable=True),
        "hint_high": column(float, "upper end of it", nullable=True),
        "drift": column(
            str, "the value of the model whose even drift along the session takes away most of it; or empty"
        ),
        "drift_unit": column(str, "unit of that value"),
        "drift_first": column(float, "that value when the session begins", unit="of the value", nullable=True),
        "drift_last": column(float, "and when it ends", unit="of the value", nullable=True),
        "drift_share": column(float, "of its variance, what the drift takes away, trials left out", nullable=True),
    },
    key=("channel", "muscle"),
    brief=("channel", "muscle", "inputs", "share", "low", "high", "hint", "hint_share"),
)
LEARNED_MAPS = Table(
    "learned_maps",
    "An input of a bump of a learned map, which is added to the simulated channel",
    {
        "channel": column(str, "measured channel"),
        "muscle": column(str, "muscle, or name of the machine"),
        "point": column(int, "number of the bump", low=0),
        "input": column(str, "signal that the map is told from, or its history"),
        "value": column(float, "where the bump is, in spreads from the input's middle"),
        "middle": column(float, "mean of the input where the map was learnt", unit="of the input"),
        "spread": column(float, "its standard deviation there", unit="of the input", low=0),
        "length": column(float, "length scale of the bump along it, in spreads", low=0),
        "low": column(float, "least value of the input where the map was learnt", unit="of the input"),
        "high": column(float, "largest value there", unit="of the input"),
        "weight": column(float, "height of the bump", unit="of the channel"),
        "deviation": column(float, "root mean square of what the map leaves, trials left out", unit="of the channel"),
        "lowest": column(float, "least value that the map had where it was learnt", unit="of the channel"),
        "highest": column(float, "largest value that it had there", unit="of the channel"),
    },
    key=("channel", "muscle", "point", "input"),
    brief=("channel", "muscle", "input", "low", "high", "deviation"),
)
OWN_EFFECT = Table(
    "own_effect",
    "An effect that was to be written from the formula of what is left",
    {
        "name": column(str, "of the effect"),
        "file": column(str, "in the run's folder; empty where none could be written"),
        "told": column(str, "its formula, or why there is none"),
    },
)


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    explain_remainder: DescriptionSettings
    plant: Machine
    seed: int


@stage(REMAINDER, LEARNED_MAPS, OWN_EFFECT, stream="describe_remainder")
def explain_remainder(cfg: Config, tables: DatasetTables, found: SearchTables, ctx: Context) -> dict[str, pd.DataFrame]:
    """Describe what the amended model leaves above the noise floor, and learn a map of it."""
    settings = cfg.discrepancy
    dataset = build_dataset(cfg.plant, tables, tables.trial_parts, settings)
    described = describe_above_floor(dataset, found, settings, cfg.explain_remainder, ctx.generator, ctx.divide)
    averages = average_dependence(described)
    if len(averages):
        ctx.figure(
            "unexplained",
            draw_unexplained(averages),
            "What stays unexplained, on average over the input that tells most of it (points, two standard errors over "
            "trials), and what a Gaussian process makes of it (lines, two standard deviations). It has no name.",
        )
    own = [] if settings.write_effect is None else [keep_effect(settings.write_effect, described, dataset.plant, ctx)]
    maps = list_maps(each.patch for each in described if each.patch is not None)
    rows: list[list[Any]] = [[tabulate(each) for each in described], maps, own]
    both = zip(explain_remainder.writes, rows, strict=True)
    return {table.name: pd.DataFrame(kept, columns=list(table.columns)) for table, kept in both}


def keep_effect(
    name: str, described: Sequence[Description], plant: Plant | RecordPlant, ctx: Context
) -> dict[str, str]:
    """Write an effect of a name among the run's documents, and return its row of `own_effect`."""
    best = choose_formula(described)
    if best is None:
        return {"name": name, "file": "", "told": "no formula of what is left is confirmed by trials left out"}
    try:
        ctx.source(name, write_effect(name, best, plant))
    except ValueError as refusal:
        return {"name": name, "file": "", "told": str(refusal)}
    return {"name": name, "file": f"documents/{name}.py", "told": best.sketch.formula}
