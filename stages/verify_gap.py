"""The gap before, after each addition, and the noise floor, on trials opened once; and the verdict.

In: everything before. Out: `verification` (a row per addition, for simulation from measured upstream signals and for
free-run simulation), `predictions` (each sample as measured, simulated before and simulated after), `findings` (the
verdict in words) and the document ``verdict.json``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.discrepancy import (
    PURPOSES,
    DiscrepancySettings,
    Measurements,
    Verified,
    compare_steps,
    describe_effects,
    list_cells,
    list_predictions,
    locate_most,
    resample,
    tell,
    verify,
)
from stages.plant.effect import find_effect
from stages.plant.machine import Machine

VERIFICATION = Table(
    "verification",
    "The gap on trials that were not fitted",
    {
        "part": column(str, "verification, or a recorded part that is only reported"),
        "simulation": column(str, "from what it is simulated", among=["measured upstream", "free run"]),
        "step": column(int, "effects added", low=0),
        "label": column(str, "what was added, or the noise floor"),
        "trials": column(int, "in that part", low=1),
        "gap": column(float, "RMSE over range, root mean square over channels and trials", low=0),
        "low": column(float, "lower end of the interval over resampled trials", low=0),
        "high": column(float, "upper end of it", low=0),
        "gap_over_std": column(float, "RMSE over the measured standard deviation", low=0, nullable=True),
        "p_value": column(float, "of no change against the nominal model, signs flipped exactly", low=0, high=1),
    },
    key=("part", "simulation", "step"),
)
PREDICTIONS = Table(
    "predictions",
    "A sample as measured and as simulated",
    {
        "trial": column(int, "trial of the session", low=0),
        "part": column(str, "fitted, opened once, or only reported", among=list(PURPOSES)),
        "time_s": column(float, "time from the trial's start", unit="s", low=0),
        "muscle": column(str, "whose"),
        "channel": column(str, "measured channel"),
        "measured": column(float, "sensor", unit="of the channel"),
        "before": column(float, "nominal model, fitted", unit="of the channel"),
        "after": column(float, "amended model", unit="of the channel"),
    },
    key=("trial", "channel", "muscle", "time_s"),
)
FINDINGS = Table("findings", "What was found", {"finding": column(str, "a sentence")})


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    plant: Machine
    seed: int


@stage(VERIFICATION, PREDICTIONS, FINDINGS)
def verify_gap(
    cfg: Config,
    measured: pd.DataFrame,
    measured_signals: pd.DataFrame,
    measured_trials: pd.DataFrame,
    measured_muscles: pd.DataFrame,
    measured_session: pd.DataFrame,
    trial_parts: pd.DataFrame,
    channels: pd.DataFrame,
    gap: pd.DataFrame,
    ranking: pd.DataFrame,
    named_effects: pd.DataFrame,
    unexplained: pd.DataFrame,
    steps: pd.DataFrame,
    amended_values: pd.DataFrame,
    ctx: Context,
) -> dict[str, pd.DataFrame]:
    """Open the verification trials, once, and say what was found."""
    settings = cfg.discrepancy
    opened = np.flatnonzero(trial_parts["part"] == "verification").tolist()
    learnt = (trial_parts["part"] == "fitted").to_numpy()
    told = Measurements(measured, measured_signals, measured_trials, measured_muscles, measured_session)
    cells = list_cells(cfg.plant, told, settings)
    found = verify(cells, steps, channels, learnt)
    added = named_effects.drop_duplicates("order")
    concerned = set(added["channel"]) or {each.cell.channel for each in found}
    labels = ["nominal", *(f"+ {name}" for name in added["name"])][: int(steps["step"].max()) + 1]
    judged = [each for each in found if each.cell.channel in concerned]
    rows = []
    for part, chosen in list_reported(trial_parts, measured_trials, judged).items():
        weights = resample(len(chosen), settings.bootstraps, ctx.generator("resample", part))
        compared = compare_steps(judged, labels, chosen, weights, settings.level, ctx.generator("signs", part))
        rows += [{"part": part, **row} for row in compared]
    verification = pd.DataFrame(rows, columns=list(VERIFICATION.columns))
    places = locate_most(gap, channels, settings.search.smallest_gap)
    verdict = conclude(cfg, verification, places, ranking, named_effects, unexplained, amended_values)
    verdict["verification_trials"] = [int(trial) for trial in trial_parts["trial"].iloc[opened]]
    ctx.verdict(verdict)
    splits = {each: find_effect(each).split_by for each in added["name"]}
    parts = dict(zip(trial_parts["trial"], trial_parts["part"], strict=True))
    return {
        VERIFICATION.name: verification,
        PREDICTIONS.name: list_predictions(found, list(trial_parts["trial"]), parts),
        FINDINGS.name: pd.DataFrame({"finding": tell(verdict, places, splits)}),
    }


def conclude(
    cfg: Config,
    verification: pd.DataFrame,
    places: list[dict[str, Any]],
    ranking: pd.DataFrame,
    named_effects: pd.DataFrame,
    unexplained: pd.DataFrame,
    amended_values: pd.DataFrame,
) -> dict[str, Any]:
    """Return the verdict as it is kept."""
    search = cfg.discrepancy.search
    driven = verification[verification["simulation"] == "measured upstream"]
    driven = driven[driven["part"] == "verification"]
    before, after, floor = driven.iloc[0], driven.iloc[-2], driven.iloc[-1]
    most = unexplained.sort_values("probability").iloc[-1]
    status = (
        "unexplained" if most["probability"] > search.certain else "named" if len(named_effects) else "no_discrepancy"
    )
    effects = describe_effects(named_effects, amended_values) if status == "named" else []
    first = ranking[ranking["round"] == 1]
    where = ("channel", "muscle", "regime", "share_of_gap", "p_value")
    return {
        "status": status,
        "effects": effects,
        "ranking": [
            {
                "name": str(row["name"]),
                "probability": float(row["probability"]),
                "heldout_gap": float(row["heldout_gap"]),
                "absorbed": bool(row["absorbed"]),
            }
            for row in first.to_dict("records")
        ],
        "absorbed": [str(name) for name in first.loc[first["absorbed"], "name"]],
        "where": [{name: row[name] for name in where} for row in places],
        "unexplained_share": max(float(most["share"]), 0.0),
        "gap": {
            "before": float(before["gap"]),
            "after": float(after["gap"]),
            "noise_floor": float(floor["gap"]),
            "unit": "RMSE / range, verification trials",
            "p_value": float(after["p_value"]),
            "low": float(after["low"]),
            "high": float(after["high"]),
        },
    }


def list_reported(
    trial_parts: pd.DataFrame, measured_trials: pd.DataFrame, judged: Sequence[Verified]
) -> dict[str, list[int]]:
    """Return the positions of the trials that are judged together: those opened, then each part that was left aside."""
    purposes, seen = trial_parts["part"].to_numpy(), sum(each.cell.present.sum(axis=0) for each in judged)
    reported = {"verification": np.flatnonzero(purposes == "verification").tolist()}
    aside = measured_trials["part"].where((purposes == "other") & (seen > 0))
    return reported | {str(part): list(rows) for part, rows in aside.groupby(aside).indices.items()}
