"""The amended plant: what was named joins the simulator's list of effects, with intervals.

In: what was measured, what was named and the values after the last addition; where a gap stays without a name, the
values before any. Out: `amended_values` (constants and parameters with
intervals over resampled trials) and the document ``amended.yaml``, a plant that ``rig=sim plant=PATH`` loads as it is.
"""

from typing import Any

import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.amendment import amend_plant, estimate_intervals
from stages.science.discrepancy.dataset import DatasetTables, build_dataset
from stages.science.discrepancy.restoring import SearchTables, read_maps
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.plant.machine import Machine

AMENDED_VALUES = Table(
    "amended_values",
    "A value of the amended model",
    {
        "channel": column(str, "measured channel"),
        "muscle": column(str, "muscle, or name of the machine"),
        "effect": column(str, "that it belongs to; empty for a nominal constant"),
        "form": column(str, "form of the effect"),
        "parameter": column(str, "name"),
        "unit": column(str, "its unit"),
        "value": column(float, "fitted", unit="of the row"),
        "low": column(float, "lower end of the interval over resampled trials", unit="of the row"),
        "high": column(float, "upper end of it", unit="of the row"),
        "at_bound": column(str, "bound that it stands at, low or high; empty for neither", among=["", "low", "high"]),
    },
    key=("channel", "muscle", "effect", "parameter"),
)


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    plant: Machine
    seed: int


@stage(AMENDED_VALUES, stream="amend_model")
def amend_model(
    cfg: Config, tables: DatasetTables, found: SearchTables, learned_maps: pd.DataFrame, ctx: Context
) -> pd.DataFrame:
    """Add what was named, and what was learnt without a name, to the plant, and say how sure its values are."""
    settings = cfg.discrepancy
    dataset = build_dataset(cfg.plant, tables, tables.trial_parts, settings)
    rows: list[dict[str, Any]] = []
    for output in dataset.fitted_outputs:
        model, values = found.restore(output, found.last_step)
        rows += estimate_intervals(model, values, found.read_noise(output), settings, ctx.generator("resample"))
    amended = pd.DataFrame(rows, columns=list(AMENDED_VALUES.columns))
    learned = list(read_maps(learned_maps).values())
    plant = amend_plant(dataset.plant, amended, learned, found.channels, tables.measured_muscles)
    ctx.document("amended", plant, "yaml")
    return amended
