"""The gap before, after each addition, and the noise floor, on trials opened once; and the verdict.

In: everything before. Out: `verification` (a row per addition, for simulation from measured upstream signals and for
free-run simulation), `predictions` (each sample as measured, simulated before and simulated after), `findings`,
`remarks` and `next_steps` (the verdict, its limits and what to do, in words) and the document ``verdict.json``.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.discrepancy import report_text
from stages.science.discrepancy.dataset import DatasetTables, build_dataset
from stages.science.discrepancy.parts import PURPOSES
from stages.science.discrepancy.resampling import resample
from stages.science.discrepancy.restoring import SearchTables, read_maps
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.discrepancy.signature import trace_effects
from stages.science.discrepancy.verdict import (
    describe_effects,
    list_confounded,
    list_suspected,
    locate_most,
    reproduce_effects,
    summarise_remainder,
)
from stages.science.discrepancy.verification import DRIVEN, Opened, Verified, find_odd_trials, find_unsettled, verify
from stages.science.figures.verified_gap import MAP, draw_effect_signature, draw_gap_waterfall, draw_verified_trials
from stages.science.output_channels.muscle_channels import QUANTISATION
from stages.science.plant.effect import find_effect
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.machine import Machine
from stages.science.recording.plausibility import suspect_muscles
from stages.science.recording.signal_names import name_signal
from stages.science.statistics.sign_flips import fewest_trials

MOST_RECORDS = 12
"""Records of test trials that are evaluated one by one too."""
VERIFICATION = Table(
    "verification",
    "The gap on trials that were not fitted",
    {
        "part": column(str, "verification, one record of it, or a recorded part that is only reported"),
        "simulation": column(str, "from what it is simulated", among=["measured upstream", "free run"]),
        "step": column(int, "effects added", low=0),
        "label": column(str, "what was added, or the noise floor"),
        "trials": column(int, "in that part", low=1),
        "gap": column(float, "RMSE over range, root mean square over channels and trials", percent=True, low=0),
        "low": column(float, "lower end of the interval over resampled trials", percent=True, low=0, nullable=True),
        "high": column(float, "upper end of it; one trial has none", percent=True, low=0, nullable=True),
        "gap_over_std": column(float, "RMSE over the measured standard deviation", low=0, nullable=True),
        "p_value": column(float, "of no change of the nominal gap, two-sided, signs of trials flipped", low=0, high=1),
        "p_step": column(float, "of no fall since the step before, one-sided, signs of trials flipped", low=0, high=1),
    },
    key=("part", "simulation", "step"),
    brief=("part", "simulation", "label", "gap", "low", "high", "p_step"),
)
PREDICTIONS = Table(
    "predictions",
    "A sample as measured and as simulated",
    {
        "trial": column(int, "trial of the dataset", low=0),
        "part": column(str, "fitted, opened once, or only reported", among=list(PURPOSES)),
        "time_s": column(float, "time from the trial's start", unit="s", low=0),
        "muscle": column(str, "muscle, or name of the machine"),
        "channel": column(str, "measured channel"),
        "measured": column(float, "sensor", unit="of the channel"),
        "before": column(float, "nominal model, fitted", unit="of the channel"),
        "after": column(float, "with what was named", unit="of the channel"),
        "patched": column(float, "with learned maps too, where there are any", unit="of the channel"),
        "low": column(
            float, "lower end of the band about patched in which a sample is expected", unit="of the channel"
        ),
        "high": column(float, "upper end of it", unit="of the channel"),
        "deviation": column(
            float,
            "standard deviation of patched by its constants and effects, apart from noise",
            unit="of the channel",
            low=0,
        ),
    },
    key=("trial", "channel", "muscle", "time_s"),
)
TEST = "verification"
WHERE = ("channel", "muscle", "regime", "share_of_gap", "p_value")
POOLING = (
    "of each channel and muscle in each trial: mean squared error over the squared range of all its measured samples; "
    "the mean of these over channels and muscles with data, then over trials; its root"
)
MOST_SHOWN = 4
"""Muscles whose trials are drawn."""
FINDINGS = sentences("findings", "finding")
REMARKS = sentences("remarks", "remark")
NEXT_STEPS = sentences("next_steps", "advice")


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    plant: Machine
    exoskeleton: Exoskeleton
    seed: int


@stage(VERIFICATION, PREDICTIONS, FINDINGS, REMARKS, NEXT_STEPS, stream="verify_gap")
def verify_gap(
    cfg: Config,
    tables: DatasetTables,
    found: SearchTables,
    gap: pd.DataFrame,
    ranking: pd.DataFrame,
    amended_values: pd.DataFrame,
    remainder: pd.DataFrame,
    learned_maps: pd.DataFrame,
    own_effect: pd.DataFrame,
    ctx: Context,
) -> dict[str, pd.DataFrame]:
    """Open the test trials, once, and report what was found."""
    settings, channels, named = cfg.discrepancy, found.channels, found.named_effects
    status, last = found.status, found.last_step
    dataset = build_dataset(cfg.plant, tables, tables.trial_parts, settings)
    test = dataset.test
    learned = read_maps(learned_maps)
    weights = resample(len(dataset.fitted), settings.bootstraps, ctx.generator("resample", "bands"))
    verified = verify(dataset.outputs, dataset.fitted, found, learned, weights, ctx.divide)
    opened = Opened(verified, settings, ctx.generator)
    bands = opened.find_coverage(test)
    concerned = list(dict.fromkeys(named["channel"])) or list(dict.fromkeys(channels["channel"]))
    judged = [each for each in verified if each.output.channel in concerned]
    labels = ["nominal", *(f"+ {name}" for name in named.drop_duplicates("order")["name"])]
    labels += [MAP] if learned else []
    rows = [
        row
        for part, chosen in list_reported(tables, judged).items()
        for row in Opened(judged, settings, ctx.generator).compare_steps(labels, part, chosen)
    ]
    verification = pd.DataFrame(rows, columns=list(VERIFICATION.columns))
    driven = verification[(verification["simulation"] == DRIVEN) & (verification["part"] == TEST)]
    over_floor = opened.bound_ratio(last, TEST, test)
    taken = [each.take(test) for each in dataset.outputs]
    counted = {(QUANTISATION, each.channel, each.element) for each in taken if each.find_counts({}) is not None}
    places = locate_most(gap, channels, named, settings)
    maps = opened.measure_maps(learned, last, test)
    first = min((number for number in named["round"] if number > 0), default=1)
    candidates = ranking.loc[ranking["round"] == first, ["name", "probability", "heldout_gap", "absorbed"]]
    verdict: dict[str, Any] = {
        "status": status,
        "missing_probability": float(found.decision["missing"].iloc[0]),
        "effects": describe_effects(reproduce_effects(named, driven, counted, settings), amended_values),
        "suspected": list_suspected(found.suspected_effects),
        "ranking": candidates.to_dict("records"),
        "absorbed": list_confounded(ranking),
        "where": [{name: row[name] for name in WHERE} for row in places],
        "remainder": summarise_remainder(found.unexplained, remainder, maps, settings.search.certain),
        "gap": {
            **summarise_gap(driven, last, judged),
            "over_floor": {**over_floor, "smallest": settings.search.smallest_gap},
        },
        "bands": bands,
        "verification_trials": [dataset.trials[place] for place in test],
    }
    report, predictions = settings.report, opened.list_predictions(dataset, last)
    comparable = predictions[predictions["part"] != "other"]
    unsettled = find_unsettled(comparable, report.odd_trial, settings.muscle_channels.least_drive_kpa)
    odd = find_odd_trials(comparable, report.odd_trial)
    odd = odd[(odd["channel"] != "pressure_kpa") | ~odd["trial"].isin(list(unsettled))]
    if status == "no_discrepancy" and (len(odd) or over_floor["low"] > settings.search.smallest_gap):
        verdict["status"] = status = "unexplained"  # what no fitted trial shows, nothing told from noise
        verdict["missing_probability"] = settings.search.certain
    ctx.verdict(verdict)
    names = name_trials(tables.measured_trials)
    spoken = " and ".join(name_signal(each)[0] for each in concerned)
    ctx.figure(
        "gap_waterfall",
        draw_gap_waterfall(verification[verification["part"] == TEST]),
        f"Gap on verification trials, step by step, over {spoken}, with {settings.level:.0%} intervals over trials.",
    )
    own = channels[channels["channel"].isin(concerned)]
    draw_trials(predictions, own, names, ctx)
    if status == "named":
        draw_signatures(trace_effects(dataset, found), verdict["effects"], ctx)
    judgeable = set(zip(channels["channel"], channels["muscle"], strict=True))
    floor = verdict["gap"]["noise_floor"] if last else math.inf
    high = report_text.describe_high_floor(channels, report.high_floor, floor)
    findings = [
        *suspect_muscles(tables.measured, tables.measured_muscles),
        *report_text.describe_uninformative(float(driven["gap_over_std"].iloc[last])),
        *report_text.describe_verdict(verdict, places, settings),
        *report_text.describe_maps(maps, settings.significance),
        *report_text.describe_odd_trials(odd.assign(trial=odd["trial"].map(names)).to_dict("records")),
        *(high if status == "no_discrepancy" else []),
        *report_text.describe_remainder(remainder, status, report),
        *report_text.describe_few_trials(len(dataset.fitted), len(test), fewest_trials(settings.significance)),
    ]
    remarks = [
        *report_text.describe_absorbed(list_confounded(ranking, {row["channel"] for row in places})),
        *report_text.describe_together(ranking, named),
        *report_text.describe_times(verdict["effects"], dataset.plant),
        *(report_text.describe_scales(dataset.plant) if status != "no_discrepancy" else []),
        *report_text.describe_loaded_maps(dataset),
        report_text.describe_bands(bands),
        *report_text.describe_silent_channels(judgeable, list(tables.measured_muscles["muscle"])),
        *report_text.describe_unsettled(unsettled, comparable["trial"].nunique()),
        *report_text.describe_bounds(amended_values),
        *report_text.describe_blocks(list(tables.measured_trials["record"])),
        *report_text.describe_rate(dataset.outputs[0]),
        *(high if status != "no_discrepancy" else []),
        *report_text.describe_fallen_floor(own, floor, settings.search.clear_ratio),
        *report_text.describe_forgotten(dataset.outputs[0], dataset.plant, report.most_forgotten),
    ]
    simulated_at, written = cfg.exoskeleton.load_cell_site, settings.write_effect is not None
    command = describe_command(status == "named", bool(maps), tables.measured_session.iloc[0], simulated_at, written)
    return {
        VERIFICATION.name: verification,
        PREDICTIONS.name: predictions[list(PREDICTIONS.columns)],
        FINDINGS.name: pd.DataFrame({"sentence": findings}),
        REMARKS.name: pd.DataFrame({"sentence": remarks}),
        NEXT_STEPS.name: pd.DataFrame({"sentence": [command, *report_text.describe_own_effect(own_effect)]}),
    }


def list_reported(tables: DatasetTables, judged: Sequence[Verified]) -> dict[str, list[int]]:
    """Return the positions of trials that are evaluated together.

    They are the test trials, those of each record where they are blocks of a few records, whose levels may differ, and
    each part that is only reported.
    """
    trials, purposes = tables.measured_trials, tables.trial_parts["part"].to_numpy()
    seen = sum(each.output.present.sum(axis=0) for each in judged)
    reported = {TEST: np.flatnonzero(purposes == TEST).tolist()}
    records = trials["record"].where((purposes == TEST) & (seen > 0) & trials["record"].ne(""))
    if 1 < records.nunique() <= MOST_RECORDS:
        each_one = records.groupby(records, sort=False).indices.items()
        reported |= {f"{TEST}, record {name}": list(rows) for name, rows in each_one}
    aside = trials["part"].where((purposes == "other") & (seen > 0))
    return reported | {str(part): list(rows) for part, rows in aside.groupby(aside).indices.items()}


def name_trials(trials: pd.DataFrame) -> dict[int, str]:
    """Return what each trial is called: its number in the dataset, and its record where there are several."""
    several = len(set(trials["record"])) > 1
    rows = zip(trials["trial"], trials["record"], strict=True)
    return {int(trial): f"{trial} (record {record})" if several else str(trial) for trial, record in rows}


def summarise_gap(driven: pd.DataFrame, last: int, judged: Sequence[Verified]) -> dict[str, Any]:
    """Return the verdict's gap: before, after the additions that were accepted, and the floor."""
    before, after, floor = driven.iloc[0], driven.iloc[last], driven.iloc[-1]
    return {
        "before": float(before["gap"]),
        "after": float(after["gap"]),
        "noise_floor": float(floor["gap"]),
        "unit": "RMSE / range, verification trials",
        "p_value": float(after["p_value"]),
        **{name: float(after["gap"] if np.isnan(after[name]) else after[name]) for name in ("low", "high")},
        "channels": list(dict.fromkeys(each.output.channel for each in judged)),
        "muscles": sorted({each.output.element for each in judged}),
        "pooling": POOLING,
    }


