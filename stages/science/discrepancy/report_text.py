"""The verdict in an engineer's words."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import Dataset
from stages.science.discrepancy.evidence import MEMORY, STATIC_MAP
from stages.science.discrepancy.proposal import Proposed
from stages.science.discrepancy.settings import DiscrepancySettings, ReportSettings
from stages.science.output_channels.features import share_outside
from stages.science.output_channels.flexible import SESSION_CHANGE
from stages.science.output_channels.muscle_channels import QUANTISATION
from stages.science.output_channels.output_channel import OutputChannel
from stages.science.plant.effect import FROM_START, Parameter, find_effect
from stages.science.plant.element_plant import ElementPlant
from stages.science.plant.plant import Plant
from stages.science.plant.record_plant import RecordPlant
from stages.science.recording.blocks import MANY
from stages.science.recording.signal_names import name_signal

FAMILIES = {
    SESSION_CHANGE: "a drift of the model's values along the session",
    MEMORY: "a memory of the inputs (such as a resonance, lag or delay, of machine or sensor, that the plant lacks)",
    STATIC_MAP: "a static map of the measured signals (as a law has that is not quite the nominal one)",
}
NAMELESS = {
    "none": "nothing",
    "unknown": "something without a name",
    MEMORY: "a memory without a name",
    STATIC_MAP: "a static map without a name",
}
MOST_LISTED, LEAST_SUSPECTED = 4, 0.05
"""Names that a list tells, and the probability below which a suspected effect is left to the tables."""
TIMES = {"paces": 1.0, "paces_late": 1.0, FROM_START: 1.0, "periods": 2.0 * math.pi}
"""Parameters that tell a time, and their unit in paces."""


def describe_verdict(
    verdict: Mapping[str, Any], places: Sequence[Mapping[str, Any]], settings: DiscrepancySettings
) -> list[str]:
    """Return the verdict, as kept in verdict.json, as sentences.

    `places` are rows of the table `gap` that tell where, the largest gap first.
    """
    if verdict["status"] == "no_discrepancy":
        gap = verdict["gap"]
        return [
            "As far as these signals tell, nothing that matters is missing, with probability "
            f"{say_sure(1.0 - verdict['missing_probability'])}: on "
            f"{_count(verdict)} the gap is {_percent(gap['before'])} of range; "
            f"{_compare_with_floor(gap['before'], gap['noise_floor'])}; in its worst channel it is at most "
            f"{gap['over_floor']['high']:.2f} times the floor ("
            f"{_percent(settings.level)} one-sided limit over trials).",
            *_describe_suspected(verdict),
        ]
    by_channel: dict[str, list[Mapping[str, Any]]] = {}
    for each in places:
        by_channel.setdefault(each["channel"], []).append(each)
    where = [_describe_channel(rows, settings.report.concentrated) for rows in by_channel.values()]
    tell = _describe_named if verdict["status"] == "named" else _describe_unexplained
    return [*tell(verdict, settings), *where]


def describe_absorbed(names: Sequence[str]) -> list[str]:
    """Return which effects could act where the gap is but cannot be told from the fitted constants, if any."""
    told = _shorten([_spell(each) for each in names])
    return [f"Not judged, as in these data the fitted constants absorb what it does: {told}."] if names else []


def _compare_with_floor(gap: float, floor: float, first: float = 0.0) -> str:
    """Return how large a gap is beside the noise floor, or that it is not resolved; `first` is what it was before."""
    if gap < floor <= first:
        return f"what is left is not above the noise floor ({_percent(floor)})"
    if gap < floor:
        return f"that is not above the noise floor ({_percent(floor)}): no gap is resolved"
    return f"that is {gap / floor:.2f} times the noise floor ({_percent(floor)})"


def _describe_suspected(verdict: Mapping[str, Any]) -> list[str]:
    return [
        f"Suspected, and not added to the plant: {_spell(each['name'])} on {_join(each['muscles'])} "
        f"(probability {say_sure(each['probability'])}; p = {each['p_value']:.2g} that trials left out of the fit gain "
        "nothing by it)."
        for each in verdict["suspected"]
        if each["probability"] >= LEAST_SUSPECTED
    ]


def _describe_named(verdict: Mapping[str, Any], settings: DiscrepancySettings) -> list[str]:
    gap, effects, left = verdict["gap"], verdict["effects"], verdict["remainder"]
    family = FAMILIES.get(left["family"], "a flexible model")
    told = [_describe_effect(each, verdict) for each in effects]
    channels = [each["channel"] for each in effects]
    likely = any(each["probability"] >= settings.search.certain for each in verdict["suspected"])
    beyond = "what is suspected below" if likely else "something that the library does not hold"
    below = gap["after"] < gap["noise_floor"]
    if len(effects) > 1 and max(channels.count(each) for each in channels) >= settings.search.most_effects:
        doubt = "So many names in one channel may stand in for one effect that the library does not hold."
    else:
        doubt = "The noise floor is so far above the sensor's noise that it may hide what is there"
        if left["share"] > settings.report.least_share:
            share = f"{_percent(left['share'])} of the gap above the noise"
            doubt = f"On trials left out of the fits {share} is left, more than forms of one effect usually differ by"
        doubt += f": the name may stand in for {beyond}."
    where = "On trials left out of the fits something" if below else "So much"
    more = f"would still take away {_percent(left['share'])} of what was above the noise"
    if left["share"] < settings.report.least_share:
        least = _percent(settings.report.least_share)
        where, more = "Something", f"predicts trials left out better, by less than {least} of what was above the noise"
    nameless = "it may be what is suspected below" if likely else "that has no name in the library"
    hum = f"; beside it {_describe_line(left['line_hz'])}" if left["line_hz"] is not None else ""
    remains = f"{where} remains: {family} {more}; {nameless}{hum}."
    them = "it" if len(effects) == 1 else "them"
    doubt_of_gap = "one trial gives neither interval nor p-value"
    if len(verdict["verification_trials"]) > 1:
        ends = f"{_percent(settings.level)} interval {_percent(gap['low'])} to {_percent(gap['high'])}"
        doubt_of_gap = f"{ends}, two-sided p = {gap['p_value']:.2g}"
    unseen, signals = _count(verdict), _join([name_signal(each)[0] for each in gap["channels"]])
    before, after = _percent(gap["before"]), _percent(gap["after"])
    closing = f"With {them} the gap of {signals} on {unseen} goes from {before} to {after} of range ({doubt_of_gap})"
    if all(each["name"] == QUANTISATION for each in effects):
        closing = f"On {unseen} the gap of {signals} is {before} of range, with {them} as without"
    return [
        *told,
        *([doubt] if left["imitated"] > settings.search.certain else []),
        f"{closing}; {_compare_with_floor(gap['after'], gap['noise_floor'], gap['before'])}.",
        *([remains] if left["status"] == "unexplained" else []),
        *_describe_suspected(verdict),
    ]


def _describe_line(line_hz: float) -> str:
    return f"an oscillation at {line_hz:.3g} Hz runs through all trials, which the simulation lacks"


def _describe_unexplained(verdict: Mapping[str, Any], settings: DiscrepancySettings) -> list[str]:
    gap, over_floor = verdict["gap"], verdict["gap"]["over_floor"]
    on_test = (
        f"On {_count(verdict)} the gap is {_percent(gap['before'])} of range; "
        f"{_compare_with_floor(gap['before'], gap['noise_floor'])}."
    )
    left, share = verdict["remainder"], verdict["remainder"]["share"]
    if left["status"] == "none" and verdict["missing_probability"] <= settings.search.certain:
        return [
            f"Whether something is missing cannot be told: the gap is {over_floor['value']:.2f} times the noise floor, "
            "but so much counts as noise, or shows in few trials alone, that it may hide what is there. Nothing is "
            "named, and the plant is not changed but for its fitted constants.",
            on_test,
        ]
    alone = next(each["heldout_gap"] for each in verdict["ranking"] if each["name"] == "none")
    least = settings.report.nearest_gap * alone
    suspected = {each["name"]: each["probability"] for each in verdict["suspected"]}
    suspected = {name: each for name, each in suspected.items() if each >= LEAST_SUSPECTED}
    likely = {name for name, each in suspected.items() if each >= settings.search.certain}
    helping = [each for each in verdict["ranking"] if _is_candidate(each) and each["heldout_gap"] < least]
    helping = [each for each in helping if each["name"] in likely] or helping
    nearest, near = min(helping, key=lambda each: each["heldout_gap"], default=None), ""
    if nearest and _percent(nearest["heldout_gap"]) != _percent(alone):
        doubt = f"probability {say_sure(nearest['probability'])}" if nearest["name"] not in suspected else "see below"
        near = (
            f" Of the names, {_spell(nearest['name'])} comes nearest ({doubt}): "
            f"with it the gap of trials left out of the fit goes from {_percent(alone)} to "
            f"{_percent(nearest['heldout_gap'])} of range."
        )
    unchanged = "" if left["learned_maps"] else ", and the plant is not changed but for its fitted constants"
    line_hz, mapped = left["line_hz"], left["family"] == STATIC_MAP
    family = FAMILIES.get(left["family"], "a flexible model")
    hum = _describe_line(line_hz or 0.0)
    if line_hz is not None and not mapped:
        reproducible = hum
    elif left["family"] is None and share < settings.report.least_share:
        reproducible = "no measured signal tells what it depends on"
    else:
        takes = f"takes away {_percent(share)} of what is above the noise"
        if share < settings.report.least_share:
            takes = f"predicts trials left out better, by less than {_percent(settings.report.least_share)} of the gap"
        elif over_floor["value"] <= over_floor["smallest"]:
            takes = "predicts trials left out better"
        reproducible = f"{family} {takes}"
        reproducible += f"; beside it {hum}" if line_hz is not None else ""
    lacks = "that no effect of the library explains better than what has no name"
    if left["status"] == "unexplained" or line_hz is not None:
        lacks += f": {reproducible}"
    if likely:
        lacks = "for which trials left out of the fit confirm no effect"
    return [
        f"Something is missing (probability {say_sure(verdict['missing_probability'])}) {lacks}.{near} "
        f"Nothing is named{unchanged}.",
        on_test,
        *_describe_suspected(verdict),
    ]


def _describe_channel(rows: Sequence[Mapping[str, Any]], concentrated: float) -> str:
    first, muscles = rows[0], sorted(each["muscle"] for each in rows)
    channel = name_signal(first["channel"])[0]
    worst = max(rows, key=lambda each: each["largest"])
    largest, where = float(f"{worst['largest']:.2g}"), f" on {worst['muscle']}" if len(rows) > 1 else ""
    text = f"{_join(muscles)}: nominal {channel} is off by up to {largest:g} {first['unit']}{where}"
    if first["share_of_gap"] < concentrated * first["share_of_time"]:
        return f"{text}, in no regime of motion more than in others."
    whose = f"{first['muscle']}: " if len(rows) > 1 else ""
    share, regime = float(first["share_of_gap"]), str(first["regime"])
    motion = regime.endswith(("shortening", "lengthening", "rising", "falling"))
    where_to = "" if regime.startswith(("early", "late")) else "while " if motion else "at "
    return (
        f"{text}, most of all {where_to}{regime} ({whose}{_percent(share)} of the squared gap "
        f"in {_percent(first['share_of_time'])} of the time)."
    )


def describe_silent_channels(judged: Collection[tuple[str, str]], muscles: Sequence[str]) -> list[str]:
    """Return which channels of the measured muscles were not `judged`, as their data are missing or never change."""
    names = {"pressure_kpa": "pressure", "force_n": "force"}
    silent = {channel: [each for each in muscles if (channel, each) not in judged] for channel in names}
    told = [f"{names[channel]} of {_join(silent[channel])}" for channel in names if silent[channel]]
    return [f"Not judged, as data are missing, too few, or never change: {'; '.join(told)}."] if told else []


def describe_odd_trials(odd: Sequence[Mapping[Any, Any]]) -> list[str]:
    """Return which trials do not fit to the others, by rows ``trial channel muscle ratio``, the worst first.

    A trial is told as it is called.
    """
    if not odd:
        return []
    trials = list(dict.fromkeys(row["trial"] for row in odd))
    what = f"{odd[0]['muscle']}, {name_signal(odd[0]['channel'])[0]}"
    more = f" and {len(trials) - MOST_LISTED} more" if len(trials) > MOST_LISTED else ""
    which = f"trial{'s' if len(trials) > 1 else ''} {', '.join(trials[:MOST_LISTED])}{more}"
    return [
        f"Look at {which}: the error there is up to {odd[0]['ratio']:.0f} times "
        f"that of other trials ({what}). If something came loose, run again without it; if more acts there than in the "
        "others, such as a stop that they do not reach, let some like it be fitted."
    ]


def describe_unsettled(off_kpa: Mapping[int, float], trials: int) -> list[str]:
    """Return that trials begin under a pressure that their first command does not hold, by `find_unsettled`."""
    if not off_kpa:
        return []
    begin = "begins" if len(off_kpa) == 1 else "begin"
    return [
        f"Of {trials} trials {len(off_kpa)} {begin} up to {max(off_kpa.values()):.0f} kPa off the pressure that the "
        "first command holds, and each is simulated from there: what is off early in a trial may be that alone. Record "
        "trials that begin at rest, or cut them where the command has been held."
    ]


def describe_bounds(values: pd.DataFrame) -> list[str]:
    """Return which of the `amended_values` stand at a bound, so that what lies beyond was not tried, if any do."""
    stuck, named = values[values["at_bound"] != ""], []
    for (effect, name), rows in stuck.groupby(["effect", "parameter"], sort=False):
        owner = f" of {_spell(str(effect))}" if effect else ""
        sizes = _join([f"{each:.3g}" for each in dict.fromkeys(rows["value"])][:MOST_LISTED])
        named.append(f"{name}{owner} ({sizes}, {_join(list(dict.fromkeys(rows['at_bound'])))})")
    verb = "stands" if len(named) == 1 else "stand"
    return [f"At a bound, beyond which nothing was tried, {verb} {_join(named)}."] if named else []


def describe_scales(plant: Plant | RecordPlant) -> list[str]:
    """Return the scales and the pace in which effects on a machine of records tell their sizes; none for muscles."""
    if not isinstance(plant, RecordPlant):
        return []
    scales = [(*name_signal(plant.output), plant.output_scale)]
    scales += [(*name_signal(plant.along), plant.along_scale)] if isinstance(plant, ElementPlant) else []
    told = [f"a scale of {words} is {scale:.3g} {unit}".strip() for words, unit, scale in scales if scale is not None]
    told += [f"a pace is {plant.time_scale_s:.3g} s"] if plant.time_scale_s is not None else []
    return [f"Where sizes are told in them, {_join(told)}."] if told else []


def describe_times(effects: Sequence[Mapping[str, Any]], plant: Plant | RecordPlant) -> list[str]:
    """Return in seconds what effects on a machine of records tell in paces."""
    if not isinstance(plant, RecordPlant) or plant.time_scale_s is None:
        return []
    told = [
        f"{_spell(each['name'])}: {size.description.partition(',')[0]}, "
        f"{each['parameters'][size.name]['value'] * TIMES[size.name] * plant.time_scale_s:.3g} s"
        for each in effects
        for size in find_effect(each["name"], each["form"]).parameters
        if size.name in TIMES and size.name in each["parameters"]
    ]
    return [f"In seconds, {'; '.join(told)}."] if told else []


def describe_rate(output: OutputChannel) -> list[str]:
    """Return at which rate recordings are judged, if it is less than that at which they were made."""
    if output.averaged == 1:
        return []
    judged_hz = 1.0 / output.step_s
    return [
        f"Judged at {judged_hz:.4g} Hz, as means of what was recorded at {judged_hz * output.averaged:.4g} Hz: more "
        "samples tell nothing more of so slow a motion."
    ]


def describe_blocks(records: Sequence[str]) -> list[str]:
    """Return that trials are blocks of few records, if some are; `records` are those of the trials, empty for none."""
    counts = Counter(name for name in records if name)
    blocks = sum(each for each in counts.values() if each > 1)
    if not blocks:
        return []
    which = "one record, which share" if len(counts) == 1 else f"{len(counts)} records, which share within each"
    return [
        f"Trials are here {blocks} blocks of {which} a zero and a gain: intervals and p-values tell of other blocks, "
        f"not of another record. Of {MANY} records or more each is a trial."
    ]


def describe_forgotten(output: OutputChannel, plant: Plant | RecordPlant, most: float) -> list[str]:
    """Return how many measured samples are not judged for want of an input, if it is more than a share of them."""
    lost, judged = output.forgotten, int(output.present.sum())
    if not isinstance(plant, RecordPlant) or lost <= most * (lost + judged):
        return []
    return [
        f"Of {lost + judged} samples of {output.channel}, {lost} are not judged: after a value of "
        f"{' or '.join(plant.inputs)} is missing, none counts until the machine has forgotten it."
    ]


def describe_uninformative(left: float) -> list[str]:
    """Return that a simulation tells nothing, if it errs by more than a standard deviation of what was measured."""
    text = (
        f"The simulation tells nothing of what was measured: not fitted, it errs by {left:.2g} of its standard "
        "deviation. Before anything else, look whether columns, units and signs are right, and the plant."
    )
    return [text] if left > 1.0 else []


def describe_few_trials(fitted: int, test: int, least: int) -> list[str]:
    """Return that fewer than the least number of fitted trials say little, if they are."""
    text = (
        f"This rests on {fitted} fitted trials and {test} opened at the end: intervals and probabilities say less "
        f"than they seem to; record so many that there are {least} of each."
    )
    return [text] if fitted < least else []


def describe_high_floor(channels: pd.DataFrame, high: float, final: float = math.inf) -> list[str]:
    """Return where what is called noise is more than `high` times the sensor's own, from sample to sample.

    Channels have columns ``channel muscle noise_floor white range``. The floor after all that was named, over the
    range, is `final`; where it is less, the first one held what was missing.
    """
    floor = channels["noise_floor"]
    if math.isfinite(final):
        floor = floor.clip(upper=final * channels["range"])
    rows = channels[floor > high * channels["white"]]
    if rows.empty:
        return []
    where = [f"{name_signal(str(row['channel']))[0]} of {row['muscle']}" for row in rows.to_dict("records")]
    return [
        f"The noise floor is more than {high:g} times the sensor's noise from sample to sample "
        f"({_shorten(where)}): something wanders, or acts that no measured signal tells; trials repeated alike would "
        "tell which."
    ]


def describe_fallen_floor(channels: pd.DataFrame, final: float, clear_ratio: float) -> list[str]:
    """Return that the noise floor over the range is `final` after all that was named, where it fell by a clear ratio.

    Channels have columns ``noise_floor range``, before.
    """
    first = float(np.sqrt(np.mean((channels["noise_floor"] / channels["range"]) ** 2)))
    text = (
        "Before anything was named, flexible models took most of it for noise: the floor in the figure gap_bars is "
        f"{_percent(first)} of range, and {_percent(final)} beside what was named."
    )
    return [text] if first > clear_ratio * final else []


def describe_together(ranking: pd.DataFrame, named: pd.DataFrame) -> list[str]:
    """Return which effects leave more than a memory does until the next of `named` is beside them.

    The ranking has columns ``round name heldout_gap``, the named ``round name``.
    """
    left = ranking.set_index(["round", "name"])["heldout_gap"]
    names = dict(zip(named["round"], named["name"], strict=True))
    pairs = [(number, names[number], names[number + 1]) for number in sorted(names) if number + 1 in names]
    return [
        f"Alone, {_spell(name)} leaves {_percent(left[number, name])} of range in trials left out of the fit, and a "
        f"memory of the inputs less ({_percent(left[number, MEMORY])}); with {_spell(other)} it leaves "
        f"{_percent(left[number + 1, other])}."
        for number, name, other in pairs
        if left[number, name] > left.get((number, MEMORY), math.inf)
    ]


def describe_remainder(remainder: pd.DataFrame, status: str, settings: ReportSettings) -> list[str]:
    """Return what the unexplained depends on, by the table `remainder`; a hint, marked as one."""
    if status == "no_discrepancy":
        return []
    if remainder.empty and status == "unexplained":
        return [
            "What the gap depends on is not told: on the fitted trials it is hardly above what flexible models leave."
        ]
    sentences = []
    for channel, rows in remainder.groupby("channel", sort=False):
        name = name_signal(str(channel))[0]
        known = rows[rows["inputs"] != ""].sort_values("share", ascending=False).to_dict("records")
        if known:
            sentences.append(_describe_dependence(name, known, settings.concentrated))
        sentences += [_describe_formula(name, row) for row in known if row["hint"]][:1]
        drifting = rows[rows["drift"] != ""]
        sentences += [_describe_drift(name, row) for row in drifting.to_dict("records")]
        silent = rows.loc[(rows["inputs"] == "") & (rows["drift"] == ""), "muscle"].to_list()
        if silent:
            sentences.append(
                f"What stays unexplained in {name} of {_join(silent)} is not told to depend on anything: no "
                "Gaussian process of a few measured signals predicts it in trials left out."
            )
    return sentences


def describe_maps(maps: Sequence[Mapping[str, Any]], significance: float) -> list[str]:
    """Return what learned maps do on the test trials, by `measure_maps`; they are no names."""
    sentences = []
    for each in maps:
        falls = f"from {_percent(each['before'])} to {_percent(each['after'])} of range (p = {each['p_value']:.2g})"
        by = "a learned map" if len(each["muscles"]) == 1 else "a learned map each"
        inputs = _join([name_signal(name)[0] for name in each["inputs"]])
        sentences.append(
            f"What has no name in {name_signal(each['channel'])[0]} of {_join(each['muscles'])} is mended by {by}, of "
            f"{inputs}: on trials not fitted the gap there goes {falls}."
        )
        if each["after"] >= each["before"]:
            sentences[-1] += " It does not help there: leave it out with discrepancy.patch=none."
        elif each["p_value"] > max(significance, each["least_p"]):
            sentences[-1] += " That may be chance."
        elif each["p_value"] > significance:
            sentences[-1] += " So few trials can give no less a p-value."
    if maps:
        sentences.append(
            "A learned map tells no cause. It is in the amended plant, under learned, and fades to zero away from what "
            "was recorded."
        )
    return sentences


def describe_own_effect(own: pd.DataFrame) -> list[str]:
    """Return what became of an effect that was to be written, by the table `own_effect`, and what to type next."""
    return [
        f"The formula {row['told']} is an effect now: type cp 'FOLDER/{row['file']}' stages/science/effects/ and the "
        f"next run, without discrepancy.write_effect, ranks {row['name']}."
        if row["file"]
        else f"No effect {row['name']} was written: {row['told']}."
        for row in own.to_dict("records")
    ]


def describe_loaded_maps(dataset: Dataset) -> list[str]:
    """Return that the configured plant has learned maps already, and how much of the time each is of no use."""
    if not isinstance(dataset.plant, RecordPlant):
        return []
    output = dataset.outputs[0].told_by(dataset.plant.starts)
    return [
        f"The nominal plant has a learned map of {_join([name_signal(told.name)[0] for told in each.inputs])} from "
        f"before (plant.learned): {_percent(share_outside(each, output))} of the samples are beyond where it was "
        "learnt, and it fades to zero there. plant.learned=[] takes it out."
        for each in dataset.plant.learned
    ]


def describe_bands(bands: Mapping[str, Any]) -> str:
    """Return what share of the test trials' samples bands about the amended simulation hold."""
    text = (
        f"The {_percent(bands['level'])} bands about the amended simulation, in the table predictions, hold "
        f"{100 * bands['coverage']:.3g} % of the samples of these trials"
    )
    if bands["low"] is None:
        return f"{text}; one trial gives no interval."
    text = f"{text} ({100 * bands['low']:.3g} % to {100 * bands['high']:.3g} %)"
    if bands["high"] < bands["level"]:
        return f"{text}: they are too narrow, as these trials differ more than those fitted."
    return f"{text}: they are wider than need be." if bands["low"] > bands["level"] else f"{text}."


