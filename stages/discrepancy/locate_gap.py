"""Where simulation and measurement disagree: nominal constants first, then channel by channel along the chain.

In: what was measured. Out: `trial_parts` (which trials are fitted, and which are opened once, at the end),
`nominal_fit` (the constants), `channels` (gap and noise floor of every muscle's channels), `residuals` (what is left
of every sample) and `gap` (in which regime of motion and time it lies, tested over trials). Each channel is simulated
from measured upstream signals.
"""

import math
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.errors import InputError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.dataset import build_dataset, check_plant
from stages.science.discrepancy.fitted_channel import FittedChannel, prepare_all
from stages.science.discrepancy.gaps import locate
from stages.science.discrepancy.parts import PURPOSES, Parts, list_parts
from stages.science.discrepancy.resampling import find_interval, resample
from stages.science.discrepancy.residuals import average_loops, average_plane
from stages.science.discrepancy.restoring import list_residuals
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.figures.located_gap import draw_gap_bars, draw_gap_map, draw_residual_loops, draw_residual_plane
from stages.science.plant.machine import Machine
from stages.science.recording.measured_tables import MeasuredTables

OUTPUT = {"channel": column(str, "measured channel"), "muscle": column(str, "muscle, or name of the machine")}
TRIAL_PARTS = Table(
    "trial_parts",
    "A trial and what it is for",
    {
        "trial": column(int, "trial of the dataset", low=0),
        "part": column(str, "fitted, opened once at the end, or only reported", among=list(PURPOSES)),
        "left_before": column(int, "samples at its beginning that are not judged, next to one that is opened", low=0),
        "left_after": column(int, "the same at its end", low=0),
    },
    key=("trial",),
)
NOMINAL_FIT = Table(
    "nominal_fit",
    "A nominal constant, fitted",
    {
        **OUTPUT,
        "constant": column(str, "name of the constant"),
        "unit": column(str, "its unit"),
        "start": column(float, "value to begin with", unit="of the row"),
        "value": column(float, "fitted", unit="of the row"),
        "low": column(float, "lower end of the interval over resampled trials", unit="of the row"),
        "high": column(float, "upper end of it", unit="of the row"),
        "at_bound": column(bool, "whether its tolerance ends there"),
    },
    key=(*OUTPUT, "constant"),
)
CHANNELS = Table(
    "channels",
    "A channel of a muscle after the nominal fit, each trial left out in turn",
    {
        **OUTPUT,
        "unit": column(str, "unit of the channel"),
        "trials": column(int, "fitted trials", low=1),
        "samples": column(int, "measured samples in them", low=1),
        "range": column(float, "largest less smallest value", unit="of the channel", low=0),
        "gap": column(float, "root mean square of measured less simulated", unit="of the channel", low=0),
        "noise_floor": column(float, "what of it nothing reproducible explains", unit="of the channel", low=0),
        "gap_over_floor": column(float, "gap over noise floor", low=0),
        "upper": column(float, "one-sided upper limit of it over resampled trials", low=0),
        "white": column(float, "white part of the noise", unit="of the channel", low=0),
        "quick": column(float, "quick part of it", unit="of the channel", low=0),
        "quick_s": column(float, "its time constant", unit="s", low=0),
        "slow": column(float, "slow part of it", unit="of the channel", low=0),
        "slow_s": column(float, "its time constant", unit="s", low=0),
        "line_hz": column(float, "frequency of an oscillation in all trials", unit="Hz", low=0, nullable=True),
        "family": column(str, "family that tells most of what is reproducible: memory, session_change, or empty"),
    },
    key=("channel", "muscle"),
    brief=("channel", "muscle", "unit", "gap", "noise_floor", "gap_over_floor", "upper"),
)
RESIDUALS = Table(
    "residuals",
    "What is left of a sample, its trial left out of the fit",
    {
        **OUTPUT,
        "trial": column(int, "trial of the dataset", low=0),
        "sample": column(int, "of the trial", low=0),
        "residual": column(float, "measured less simulated", unit="of the channel"),
        "left": column(float, "what a flexible model leaves of it", unit="of the channel"),
    },
    key=(*OUTPUT, "trial", "sample"),
)
GAP = Table(
    "gap",
    "A regime of motion or time, and the gap in it",
    {
        **OUTPUT,
        "regime": column(str, "samples that are looked at, or band of frequencies"),
        "samples": column(int, "in the regime", low=0),
        "share_of_time": column(float, "share of all samples", percent=True, low=0, high=1),
        "gap": column(float, "root mean square of measured less simulated", unit="of the channel", low=0),
        "noise_floor": column(float, "the same, of what a flexible model leaves", unit="of the channel", low=0),
        "largest": column(float, "deviation that one sample in a hundred exceeds", unit="of the channel", low=0),
        "share_of_gap": column(float, "share of the channel's squared gap", percent=True, low=0, high=1),
        "p_value": column(float, "of no gap above the floor, signs of trials flipped", low=0, high=1),
        "p_least": column(float, "least p-value that so many trials can give", low=0, high=1),
        "p_adjusted": column(float, "corrected for all rows (Benjamini, Yekutieli)", low=0, high=1),
    },
    key=(*OUTPUT, "regime"),
)


