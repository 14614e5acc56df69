"""Further trials of a session that a rig recorded, each chosen to tell the leading names apart.

In: the session. Out: `further_recordings`, and `further_trials`: what each was chosen for, and how probable the leading
name was before it. Each is recorded, searched with all that there is, and the next chosen; they are all fitted.
"""

from dataclasses import replace
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.dataset import build_dataset
from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.fitted_channel import prepare_all
from stages.science.discrepancy.parts import Parts, list_parts
from stages.science.discrepancy.proposal import (
    ProposalSettings,
    Proposed,
    choose_rivals,
    choose_round,
    fit_rival,
    propose,
)
from stages.science.discrepancy.ranking import list_named, rank_first
from stages.science.discrepancy.search import search
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.muscle_channels import COMMAND, MuscleChannel
from stages.science.plant.plant import Plant
from stages.science.recording.blocks import PROPOSED, WHOLE
from stages.science.recording.datasets import list_trials
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import MUSCLE_COLUMNS
from stages.science.rig.contract import MEASUREMENT_COLUMNS
from stages.science.signals.trajectories import Array

FURTHER_RECORDINGS = Table(
    "further_recordings",
    "A sample of a muscle in a further trial",
    {
        "trial": column(int, "trial of the session", low=0),
        "start_s": column(float, "start of the trial in the session", unit="s", low=0),
        **MEASUREMENT_COLUMNS,
    },
    key=("trial", "muscle", "time_s"),
)
FURTHER_TRIALS = Table(
    "further_trials",
    "A further trial, and what was known before it",
    {
        "trial": column(int, "trial of the session", low=0),
        "excitation": column(str, "what each lever does"),
        "rivals": column(str, "names that it was to tell apart, the leading one first, by comma"),
        "probability": column(float, "of the leading name before it", low=0, high=1),
        "expected_before": column(float, "expected of the true one among the rivals, before it", low=0, high=1),
        "expected_after": column(float, "the same, after it", low=0, high=1),
        "evidence": column(float, "expected log score of the true name over the next, mean over rivals", unit="nats"),
    },
    key=("trial",),
)


class Config(Section):
    """What this stage reads."""

    discrepancy: DiscrepancySettings
    next_trials: Annotated[int, Field(ge=0, le=100)]
    parts: Parts
    plant: Plant
    propose_trial: ProposalSettings
    rig: Target
    seed: int


@stage(FURTHER_RECORDINGS, FURTHER_TRIALS, stream="further_trials")
def further_trials(
    cfg: Config, session_recordings: pd.DataFrame, session_machine: pd.DataFrame, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Search, choose a trial, record it, and search again."""
    recorded, rows = session_recordings.assign(part=WHOLE), []
    with ctx.progress("further trials", cfg.next_trials) as advance:
        for taken in range(cfg.next_trials):
            weighed, told = choose_next(cfg, list_tables(recorded, session_machine), ctx, taken)
            if weighed is None:
                break
            chosen = weighed.order[0]
            if cfg.propose_trial.choice == "random":
                chosen = int(ctx.generator("random", taken).integers(len(weighed.kinds)))
            samples, (start_s,) = ctx.device.prescribe(*drive(weighed, chosen, session_machine), taken)
            further = samples.assign(start_s=start_s, part=PROPOSED)
            recorded = pd.concat([recorded, further[recorded.columns]], ignore_index=True)
            rows.append(
                {
                    "trial": samples["trial"].iloc[0],
                    "excitation": weighed.spell(chosen),
                    **told,
                    "expected_before": weighed.expected_now,
                    "expected_after": weighed.probability[chosen],
                    "evidence": weighed.mean_evidence[chosen],
                }
            )
            advance(weighed.spell(chosen))
    kept = recorded[recorded["part"] == PROPOSED]
    return {
        FURTHER_RECORDINGS.name: kept[list(FURTHER_RECORDINGS.columns)],
        FURTHER_TRIALS.name: pd.DataFrame(rows, columns=list(FURTHER_TRIALS.columns)),
    }


def list_tables(recorded: pd.DataFrame, machine: pd.DataFrame) -> MeasuredTables:
    """Return what was recorded so far as a dataset."""
    told = machine.iloc[0]
    trials = list_trials(recorded, float(told["sampling_rate_hz"]))
    own = recorded.groupby("trial")[["part", "start_s"]].first()
    trials = trials.assign(part=trials["trial"].map(own["part"]), start_s=trials["trial"].map(own["start_s"]))
    session = machine[["load_cell_site", "sampling_rate_hz", "timing"]].head(1).assign(source="session", kind="muscles")
    return MeasuredTables(recorded, pd.DataFrame(columns=["signal"]), trials, machine[list(MUSCLE_COLUMNS)], session)


def choose_next(
    cfg: Config, tables: MeasuredTables, ctx: Context, taken: int
) -> tuple[Proposed | None, dict[str, Any]]:
    """Return kinds of trials, weighed by what is known now; or none where no two names are left to tell apart."""
    settings, given = cfg.discrepancy, cfg.propose_trial
    parts = list_parts(tables.measured_trials, cfg.parts, settings.verification_share)
    prepared = prepare_all(build_dataset(cfg.plant, tables, parts, settings).fitted_outputs)
    found = search(prepared, settings.search, ctx.generator("trials", taken))
    decision = decide(found, settings, ctx.generator("unexplained", taken))
    ranking = pd.DataFrame(rank_first(found, decision.doubt, settings.report.most_confounded))
    named = pd.DataFrame(list_named(decision.effects), columns=["order", "indistinguishable_from"])
    number, alike = choose_round(ranking, named)
    chosen = choose_rivals(ranking[ranking["round"] == number], alike, given.rivals, given.least_probability)
    told = {"rivals": ",".join(chosen), "probability": float(ranking["probability"][ranking["round"] == number].max())}
    if len(chosen) < 2:
        return None, told
    fits = found.steps[number - 1]
    states = [replace(state, current=each) for state, each in zip(found.outputs, fits, strict=True)]
    rivals = [fit_rival(states, name, probability) for name, probability in chosen.items()]
    return propose(states, rivals, settings.search.largest_jitter), told


def drive(weighed: Proposed, trial: int, machine: pd.DataFrame) -> tuple[dict[str, Array], dict[str, Array], float]:
    """Return each muscle's command, kPa, and each joint's angle, rad, in a trial, and the time between samples, s."""
    command: dict[str, Array] = {}
    angle: dict[str, Array] = {}
    step_s = 0.0
    joints = dict(zip(machine["muscle"], machine["joint"], strict=True))
    for output in weighed.outputs:
        if isinstance(output, MuscleChannel):
            levers = output.take([trial]).tell_levers()
            build, step_s = output.build, output.step_s
            command[output.element] = levers[COMMAND][:, 0]
            contracted = levers["contraction"][:, 0] - build.contraction_at_angle_0
            angle.setdefault(joints[output.element], contracted / build.contraction_per_rad)
    return command, angle, step_s