def say_sure(probability: float) -> str:
    """Return a probability as far as it can be told."""
    return "above 0.99" if probability > 0.995 else "below 0.01" if probability < 0.005 else f"{probability:.2f}"


def join_names(names: Sequence[str]) -> str:
    """Return names of effects, ``none`` among them perhaps, as they stand in a sentence."""
    return _join([_spell(each) if each != "none" else "no further effect" for each in names])


def describe_proposal(rivals: Mapping[str, float], weighed: Proposed | None, least_gain: float) -> str:
    """Return which trial to record next, or why none is proposed; rivals have their present probabilities."""
    if len(rivals) < 2:
        return "No further trial is proposed: there are no two likely names to tell apart."
    told = join_names(list(rivals))
    if weighed is None:
        return (
            f"No further trial is proposed: nothing that could be prescribed, no faster than in what was recorded, "
            f"drives the machine to tell {told} apart."
        )
    best = weighed.order[0]
    now, then = say_sure(weighed.expected_now), say_sure(float(weighed.probability[best]))
    if weighed.gain < least_gain:
        return (
            f"No further trial is proposed: the best of these kinds ({weighed.spell(best)}) is expected to raise the "
            f"probability of the true one of {told} from {now} to {then} only."
        )
    evidence = f"expected evidence {weighed.mean_evidence[best]:.3g} nats"
    return (
        f"To tell {told} apart, record next: {weighed.spell(best)}. The true one of these has probability {now} now, "
        f"and on average {then} after it ({evidence}), if each is right but for its constants."
    )