class PlantOfRecording(View):
    """The plant simulates what is measured, from signals that are."""

    stages: list[str] | None
    measured: Any
    measurement: dict[str, Any]
    columns: dict[str, str | None]
    plant: Machine

    @model_validator(mode="after")
    def _find_signals(self) -> Self:
        if self.measured is not None and self.stages != ["measurement"]:
            signals = [name for name in self.columns if name not in ("record", "part", "time_s")]
            check_plant(self.plant, self.measurement["kind"], signals)
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (PlantOfRecording,)

    discrepancy: DiscrepancySettings
    parts: Parts
    plant: Machine
    seed: int


@stage(TRIAL_PARTS, NOMINAL_FIT, CHANNELS, RESIDUALS, GAP, stream="locate_gap")
def locate_gap(cfg: Config, tables: MeasuredTables, ctx: Context) -> dict[str, pd.DataFrame]:
    """Fit the nominal constants, then locate where measurement and simulation disagree."""
    settings, trials = cfg.discrepancy, tables.measured_trials
    source = tables.measured_session["source"].iloc[0]
    try:
        parts = list_parts(trials, cfg.parts, settings.verification_share)
        dataset = build_dataset(cfg.plant, tables, parts, settings)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from None
    if not dataset.outputs:
        raise InputError(
            f"{source}: expected pressure or force of a muscle that changes, with all that it is simulated from, got "
            "none; see the table measured_notes"
        )
    states = prepare_all(dataset.fitted_outputs, ctx.divide)
    weights = resample(len(dataset.fitted), settings.bootstraps, ctx.generator("resample"))
    gap = pd.DataFrame(locate(states, settings.regimes, ctx.generator("signs")), columns=list(GAP.columns))
    channels = pd.DataFrame([summarise_channel(each, weights, settings) for each in states])
    ctx.figure(
        "gap_bars",
        draw_gap_bars(channels, settings.search.smallest_gap),
        "Gap of every channel over its noise floor after the nominal constants were fitted, with its upper limit.",
    )
    ctx.figure(
        "gap_map",
        draw_gap_map(gap, channels, settings.significance),
        "Where the gap lies: share of the squared gap (%) by regime; regimes overlap. Full dot: trials "
        "confirm it after correction for all looks; ring: without correction.",
    )
    ctx.figure(
        "residual_loops",
        draw_residual_loops(average_loops(states)),
        "Residual of the fitted nominal model by direction of motion, with two standard errors over trials.",
    )
    plane = average_plane(states)
    if len(plane):
        told = "Residual of the fitted nominal model over the state plane."
        ctx.figure("residual_plane", draw_residual_plane(plane), told)
    return {
        TRIAL_PARTS.name: parts,
        NOMINAL_FIT.name: pd.DataFrame([row for each in states for row in list_constants(each, weights, settings)]),
        CHANNELS.name: channels,
        RESIDUALS.name: list_residuals(states, dataset.fitted_trials),
        GAP.name: gap,
    }


def list_constants(state: FittedChannel, weights: Any, settings: DiscrepancySettings) -> list[dict[str, Any]]:
    """Return the rows of an output's constants."""
    found = state.nominal.fit
    low, high = find_interval(found.drawn_values(weights), settings.level)
    return [
        {
            "channel": state.output.channel,
            "muscle": state.output.element,
            "constant": each.name,
            "unit": each.unit,
            "start": each.prior_mean,
            "value": float(value),
            "low": float(low[index]),
            "high": float(high[index]),
            "at_bound": not bool(found.free[index]),
        }
        for index, (each, value) in enumerate(zip(state.output.constants, found.values, strict=True))
    ]


def summarise_channel(state: FittedChannel, weights: Any, settings: DiscrepancySettings) -> dict[str, Any]:
    """Return the row of an output."""
    samples = float(state.samples.sum())
    floor = weights @ np.minimum(state.leftover.raw, state.current.raw)
    drawn = np.sqrt(weights @ state.current.raw / np.maximum(floor, 1e-300))
    return {
        "channel": state.output.channel,
        "muscle": state.output.element,
        "unit": state.output.unit,
        "trials": state.output.trials,
        "samples": int(samples),
        "range": state.output.range,
        "gap": float(np.sqrt(state.nominal.raw.sum() / samples)),
        "noise_floor": state.floor,
        "gap_over_floor": state.ratio(state.nominal.raw),
        "upper": float(np.quantile(drawn, settings.level)),
        **state.noise._asdict(),
        "line_hz": math.nan if state.leftover.line_hz is None else state.leftover.line_hz,
        "family": state.leftover.family,
    }
