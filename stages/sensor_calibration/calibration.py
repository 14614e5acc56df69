"""What the counts of a real rig's channels mean: known values flow in, one at a time, and lines flow out.

At each point the run stops and asks a person to set a known value; typed again, it records the counts of all inputs.
In: a rig that counts, and the points. Out, in parts: `calibration_samples`, `calibration_turns`, and of the gauge
`calibration_readings`; in the end `calibration_points`, `calibration_lines`, `calibration_changes`, figures, and the
document ``calibrated.yaml``, a rig that ``rig=PATH`` loads as it is.
"""

import logging
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.errors import InputError
from pipeline.inputs import read_json
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.channel_lines import draw_channel_lines
from stages.science.rig.festo.channels import ChannelMap
from stages.science.rig.festo.count_lines import Judged, find_followers, fit_line, judge_point, unroll
from stages.science.rig.festo.festo_cpx import FestoCpx
from stages.science.rig.festo.known_points import (
    UNITS,
    CalibrationSettings,
    PointRequested,
    Turn,
    describe_task,
    find_reading,
    label,
    list_turns,
    split_name,
)

log = logging.getLogger("pamid")

STATUSES = ("calibrated", "refused")
TURN = {
    "point": column(int, "number of the point, in the order of asking", low=1),
    "attempt": column(int, "how often it was asked for", low=1),
}
CALIBRATION_SAMPLES = Table(
    "calibration_samples",
    "What one input counted in one sample of the record of a point",
    {
        **TURN,
        "channel": column(str, "input"),
        "time_s": column(float, "from the record's first sample", unit="s", low=0),
        "count": column(float, "as the device told it"),
    },
    key=("point", "attempt", "channel", "time_s"),
)
CALIBRATION_TURNS = Table(
    "calibration_turns",
    "How a point was recorded",
    {
        **TURN,
        "channels": column(str, "that it tells about"),
        "value": column(float, "asked for", unit="as told"),
        "held": column(str, "muscle that was under pressure; empty for none"),
        "command_count": column(float, "what was written to its regulator", nullable=True),
        "stopped": column(str, "why the muscle was let down early; empty where it was not"),
    },
    key=("point", "attempt"),
)
CALIBRATION_READINGS = Table(
    "calibration_readings",
    "What the reference gauge showed while a muscle was held",
    {**TURN, "gauge_kpa": column(float, "read by a person, gauge", unit="kPa")},
    key=("point", "attempt"),
)
CALIBRATION_POINTS = Table(
    "calibration_points",
    "What one channel counted at one known value",
    {
        **TURN,
        "channel": column(str, "that the point tells about"),
        "unit": column(str, "of its values"),
        "asked": column(float, "value asked for", unit="as told"),
        "known": column(float, "value that was there: as asked, or as the gauge showed", unit="as told", nullable=True),
        "count": column(float, "mean", nullable=True),
        "spread_count": column(float, "standard deviation", nullable=True),
        "drift_count": column(float, "change from the first to the last quarter", nullable=True),
        "samples": column(int, "in the record", low=0),
        "saturated": column(float, "share of samples at the end of the range", low=0, high=1),
        "lost": column(float, "share of samples without a value", low=0, high=1),
        "residual": column(float, "of the line, less what is known", unit="as told", nullable=True),
        "problem": column(str, "why it is of no use; empty where it is"),
    },
    key=("point", "attempt", "channel"),
)
CALIBRATION_LINES = Table(
    "calibration_lines",
    "What the counts of one channel mean",
    {
        "channel": column(str, "input, or regulator"),
        "status": column(str, "whether the points determine a line; else nothing changes", among=STATUSES),
        "per_count": column(float, "value of a count", unit="as told", nullable=True),
        "unit": column(str, "of values"),
        "zero_count": column(float, "counts at zero", nullable=True),
        "sign": column(int, "-1 where counts fall as the value rises, 0 where it is not known", among=(-1, 0, 1)),
        "points": column(int, "of use", low=0),
        "residual_rms": column(float, "of the points", unit="as told", nullable=True),
        "residual_largest": column(float, "of the points", unit="as told", nullable=True),
        "repeatability": column(float, "largest difference at one known value", unit="as told", nullable=True),
        "told": column(str, "why it was refused, or what is strange"),
    },
    key=("channel",),
)
CALIBRATION_CHANGES = Table(
    "calibration_changes",
    "How far the line of one channel is from what was configured",
    {
        "channel": column(str, "input, or regulator"),
        "unit": column(str, "of values"),
        "plausible": column(bool, "whether it is near"),
        "ratio": column(float, "value of a count, to the configured one", nullable=True),
        "at_zero": column(float, "what was read at zero until now", unit="as told", nullable=True),
        "configured_per_count": column(float, "value of a count until now", unit="as told"),
        "configured_zero_count": column(float, "counts at zero until now"),
        "configured_sign": column(int, "until now", among=(-1, 1)),
    },
    key=("channel",),
)
RECORDED = (CALIBRATION_SAMPLES, CALIBRATION_TURNS, CALIBRATION_READINGS)
TABLES = (*RECORDED, CALIBRATION_POINTS, CALIBRATION_LINES, CALIBRATION_CHANGES)