def _describe_dependence(name: str, rows: Sequence[Mapping[Any, Any]], concentrated: float) -> str:
    first, inputs = rows[0], _name_inputs(rows[0])
    unit = name_signal(str(first["inputs"]).split(", ")[0])[1]
    above = first["above_floor"]
    text = (
        f"What stays unexplained in {name} of {first['muscle']} depends on {_join(inputs)}: a Gaussian process takes "
        f"away {_percent(first['share'])} of its variance on trials left out ({_percent(first['low'])} to "
        f"{_percent(first['high'])}{f'; {_percent(above)} is above the noise floor' if above > first['share'] else ''})"
    )
    if first["range_part"] > concentrated * first["range_time"]:
        text += (
            f", {_percent(first['range_part'])} of that at {inputs[0]} {first['range_low']:.3g} to "
            f"{first['range_high']:.3g}{f' {unit}' if unit else ''}, in {_percent(first['range_time'])} of the time"
        )
    others = [f"{row['muscle']} on {_join(_name_inputs(row))} ({_percent(row['share'])})" for row in rows[1:]]
    return f"{text}. Likewise {_shorten(others)}." if others else f"{text}."


def _describe_drift(name: str, row: Mapping[Any, Any]) -> str:
    unit = f" {row['drift_unit']}" if row["drift_unit"] not in ("", "1") else ""
    return (
        f"What stays unexplained in {name} of {row['muscle']} is mostly a drift of {_spell(row['drift'])} along the "
        f"session, from {row['drift_first']:.3g} to {row['drift_last']:.3g}{unit} if it is even: on trials left out it "
        f"takes away {_percent(row['drift_share'])}."
    )


