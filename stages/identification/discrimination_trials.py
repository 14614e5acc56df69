"""Executes trials that tell the leading names of a missing effect apart, each chosen after a search of all before it.

In: the initial trials and those of the design's arm, and the rig. Out, one part per trial: `discrimination_trials`
(what each was chosen for), `discrimination_recordings`, and `discrimination_values` (the plant as the search amended it
before the trial); and `discrimination_end`. Fewer trials are executed where no two names are left to tell apart, or
where none tells enough.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pydoc import locate
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from pipeline.config import Section, Target, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.further_trial import NextTrial, choose_next, drive
from stages.science.discrepancy.parts import Parts
from stages.science.discrepancy.proposal import ProposalSettings, Proposed
from stages.science.discrepancy.ranking import list_steps
from stages.science.discrepancy.report_text import join_names
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.plant import Plant
from stages.science.recording.muscles import describe_muscles
from stages.science.recording.sources import Measurement, read_executed, tabulate
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import RECORDING_COLUMNS, Rig
from stages.science.rig.reference import track
from stages.science.rig.trial import Proposal
from stages.science.signals.lead_in import leave_out_lead_in, measure_lead_in

DRIVEN = ("pressure_command_kpa", "joint_angle_rad")
"""What a trial prescribes."""
TRIAL = column(int, "order of execution", low=1)
DISCRIMINATION_TRIALS = Table(
    "discrimination_trials",
    "Trials that were executed to tell names apart, and what was known before each",
    {
        "participant": column(str, "who tracked"),
        "trial": TRIAL,
        "excitation": column(str, "what the joints' motion and the commands do"),
        "rivals": column(str, "names that it was to tell apart, with their probabilities, scaled to 1"),
        "expected_before": column(float, "expected probability of the true one of these, before it", low=0, high=1),
        "expected_after": column(float, "the same, after it", low=0, high=1),
        "stood_before": column(str, "effects that were named before it, by comma"),
    },
    key=("trial",),
)
DISCRIMINATION_END = Table(
    "discrimination_end",
    "How many trials were executed to tell names apart, and why no more",
    {"executed": column(int, "trials (count)", low=0), "reason": column(str, "why no more")},
)
DISCRIMINATION_RECORDINGS = Table(
    "discrimination_recordings",
    "A sample of a muscle in a trial that was executed to tell names apart",
    {"participant": column(str, "who tracked"), "trial": TRIAL, **RECORDING_COLUMNS},
    key=("trial", "muscle", "time_s"),
)
DISCRIMINATION_VALUES = Table(
    "discrimination_values",
    "A value of the plant as it was amended before such a trial, without learned maps",
    {
        "trial": TRIAL,
        "channel": column(str, "measured channel"),
        "muscle": column(str, "muscle"),
        "effect": column(str, "that the value belongs to; empty for a nominal constant"),
        "form": column(str, "its form"),
        "parameter": column(str, "name of the value"),
        "value": column(float, "fitted", unit="as named"),
    },
    key=("trial", "channel", "muscle", "effect", "parameter"),
)


class Executable(View):
    """Trials are searched that were executed, on a rig that can execute others."""

    measured: str | None
    next_trials: int
    rig: dict[str, Any]

    @model_validator(mode="after")
    def _can_execute(self) -> Self:
        if self.next_trials and self.measured is not None:
            raise ValueError("next_trials: expected 0, as measured=PATH is searched; set next_trials=0")
        if self.next_trials and getattr(locate(str(self.rig["_target_"])), "recorded", False):
            raise ValueError(
                "next_trials: expected 0, as this rig returns trials as they were once recorded; set next_trials=0"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (Executable,)

    discrepancy: DiscrepancySettings
    exoskeleton: Exoskeleton
    measurement: Measurement
    next_trials: Annotated[int, Field(ge=0, le=100)]
    parts: Parts
    plant: Plant
    propose_trial: ProposalSettings
    rig: Target
    seed: int


@stage(
    DISCRIMINATION_TRIALS,
    DISCRIMINATION_RECORDINGS,
    DISCRIMINATION_VALUES,
    DISCRIMINATION_END,
    stream="discrimination_trials",
    extent=("next_trials",),
)
def discrimination_trials(
    cfg: Config, hardware_recordings: pd.DataFrame, active_recordings: pd.DataFrame, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Search, choose a trial, execute it, and search again."""
    tables = {each.name: pd.DataFrame(columns=list(each.columns)) for each in discrimination_trials.writes}
    landed: list[dict[str, pd.DataFrame]] = []
    reason = f"as many as next_trials={cfg.next_trials} asks for"
    if cfg.next_trials:
        with ctx.device as rig, ctx.progress("trials that tell names apart", cfg.next_trials) as advance:
            for number in range(1, cfg.next_trials + 1):
                further = [each[DISCRIMINATION_RECORDINGS.name] for each in landed]
                known = hardware_recordings, active_recordings, further
                choose = cache(partial(choose_trial, cfg, *known, number, rig, ctx))
                make = partial(execute, cfg, choose, number, rig, ctx)
                try:
                    landed.append(until_kept(partial(ctx.record.part, (f"{number:02d}",), make)))
                except NothingToTell as told:
                    reason = str(told)
                    break
                advance(landed[-1][DISCRIMINATION_TRIALS.name]["excitation"].item())
    if landed:
        tables |= ctx.record.collect()
    end = pd.DataFrame([(len(landed), reason)], columns=list(DISCRIMINATION_END.columns))
    return {**tables, DISCRIMINATION_END.name: end}


class NothingToTell(Exception):
    """No trial is worth its execution; the message says why."""


