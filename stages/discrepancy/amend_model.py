"""The amended plant: what was named joins the simulator's list of effects, with intervals.

In: what was measured, what was named and the values after the last addition; where a gap stays without a name, the
values before any. Out: `amended_values` (constants and parameters with
intervals over resampled trials) and the document ``amended.yaml``, a plant that ``rig=sim plant=PATH`` loads as it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.amendment import estimate_intervals
from stages.science.discrepancy.machines import Measurements, list_channels, settle, write_amended
from stages.science.discrepancy.restoring import restore
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.discrepancy.verdict import decide_status
from stages.science.plant.machine import Machine

AMENDED_VALUES = Table(
    "amended_values",
    "A value of the amended model",
    {
        "channel": column(str, "measured channel"),
        "muscle": column(str, "whose"),
        "effect": column(str, "that it belongs to; empty for a nominal constant"),
        "form": column(str, "form of the effect"),
        "parameter": column(str, "name"),
        "unit": column(str, "its unit"),
        "value": column(float, "fitted", unit="as told"),
        "low": column(float, "lower end of the interval over resampled trials", unit="as told"),
        "high": column(float, "upper end of it", unit="as told"),
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
    cfg: Config,
    measured: pd.DataFrame,
    measured_signals: pd.DataFrame,
    measured_trials: pd.DataFrame,
    measured_muscles: pd.DataFrame,
    measured_session: pd.DataFrame,
    trial_parts: pd.DataFrame,
    channels: pd.DataFrame,
    named_effects: pd.DataFrame,
    unexplained: pd.DataFrame,
    steps: pd.DataFrame,
    ctx: Context,
) -> pd.DataFrame:
    """Add what was named to the plant, and say how sure its values are."""
    settings = cfg.discrepancy
    fitted = np.flatnonzero(trial_parts["part"] == "fitted").tolist()
    told = Measurements(measured, measured_signals, measured_trials, measured_muscles, measured_session)
    told = told.keep_apart(trial_parts)
    outputs = list_channels(cfg.plant, told, settings)
    status = decide_status(
        list(named_effects["probability"]), unexplained["probability"].max(), settings.search.certain
    )
    last = int(steps["step"].max()) if status == "named" else 0
    rows: list[dict[str, Any]] = []
    for output in outputs:
        model, values = restore(output.take(fitted), steps, last)
        noise = channels[(channels["channel"] == output.channel) & (channels["muscle"] == output.element)].iloc[0]
        rows += estimate_intervals(model, values, noise, settings, ctx.generator("resample"))
    amended = pd.DataFrame(rows, columns=list(AMENDED_VALUES.columns))
    ctx.document("amended", write_amended(settle(cfg.plant, outputs), amended, channels, measured_muscles), "yaml")
    return amended
