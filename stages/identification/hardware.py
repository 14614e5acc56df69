"""Executes given lists of trials on the rig: those that give each experiment its initial data, and a protocol's.

In: `initial_trials`, `references` and, where the workflow has a protocol, `protocol_commands`. Out, in parts:
`hardware_recordings`, `protocol_recordings` (nobody moves; empty without a protocol) and `executed_by`, which says what
the recordings come from.
"""

from collections.abc import Hashable
from functools import partial
from typing import Any

import pandas as pd

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.rig.attendance import until_kept
from stages.science.rig.contract import RECORDING_COLUMNS, Rig
from stages.science.rig.pacing import measure_pace
from stages.science.rig.reference import track
from stages.science.rig.trial import Proposal
from stages.science.signals.lead_in import leave_out_lead_in

NOBODY = "nobody"
"""Who is in a passive trial; no participant has this name."""

HARDWARE_RECORDINGS = Table(
    "hardware_recordings",
    "A sample of a muscle in an executed trial",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "position": column(int, "order of execution", low=1),
        "trajectory": column(int, "movement of the bank that was tracked", low=0),
        **RECORDING_COLUMNS,
    },
    key=("participant", "experiment", "position", "muscle", "time_s"),
)
PROTOCOL_RECORDINGS = Table(
    "protocol_recordings",
    "A sample of a muscle in an executed trial of the automatic protocol, in which nobody moves",
    {
        "experiment": column(int, "sequence of trials", low=1),
        "trial": column(int, "trial of this experiment", low=1),
        **RECORDING_COLUMNS,
    },
    key=("experiment", "trial", "muscle", "time_s"),
)
EXECUTED_BY = Table(
    "executed_by",
    "The rig that executed the trials",
    {
        "rig": column(str, "its class"),
        "real": column(bool, "whether it is a machine, not a simulation"),
        "sampling_rate_hz": column(float, "samples per second", unit="Hz", low=0),
        "period_p50_s": column(float, "median time from one sample to the next", unit="s", low=0),
        "period_p99_s": column(float, "99th percentile of it", unit="s", low=0),
        "overruns": column(int, "samples that were missed, or taken over half a period late", low=0),
        "samples": column(int, "of all tracked trials", low=1),
    },
)


class Config(Section):
    """What this stage reads."""

    rig: Target
    seed: int


@stage(HARDWARE_RECORDINGS, PROTOCOL_RECORDINGS, EXECUTED_BY, stream="hardware")
def hardware(
    cfg: Config,
    initial_trials: pd.DataFrame,
    references: pd.DataFrame,
    ctx: Context,
    protocol_commands: pd.DataFrame | None = None,
) -> dict[str, pd.DataFrame]:
    """Execute each experiment's initial trials, then those of the protocol."""
    rig: Rig = ctx.device
    rig.check_bank(references, "trajectory")
    passive = split_turns(protocol_commands, rig.real or ctx.interactive)
    with rig, ctx.progress("trials", len(initial_trials) + len(passive)) as advance:
        for number, row in enumerate(initial_trials.to_dict("records")):
            key = (row["participant"], row["experiment"], row["position"])
            make = partial(execute_tracked, row, number, len(initial_trials), references, rig, ctx)
            until_kept(partial(ctx.record.part, key, make))
            advance(f"{row['participant']} experiment {row['experiment']}")
        total = sum(commands["number"].nunique() for commands in passive.values())
        for turn, commands in passive.items():
            make = partial(execute_passive, commands, turn, total, rig, ctx)
            until_kept(partial(ctx.record.part, (NOBODY, *turn), make))
            advance(f"protocol experiment {turn[0]}")
    tables = ctx.record.collect()
    pace = measure_pace(leave_out_lead_in(tables[HARDWARE_RECORDINGS.name]), ["participant", "experiment", "position"])
    rate_hz = float(rig.sampling_rate_hz)
    executed_by = (type(rig).__name__, rig.real, rate_hz, pace.p50_s, pace.p99_s, pace.overruns, pace.samples)
    return {**tables, EXECUTED_BY.name: pd.DataFrame([executed_by], columns=list(EXECUTED_BY.columns))}


def execute_tracked(
    row: dict[Hashable, Any], number: int, total: int, references: pd.DataFrame, rig: Rig, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Execute one initial trial."""
    key = (row["participant"], row["experiment"], row["position"])
    samples = references[references["trajectory"] == row["trajectory"]]
    label = f"{row['participant']} experiment {row['experiment']} initial {row['position']}"
    proposal = Proposal(number + 1, total, "an initial trial, drawn at random", int(row["trajectory"]))
    drawn, watch = ctx.generator(*key), ctx.record.watch(key)
    rows = track(samples, rig, row["participant"], label, drawn, watch, number, proposal)
    where = {str(name): value for name, value in row.items()}
    return {HARDWARE_RECORDINGS.name: rows.assign(**where)[list(HARDWARE_RECORDINGS.columns)]}


def split_turns(commands: pd.DataFrame | None, singly: bool) -> dict[tuple[int, ...], pd.DataFrame]:
    """Return the protocol's commands by turn of the loop, named by experiment and, where they land singly, trial.

    Their column number is the trial's among all. What a machine measured lands trial by trial, and so does what
    somebody decides on. A simulation's trials land by experiment else, as each is made sooner than a part is written.
    """
    if commands is None:
        return {}
    commands = commands.assign(number=commands.groupby(["experiment", "trial"], sort=False).ngroup())
    by = ["experiment", "trial"] if singly else ["experiment"]
    return {tuple(int(str(each)) for each in key): rows for key, rows in commands.groupby(by, sort=False)}


def execute_passive(
    commands: pd.DataFrame, key: tuple[int, ...], total: int, rig: Rig, ctx: Context
) -> dict[str, pd.DataFrame]:
    """Execute trials of the protocol, as `split_turns` numbers them."""
    frames = []
    watch = ctx.record.watch((NOBODY, *key))
    for each, samples in commands.groupby(["number", "experiment", "trial"], sort=False):
        number, *turn = (int(str(value)) for value in each)
        label = "protocol experiment {} trial {}".format(*turn)
        proposal = Proposal(number + 1, total, "a trial of the protocol")
        measured = track(samples, rig, NOBODY, label, ctx.generator(NOBODY, *turn), watch, number, proposal)
        frames.append(measured.assign(experiment=turn[0], trial=turn[1]))
    return {PROTOCOL_RECORDINGS.name: pd.concat(frames, ignore_index=True)[list(PROTOCOL_RECORDINGS.columns)]}