def _describe_formula(name: str, row: Mapping[Any, Any]) -> str:
    named = [(name, str(row["unit"])), *map(name_signal, str(row["inputs"]).split(", "))]
    by_unit = {unit: [words for words, own in named if own == unit] for _, unit in named if unit}
    units = ", ".join(f"{_join(words)} in {unit}" for unit, words in by_unit.items())
    return (
        f"A hint, no finding: on {row['muscle']} it is about {row['hint']} ({units}), which, the constants refitted, "
        f"takes away {_percent(row['hint_share'])} of it."
    )


def _name_inputs(row: Mapping[Any, Any]) -> list[str]:
    return [name_signal(each)[0] for each in str(row["inputs"]).split(", ")]


def _describe_effect(effect: Mapping[str, Any], verdict: Mapping[str, Any]) -> str:
    ranking, standing = verdict["ranking"], [each["name"] for each in verdict["effects"]]
    first = effect is verdict["effects"][0]
    known = find_effect(effect["name"], effect["form"])
    possible = [each for each in ranking if _is_candidate(each) or round(each["probability"], 2) > 0.0]
    others = [each for each in possible if each["name"] not in standing and not each["absorbed"]]
    following = min(others, key=lambda each: (-round(each["probability"], 3), each["heldout_gap"]), default=None)
    second = ""
    if following and first:
        what = NAMELESS.get(following["name"]) or _spell(following["name"])
        second = f"; next is {what}, {say_sure(following['probability'])}"
    optional = [_describe_size(effect, each) for each in known.parameters if each.optional]
    sizes = " ".join(filter(None, optional)) or _describe_size(effect, known.parameters[0])
    like = " or ".join(_spell(each) for each in effect["indistinguishable_from"] if each not in standing)
    text = (
        f"{'This is' if first else 'Then there is'} {_spell(effect['name'])} on {_join(effect['muscles'])} "
        f"(probability {say_sure(effect['probability'])}{second}): {known.signature}. {sizes}"
    )
    if effect["name"] == QUANTISATION:
        text += " Its rounding is a part of the noise floor that matters, and no model takes it away."
    if not effect["reproduced"]:
        step = effect["step"]
        text += (
            f" Trials not fitted do not show it: with it the gap there goes from {_percent(step['before'])} to "
            f"{_percent(step['after'])} of range (one-sided p = {step['p_value']:.2g}), so it may stand in for "
            "something else."
        )
    if like:
        text += f" These data do not exclude {like}; what usually tells them apart: {known.split_by}."
    return text