@dataclass(frozen=True)
class Chosen:
    """A trial to execute: what is known before it, its kind, the reference's rows, its number of all, who tracks."""

    known: NextTrial
    weighed: Proposed
    rivals: Mapping[str, float]
    kind: int
    rows: pd.DataFrame
    place: int
    participant: str


def choose_trial(
    cfg: Config,
    initial: pd.DataFrame,
    designed: pd.DataFrame,
    further: Sequence[pd.DataFrame],
    number: int,
    rig: Rig,
    ctx: Context,
) -> Chosen:
    """Choose a trial by all that were executed; raise `NothingToTell` when there is none."""
    source = read_executed(cfg.exoskeleton, initial, designed, pd.concat(further) if further else None)
    tables, _ = tabulate(source, cfg.exoskeleton, cfg.measurement.largest_jitter)
    generators = ctx.generator("trials", number), ctx.generator("unexplained", number)
    settings = cfg.parts, cfg.discrepancy, cfg.propose_trial
    lead_in_s = measure_lead_in(initial)
    known = choose_next(cfg.plant, tables, *settings, *generators, lead_in_s)
    if known.question is None:
        raise NothingToTell("no two names are likely enough to be told apart")
    if known.weighed is None:
        raise NothingToTell("every kind of trial is faster than what was recorded")
    resting = leave_out_lead_in(initial).groupby("muscle")[list(DRIVEN)].mean()
    kind, rows = choose_allowed(known.weighed, cfg, rig, lead_in_s, resting, ctx.generator("random", number))
    place, participant = len(tables.measured_trials), str(initial["participant"].iloc[0])
    return Chosen(known, known.weighed, known.question.rivals, kind, rows, place, participant)


def execute(cfg: Config, choose: Callable[[], Chosen], number: int, rig: Rig, ctx: Context) -> dict[str, pd.DataFrame]:
    """Execute the trial that is chosen, and return its part."""
    it = choose()
    words = it.weighed.spell(it.kind)
    chosen = ", drawn at random," if cfg.propose_trial.choice == "random" else ","
    reason = f"{words}{chosen} to tell {join_names(list(it.rivals))} apart"
    label, proposal = f"{it.participant} trial {number} to tell names apart", Proposal(number, cfg.next_trials, reason)
    drawn, watch = ctx.generator("rig", number), ctx.record.watch((f"{number:02d}",))
    samples = track(it.rows, rig, it.participant, label, drawn, watch, it.place, proposal)
    shares = ", ".join(f"{name} {share:.2f}" for name, share in it.rivals.items())
    before, after = it.weighed.expected_now, float(it.weighed.probability[it.kind])
    decision = it.known.decision
    told = (it.participant, number, words, shares, before, after, ", ".join(each.name for each in decision.effects))
    values = [(number, *row[1:]) for row in list_steps([decision.steps[-1]])]
    samples = samples.assign(participant=it.participant, trial=number)
    return {
        DISCRIMINATION_TRIALS.name: pd.DataFrame([told], columns=list(DISCRIMINATION_TRIALS.columns)),
        DISCRIMINATION_RECORDINGS.name: samples[list(DISCRIMINATION_RECORDINGS.columns)],
        DISCRIMINATION_VALUES.name: pd.DataFrame(values, columns=list(DISCRIMINATION_VALUES.columns)),
    }


def choose_allowed(
    weighed: Proposed, cfg: Config, rig: Rig, lead_in_s: float, resting: pd.DataFrame, generator: np.random.Generator
) -> tuple[int, pd.DataFrame]:
    """Return the best kind of trial that the rig's limits allow, or a random one of them, and its reference's rows.

    `lead_in_s` and `resting` are as of `lay_out`. Raise `NothingToTell` when there is none, or it tells too little.
    """
    given = cfg.propose_trial
    best = given.choice == "evidence"
    order = weighed.order if best else generator.permutation(len(weighed.kinds)).tolist()
    for each in order:
        gain = float(weighed.probability[each]) - weighed.expected_now
        if best and gain < given.least_gain:
            raise NothingToTell(
                f"the best kind of trial{'' if each == order[0] else ' that the rig allows'} would raise the expected "
                f"probability of the true name by {gain:.2g}, less than propose_trial.least_gain={given.least_gain:g}"
            )
        rows = lay_out(weighed, each, rig, lead_in_s, resting)
        try:
            rig.check_bank(rows, "trajectory")
        except ValueError:
            continue
        return each, rows
    raise NothingToTell("the rig's limits allow no kind of trial")


def lay_out(weighed: Proposed, trial: int, rig: Rig, lead_in_s: float, resting: pd.DataFrame) -> pd.DataFrame:
    """Return a kind of trial on the rig's clock, as rows of a reference: without the lead-in, which rigs add.

    A muscle of which nothing is searched has its value of `resting`, with a row for each muscle, all the time.
    """
    command, angle, step_s = drive(weighed, trial, describe_muscles(rig.exoskeleton))
    times = np.arange(rig.samples) / rig.sampling_rate_hz
    frames = []
    for muscle, joint in zip(rig.muscles, rig.muscle_joints, strict=True):
        laid = {"muscle": muscle, "time_s": times, "trajectory": trial}
        for name, known in zip(DRIVEN, (command.get(muscle), angle.get(joint)), strict=True):
            values = resting.loc[[muscle], name].to_numpy() if known is None else known
            laid[name] = np.interp(times, step_s * np.arange(len(values)) - lead_in_s, values)
        frames.append(pd.DataFrame(laid))
    return pd.concat(frames, ignore_index=True)
