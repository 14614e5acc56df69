"""A session from a rig that hides something in it: what was measured, and a seal on the truth.

In: a rig of whole sessions. Out: `session_recordings`, `session_machine` (what a user would know of it), and `seal`,
the hash of what was hidden, which stands before anything is searched.
"""

import pandas as pd

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.recording.datasets import tabulate_session
from stages.science.recording.muscles import MUSCLE_COLUMNS
from stages.science.rig.contract import MEASUREMENT_COLUMNS
from stages.science.rig.sessions import seal_truth

SESSION_RECORDINGS = Table(
    "session_recordings",
    "A sample of a muscle in a recorded session",
    {
        "trial": column(int, "trial of the session", low=0),
        "start_s": column(float, "start of the trial in the session", unit="s", low=0),
        **MEASUREMENT_COLUMNS,
    },
    key=("trial", "muscle", "time_s"),
)
SESSION_MACHINE = Table(
    "session_machine",
    "A muscle of the machine that recorded a session",
    {
        **MUSCLE_COLUMNS,
        "sampling_rate_hz": column(float, "samples per second", unit="Hz", low=0),
        "load_cell_site": column(str, "where tension is measured", among=["muscle_tip", "joint_end", "unknown"]),
        "timing": column(str, "which sample a command acts on, in words"),
    },
    key=("muscle",),
)
SEAL = Table(
    "seal",
    "What tells whether the truth that is shown at the end is the one that was hidden",
    {"sha256": column(str, "hash of what was hidden"), "rig": column(str, "class of the rig that knows it")},
)


class Config(Section):
    """What this stage reads."""

    rig: Target


@stage(SESSION_RECORDINGS, SESSION_MACHINE, SEAL)
def blinded_session(cfg: Config, ctx: Context) -> dict[str, pd.DataFrame]:
    """Record a session, and seal what the rig hid in it."""
    recorded = ctx.device.record()
    tables = tabulate_session(recorded.samples, recorded.meta, type(ctx.device).__name__)
    starts = tables.measured_trials.set_index("trial")["start_s"]
    samples = tables.measured.assign(start_s=tables.measured["trial"].map(starts))
    told = {name: tables.measured_session[name].iloc[0] for name in ("sampling_rate_hz", "load_cell_site", "timing")}
    return {
        SESSION_RECORDINGS.name: samples[list(SESSION_RECORDINGS.columns)],
        SESSION_MACHINE.name: tables.measured_muscles[list(MUSCLE_COLUMNS)].assign(**told),
        SEAL.name: pd.DataFrame({"sha256": [seal_truth(recorded)], "rig": [type(ctx.device).__name__]}),
    }