def describe_command(named: bool, mapped: bool, session: pd.Series, simulated_at: str, written: bool) -> str:
    """Return how to simulate with the plant as amended by names, by learned maps, or by fitted constants alone.

    An effect that was `written` is not written again.
    """
    learned = "fitted constants and learned maps" if mapped else "constants as fitted here"
    which = "amended plant" if named else f"plant with {learned}"
    told = f"Simulate with the {which}: "
    if session["kind"] == "records":
        once = " discrepancy.write_effect=null" if written else ""
        return f"{told}python -m pipeline ARGUMENTS plant=FOLDER/documents/amended.yaml{once}"
    site = str(session["load_cell_site"])
    elsewhere = "" if site in ("unknown", simulated_at) else f" exoskeleton.load_cell_site={site}"
    return f"{told}python -m pipeline plant=FOLDER/documents/amended.yaml{elsewhere}"


def draw_trials(predictions: pd.DataFrame, channels: pd.DataFrame, names: Mapping[int, str], ctx: Context) -> None:
    """Draw some test trials, by what they are called, of the channel whose gap is largest."""
    rows = channels.sort_values("gap_over_floor", ascending=False)
    channel = str(rows["channel"].iloc[0])
    muscles = rows.loc[rows["channel"] == channel, "muscle"].head(MOST_SHOWN).tolist()
    test = predictions[(predictions["part"] == TEST) & (predictions["channel"] == channel)]
    trials = sorted(test["trial"].unique())
    if trials:
        chosen = sorted({trials[0], trials[len(trials) // 2], trials[-1]})
        ctx.figure(
            "verified_trials",
            draw_verified_trials(test, channel, muscles, {each: names[each] for each in chosen}),
            "Verification trials: measured, simulated, with what was named and with learned maps where there are any, "
            "and below them what is left, with the band in which a measurement is expected.",
        )


def draw_signatures(traced: pd.DataFrame, effects: Sequence[Mapping[str, Any]], ctx: Context) -> None:
    """Draw what each added effect does, over the residual without it, and tell its sizes."""
    told = {each["name"]: report_text.describe_sizes(each) for each in effects}
    for name, rows in traced.groupby("effect", sort=False):
        known = find_effect(str(name), str(rows["form"].mode().iloc[0]))
        ctx.figure(
            f"signature_{name}",
            draw_effect_signature(rows, known.signature),
            f"{told[str(name)]} Lines: what it adds; points: the residual of the amended model without it on "
            "verification trials, with two standard errors.",
        )
