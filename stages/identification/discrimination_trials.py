"""Executes trials that tell the leading names of a missing effect apart, each chosen after a search of all before it.

In: the initial trials and those of the design's arm, and the rig. Out, one part per trial: `discrimination_trials`
(what each was chosen for), `discrimination_recordings`, and `discrimination_values` (the plant as the search amended it
before the trial). Fewer trials are executed where no two names are left to tell apart, or where none tells enough.
"""

from functools import partial
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.errors import ConfigError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.further_trial import NextTrial, choose_next, drive
from stages.science.discrepancy.parts import Parts
from stages.science.discrepancy.proposal import ProposalSettings, Proposed
from stages.science.discrepancy.ranking import list_steps
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.plant import Plant
from stages.science.recording.muscles import describe_muscles
from stages.science.recording.sources import Measurement, read_executed, tabulate
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import RECORDING_COLUMNS, Rig, tidy
from stages.science.rig.reference import tracked_trial
from stages.science.rig.trial import Proposal

DRIVEN = ("pressure_command_kpa", "joint_angle_rad")
"""What a trial prescribes."""
TRIAL = column(int, "order of execution", low=1)
DISCRIMINATION_TRIALS = Table(
    "discrimination_trials",
    "A trial that was executed to tell names apart, and what was known before it",
    {
        "participant": column(str, "who tracked"),
        "trial": TRIAL,
        "excitation": column(str, "what the joints' motion and the commands do"),
        "rivals": column(str, "names that it was to tell apart, the leading one first, by comma"),
        "probability": column(float, "of the leading name before it", low=0, high=1),
        "expected_before": column(float, "expected of the true one among the rivals, before it", low=0, high=1),
        "expected_after": column(float, "the same, after it", low=0, high=1),
        "named": column(str, "effects that stood before it, by comma"),
    },
    key=("trial",),
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


class Config(Section):
    """What this stage reads."""

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
    stream="discrimination_trials",
    extent=("next_trials",),
)
def discrimination_trials(
    cfg: Config, hardware_recordings: pd.DataFrame, active_recordings: pd.DataFrame, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Search, choose a trial, execute it, and search again."""
    rig: Rig = ctx.device
    if cfg.next_trials == 0:
        return list_none()
    if rig.recorded:
        raise ConfigError(
            f"next_trials: expected 0, as {type(rig).__name__} returns trials as they were once recorded and executes "
            "no other; set next_trials=0"
        )
    landed: list[dict[str, pd.DataFrame]] = []
    with rig, ctx.progress("trials that tell names apart", cfg.next_trials) as advance:
        for number in range(1, cfg.next_trials + 1):
            make = partial(execute_next, cfg, hardware_recordings, active_recordings, landed, number, rig, ctx)
            try:
                landed.append(until_kept(partial(ctx.record.part, (f"{number:02d}",), make)))
            except NothingToTell:
                break
            advance(landed[-1][DISCRIMINATION_TRIALS.name]["excitation"].item())
    return ctx.record.collect() if landed else list_none()


def list_none() -> dict[str, pd.DataFrame]:
    """Return the tables of no trials."""
    return {each.name: pd.DataFrame(columns=list(each.columns)) for each in discrimination_trials.writes}


class NothingToTell(Exception):
    """No trial would tell names apart, or none that the rig's limits allow."""


def execute_next(
    cfg: Config,
    initial: pd.DataFrame,
    designed: pd.DataFrame,
    landed: list[dict[str, pd.DataFrame]],
    number: int,
    rig: Rig,
    ctx: Context,
) -> dict[str, pd.DataFrame]:
    """Choose a trial by what is known now, execute it, and return its part.

    Raises
    ------
    NothingToTell
        When there is none.
    """
    further = pd.concat([part[DISCRIMINATION_RECORDINGS.name] for part in landed]) if landed else None
    source = read_executed(cfg.exoskeleton, initial, designed, further)
    tables, _ = tabulate(source, cfg.exoskeleton, cfg.measurement.largest_jitter)
    generators = ctx.generator("trials", number), ctx.generator("unexplained", number)
    settings = cfg.parts, cfg.discrepancy, cfg.propose_trial
    lead_in_s = max(-float(initial["time_s"].min()), 0.0)
    known = choose_next(cfg.plant, tables, *settings, *generators, lead_in_s)
    resting = initial.groupby("muscle")[list(DRIVEN)].mean()
    chosen, rows = choose_allowed(known, cfg, rig, lead_in_s, resting, ctx.generator("random", number))
    assert known.weighed is not None
    weighed, participant = known.weighed, str(initial["participant"].iloc[0])
    rivals = ", ".join(name.replace("_", " ") for name in known.rivals)
    reason = f"{weighed.spell(chosen)}: the trial that best tells {rivals} apart"
    trial = tracked_trial(
        rows,
        rig,
        participant,
        f"{participant} trial {number} to tell names apart",
        len(tables.measured_trials),
        Proposal(number, cfg.next_trials, reason),
    )
    recording = rig.execute(trial, ctx.generator("rig", number), ctx.record.watch((f"{number:02d}",)))
    effects = ",".join(each.name for each in known.decision.effects)
    before, after = weighed.expected_now, float(weighed.probability[chosen])
    told = (participant, number, weighed.spell(chosen), ",".join(known.rivals), known.leading, before, after, effects)
    values = [(number, *row[1:]) for row in list_steps([known.decision.steps[-1]])]
    samples = pd.DataFrame(tidy(recording, rig)).assign(participant=participant, trial=number)
    return {
        DISCRIMINATION_TRIALS.name: pd.DataFrame([told], columns=list(DISCRIMINATION_TRIALS.columns)),
        DISCRIMINATION_RECORDINGS.name: samples[list(DISCRIMINATION_RECORDINGS.columns)],
        DISCRIMINATION_VALUES.name: pd.DataFrame(values, columns=list(DISCRIMINATION_VALUES.columns)),
    }


def choose_allowed(
    known: NextTrial, cfg: Config, rig: Rig, lead_in_s: float, resting: pd.DataFrame, generator: np.random.Generator
) -> tuple[int, pd.DataFrame]:
    """Return the best kind of trial that the rig's limits allow, or a random one of them, and its reference's rows.

    `lead_in_s` and `resting` are as of `lay_out`.

    Raises
    ------
    NothingToTell
        When there is none, or when the best one tells too little.
    """
    weighed, given = known.weighed, cfg.propose_trial
    if weighed is None or weighed.gain < given.least_gain:
        raise NothingToTell
    order = weighed.order if given.choice == "evidence" else generator.permutation(len(weighed.kinds)).tolist()
    for each in order:
        rows = lay_out(weighed, each, rig, lead_in_s, resting)
        try:
            rig.check_bank(rows, "trajectory")
        except ValueError:
            continue
        return each, rows
    raise NothingToTell


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
