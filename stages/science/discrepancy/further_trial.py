"""The next trial of a machine: a search of all trials that there are, and the trial that would tell its names apart.

A dataset flows in; out flow what the search found of it, and kinds of trials, weighed. `drive` turns one of them into
what a rig executes.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stages.science.discrepancy.dataset import build_dataset
from stages.science.discrepancy.decision import Decision, decide
from stages.science.discrepancy.fitted_channel import prepare_all
from stages.science.discrepancy.parts import Parts, list_parts
from stages.science.discrepancy.proposal import ProposalSettings, Proposed, Question, choose_round, propose
from stages.science.discrepancy.ranking import list_named, rank_first
from stages.science.discrepancy.search import search
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.output_channels.muscle_channels import COMMAND, MuscleChannel
from stages.science.plant.plant import Plant
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.signals.trajectories import Array


@dataclass(frozen=True)
class NextTrial:
    """What is known of a machine, and which trial would tell the leading names apart.

    `question` is none where no two names are left to tell apart; `weighed` then, and where all kinds of trials are too
    fast or none is expected to tell more than `ProposalSettings.least_gain`.
    """

    decision: Decision
    question: Question | None
    weighed: Proposed | None


def choose_next(
    plant: Plant,
    tables: MeasuredTables,
    parts: Parts,
    settings: DiscrepancySettings,
    given: ProposalSettings,
    starts: np.random.Generator,
    signs: np.random.Generator,
    lead_in_s: float = 0.0,
) -> NextTrial:
    """Search the fitted trials of a dataset, and weigh kinds of trials by what is known then.

    Parameters
    ----------
    starts, signs : Generator
        Of other starts of fits, and of the decision's flips of signs.
    lead_in_s : float
        Time in which muscles are filled and the joints rest, before what a trial is for, s.
    """
    purposes = list_parts(tables.measured_trials, parts, settings.verification_share)
    prepared = prepare_all(build_dataset(plant, tables, purposes, settings).fitted_outputs)
    found = search(prepared, settings.search, starts)
    decision = decide(found, settings, signs)
    ranking = pd.DataFrame(rank_first(found, decision, settings.report.most_confounded))
    columns = ["round", "name", "probability", "indistinguishable_from"]
    named, suspected = (
        pd.DataFrame(list_named(each, found.rounds), columns=columns) for each in (decision.effects, decision.suspected)
    )
    question = choose_round(ranking, named, suspected, given.rivals, given.least_probability)
    weighed = None
    if question is not None:
        fits = decision.steps[question.standing]
        states = [replace(state, current=each) for state, each in zip(found.outputs, fits, strict=True)]
        weighed = propose(states, question.rivals, settings.search.largest_jitter, lead_in_s)
    if weighed is not None and weighed.gain < given.least_gain:
        weighed = None
    return NextTrial(decision, question, weighed)


def drive(weighed: Proposed, trial: int, machine: pd.DataFrame) -> tuple[dict[str, Array], dict[str, Array], float]:
    """Return each muscle's command, kPa, and each joint's angle, rad, in a trial, and the time between samples, s.

    The machine has a row for each muscle, with its joint.
    """
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