class PointsFit(View):
    """The rig counts, has every channel that has points, and may be commanded every pressure that is asked for."""

    calibration: CalibrationSettings
    rig: dict[str, Any]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if "channels" not in self.rig or "encoders" not in self.rig:
            raise ValueError(
                f"rig: expected one whose channels count, got {self.rig.get('_target_')}; type rig=festo_cpx"
            )
        try:
            self.calibration.check_channels(self.rig["channels"], self.rig["encoders"])
        except ValueError as error:
            raise ValueError(f"calibration.{error}") from None
        types = {each["name"]: each["type"] for each in self.rig["exoskeleton"]["muscles"]}
        for turn in list_turns(self.calibration.points):
            if turn.held and turn.held in types:
                limit = self.rig["limits"].get(types[turn.held], {})
                low, high = limit.get("low_kpa", -np.inf), limit.get("high_kpa", np.inf)
                if not low <= turn.value <= high:
                    raise ValueError(
                        f"calibration.points.{turn.channels[0]}: expected {low} to {high} kPa, which "
                        f"{turn.held} may be commanded (rig.limits.{types[turn.held]}), got {turn.value}"
                    )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (PointsFit,)

    calibration: CalibrationSettings
    rig: Target


@stage(*TABLES)
def calibration(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record every point, asking for one at a time, then fit a line to each channel."""
    loop = Loop(cfg.calibration, ctx)
    for turn in loop.turns:
        loop.take(turn)
    told = ctx.record.collect()
    fitted = loop.fit(told)
    points, lines = fitted[CALIBRATION_POINTS.name], fitted[CALIBRATION_LINES.name]
    for kind in dict.fromkeys(split_name(each)[1] for each in lines["channel"]):
        chosen = lines[[split_name(each)[1] == kind for each in lines["channel"]]]
        caption = "Mean counts at known values (o; x = of no use), the line through them, and their distance from it."
        ctx.figure(f"lines_{kind}", draw_channel_lines(points, chosen), caption)
    good, refused = (list(lines.loc[lines["status"] == each, "channel"]) for each in STATUSES)
    if good:
        comments = ["@package _global_", f"Calibrated: {', '.join(good)}; all others are as configured before."]
        comments += [f"No line was determined for {', '.join(refused)}."] if refused else []
        ctx.document("calibrated", write_rig(cfg.rig, lines), "yaml", comments)
    for row in lines[lines["told"] != ""].to_dict("records"):
        log.warning("%s %s: %s", row["channel"], row["status"], row["told"])
    return told | fitted


class Loop:
    """The loop over points: what is recorded stays, what is not is asked for, and lines are fitted in the end."""

    def __init__(self, settings: CalibrationSettings, ctx: Context):
        self.settings, self.ctx = settings, ctx
        self.rig: FestoCpx = ctx.device
        self.turns = list_turns(settings.chosen)
        self.gauge = ctx.folder / "gauge.csv"
        self.news = ""
        self.points: list[dict[str, Any]] = []
        """Rows of `calibration_points` but for their residuals, of what was recorded."""

    def take(self, turn: Turn) -> None:
        """Have a point recorded, once more where that was of no use, and what the gauge showed meanwhile."""
        for attempt in range(1, self.settings.attempts + 1):
            part = self.ctx.record.part((turn.point, attempt), partial(self.record, turn, attempt))
            judged = self.judge(part, turn)
            problem = next((each.problem for each in judged.values() if each.problem), "")
            if self.news:
                counted = [f"{each.count:.1f} counts, spread {each.spread_count:.1f}" for each in judged.values()]
                useless = f", of no use: {problem}" if problem else ""
                self.news = f"recorded {turn.title} ({', '.join(counted)}){useless}; "
            known = np.nan if turn.held else turn.value
            if turn.held and not problem:
                read = self.ctx.record.part(("gauge", turn.point, attempt), partial(self.read_gauge, turn, attempt))
                known = float(read[CALIBRATION_READINGS.name]["gauge_kpa"].iloc[0])
            for channel, found in judged.items():
                row = {"point": turn.point, "attempt": attempt, "channel": channel, "unit": turn.unit}
                row |= {"asked": turn.value, "known": known, **vars(found)}
                if not found.problem and split_name(channel)[1] == "command" and known <= 0.0:
                    row["problem"] = f"the gauge showed {known:g} kPa: the regulator is at its end, or another's"
                self.points.append(row)
            if not problem:
                return

    def record(self, turn: Turn, attempt: int) -> dict[str, pd.DataFrame]:
        """Record a point if a person was asked to set it, else ask."""
        if not self.was_asked(turn, attempt):
            raise PointRequested(turn, attempt, f"{self.news}{self.ask(turn)}")
        settings = self.settings
        with self.rig as rig:
            if turn.held:
                times_s = {"ramp_s": settings.ramp_s, "settle_s": settings.settle_s}
                recording = rig.hold(turn.held, turn.value, settings.record_s, **times_s)
            else:
                recording = rig.read_counts(settings.record_s)
        self.news = "recorded"
        where = {"point": turn.point, "attempt": attempt}
        counted = recording.counts.reset_index().melt("time_s", var_name="channel", value_name="count")
        told = {
            "channels": " ".join(turn.channels),
            "value": turn.value,
            "held": turn.held,
            "command_count": np.nan if recording.command_count is None else float(recording.command_count),
            "stopped": recording.stopped,
        }
        samples = counted.assign(**where)[list(CALIBRATION_SAMPLES.columns)]
        return {CALIBRATION_SAMPLES.name: samples, CALIBRATION_TURNS.name: pd.DataFrame([where | told])}

    def read_gauge(self, turn: Turn, attempt: int) -> dict[str, pd.DataFrame]:
        """Read what the gauge showed, or ask for it, and for the next point with it."""
        try:
            text = self.gauge.read_text(encoding="utf-8-sig") if self.gauge.exists() else ""
            found = find_reading(text, label(turn.point, attempt))
        except (ValueError, OSError) as error:
            raise InputError(f"{self.gauge}: {error}") from None
        if found is None:
            following = self.turns[turn.point] if turn.point < len(self.turns) else None
            then = f"; then {self.ask(following)}" if following else ""
            tell = "tell what the gauge showed, with its kPa in place of KPA: echo "
            where = f"{tell}{label(turn.point, attempt)},KPA >> {self.gauge}"
            raise PointRequested(following, 1, f"{self.news}{where}{then}")
        row = pd.DataFrame({"point": [turn.point], "attempt": [attempt], "gauge_kpa": [found]})
        return {CALIBRATION_READINGS.name: row}

    def ask(self, turn: Turn) -> str:
        """Return what a person is asked to do."""
        return f"point {turn.point} of {len(self.turns)}, {turn.title}: {describe_task(turn, self.settings)}"

    def was_asked(self, turn: Turn, attempt: int) -> bool:
        """Return whether the last thing that this run asked for is this attempt at this point."""
        path: Path = self.ctx.folder / "documents" / "asks.json"
        asked = read_json(path) if path.exists() else {}
        return (asked.get("point"), asked.get("attempt")) == (turn.point, attempt)

    def judge(self, told: dict[str, pd.DataFrame], turn: Turn) -> dict[str, Judged]:
        """Judge every channel that a recorded point tells about."""
        samples, (how,) = told[CALIBRATION_SAMPLES.name], told[CALIBRATION_TURNS.name].to_dict("records")
        valid, judged = self.rig.device.counts, {}
        for channel in turn.channels:
            kind = split_name(channel)[1]
            counts = samples.loc[samples["channel"] == channel, "count"].to_numpy()
            if kind == "command":
                counts = np.full(samples["time_s"].nunique(), how["command_count"])
            place = self.find_place(channel)
            judged[channel] = judge_point(counts, kind, place, valid, self.settings, str(how["stopped"]))
        return judged

    def find_place(self, channel: str) -> Any:
        """Return what is configured of a channel of the rig, which the exoskeleton may lack."""
        owner, kind = split_name(channel)
        return self.rig.encoders[owner] if kind == "encoder" else getattr(self.rig.channels[owner], kind)

    def fit(self, told: dict[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
        """Return the points, lines and changes of what was recorded."""
        points, channels = pd.DataFrame(self.points), self.rig.map_channels()
        means = average_inputs(told[CALIBRATION_SAMPLES.name], channels)
        rows, changes, residual = [], [], pd.Series(np.nan, index=points.index)
        for channel in self.settings.chosen:
            its, place = points[points["channel"] == channel], self.find_place(channel)
            at = pd.MultiIndex.from_frame(its[["point", "attempt"]])
            counted = means.loc[means.index.isin(at)].reindex(at)
            spread = {name: float(np.nanmedian(counted["spread", name])) for name in channels.names}
            mean = {name: counted["mean", name].to_numpy() for name in spread}
            followers = find_followers(channel, its["asked"].to_numpy(), mean, spread, self.settings)
            line = fit_line(channel, its, place, self.rig.device.counts, self.settings, followers)
            named = {"channel": channel, "unit": UNITS[split_name(channel)[1]]}
            rows.append(named | vars(line))
            changes.append(
                named
                | {
                    "plausible": line.plausible,
                    "ratio": line.per_count / abs(place.per_count),
                    "at_zero": place.per_count * (line.zero_count - place.zero_count),
                    "configured_per_count": abs(place.per_count),
                    "configured_zero_count": place.zero_count,
                    "configured_sign": place.sign,
                }
            )
            if line.status == "calibrated":
                residual[its.index] = line.sign * line.per_count * (its["count"] - line.zero_count) - its["known"]
        return {
            CALIBRATION_POINTS.name: points.assign(residual=residual)[list(CALIBRATION_POINTS.columns)],
            CALIBRATION_LINES.name: pd.DataFrame(rows)[list(CALIBRATION_LINES.columns)],
            CALIBRATION_CHANGES.name: pd.DataFrame(changes),
        }


def average_inputs(samples: pd.DataFrame, channels: ChannelMap) -> pd.DataFrame:
    """Return mean and spread of every input's counts, by point and attempt; encoders without their beginning anew."""
    counts = samples["count"].copy()
    for name in channels.names:
        if split_name(name)[1] == "encoder":
            its = samples["channel"] == name
            counts[its] = unroll(counts[its].to_numpy(), channels.places[name].zero_count)
    grouped = samples.assign(count=counts).groupby(["point", "attempt", "channel"])["count"]
    return pd.concat({"mean": grouped.mean().unstack(), "spread": grouped.std(ddof=0).unstack()}, axis=1)


def write_rig(rig: Target, lines: pd.DataFrame) -> dict[str, Any]:
    """Return the rig's option of the configuration, with the lines in place of what was configured."""
    values = rig.model_dump(by_alias=True)
    rate_hz = values["exoskeleton"]["sampling_rate_hz"]
    values |= {"exoskeleton": "${exoskeleton}", "participants": "${participants}"}
    for row in lines[lines["status"] == "calibrated"].to_dict("records"):
        owner, kind = split_name(row["channel"])
        place = values["encoders"][owner] if kind == "encoder" else values["channels"][owner][kind]
        place[f"{row['unit'].lower()}_per_count"] = float(f"{row['per_count']:.9g}")
        place |= {"zero_count": round(row["zero_count"], 3), "sign": int(row["sign"])}
    return {"exoskeleton": {"sampling_rate_hz": rate_hz}, "rig": values}