def _describe_size(effect: Mapping[str, Any], size: Parameter) -> str:
    """Return the size of a parameter: with its interval on one muscle, from muscle to muscle on several."""
    unit = "" if size.unit == "1" else f" {size.unit}"
    own = [each[size.name] for each in effect["by_muscle"].values() if size.name in each]
    what = f"{_spell(size.name.removesuffix(f'_{size.unit.lower()}'))} ({size.description})"
    if not own:
        return ""
    if len(own) == 1:
        value, low, high = (f"{own[0][name]:.3g}" for name in ("value", "low", "high"))
        return f"Its {what} is {value}{unit}." if low == high else f"Its {what} is {value}{unit} ({low} to {high})."
    least, most = min(each["value"] for each in own), max(each["value"] for each in own)
    return f"Its {what} is {least:.3g} to {most:.3g}{unit} by muscle."


def describe_sizes(effect: Mapping[str, Any]) -> str:
    """Return the sizes of a named effect on each muscle, with their intervals, and what it does to the gap."""
    own: dict[str, list[str]] = {}
    for muscle, sizes in effect["by_muscle"].items():
        for name, size in sizes.items():
            ends = "" if size["low"] == size["high"] else f" ({size['low']:.3g} to {size['high']:.3g})"
            own.setdefault(name, []).append(f"{size['value']:.3g}{ends} on {muscle}")
    sizes = "; ".join(f"{_spell(name)} {', '.join(each)}" for name, each in own.items())
    step, name = effect["step"], _spell(effect["name"])
    return (
        f"{name[:1].upper()}{name[1:]}: {sizes}. With it the gap goes from {_percent(step['before'])} to "
        f"{_percent(step['after'])} of range (one-sided p = {step['p_value']:.2g})."
    )


def _is_candidate(row: Mapping[str, Any]) -> bool:
    return row["name"] not in NAMELESS and not row["absorbed"]


def _count(verdict: Mapping[str, Any]) -> str:
    trials = len(verdict["verification_trials"])
    return f"{trials} trial{'s' if trials > 1 else ''} not fitted"


def _percent(value: float) -> str:
    percent = 100.0 * value
    decimals = sum(percent < least for least in (9.95, 0.995, 0.0995)) if percent > 0.0 else 0
    return f"{percent:.{decimals}f} %"


def _spell(name: str) -> str:
    return name.replace("_", " ")


def _shorten(names: Sequence[str]) -> str:
    more = len(names) - MOST_LISTED
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:MOST_LISTED])} and {more} more"


def _join(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
