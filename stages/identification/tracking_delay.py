"""How late people follow what they are shown, and how much of that is the screen's.

In: `references`, `hardware_recordings` and `active_recordings`. Out: `tracking_delays`, for each trial and joint: from
when a reference was due until it was followed, from then until a screen showed it, and what is left to the person. The
time shifts that a study has to bear (stage time_shift) are those of people, not of screens.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.rig.limits import speed_samples
from stages.science.signals.bending import Bending, read_changes
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.measures import find_delay

INITIAL = "initial"

TRACKING_DELAYS = Table(
    "tracking_delays",
    "How late a joint followed its reference in a trial",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "arm": column(str, f"how trajectories were chosen; {INITIAL}: before any was"),
        "trial": column(int, "trial of this experiment and arm", low=1),
        "joint": column(str, "joint"),
        "delay_s": column(
            float, "from when the reference was due until the joint was there; missing: not followed", unit="s",
            low=0, nullable=True,
        ),
        "display_delay_s": column(
            float, "median from when it was due until a screen showed it; missing: no screen", unit="s", nullable=True
        ),
        "person_delay_s": column(
            float, "what is left to the person and the machine; missing: no screen", unit="s", nullable=True
        ),
    },
    key=("participant", "experiment", "arm", "trial", "joint"),
)  # fmt: skip


class TrackingDelay(Section):
    """Config group ``tracking_delay``."""

    longest_s: float = Field(gt=0.0, le=10.0)


class Config(Section):
    """What this stage reads."""

    tracking_delay: TrackingDelay
    exoskeleton: Exoskeleton


@stage(TRACKING_DELAYS)
def tracking_delay(
    cfg: Config,
    references: pd.DataFrame,
    hardware_recordings: pd.DataFrame,
    active_recordings: pd.DataFrame,
    trials: pd.DataFrame,
    ctx: Context,
) -> pd.DataFrame:
    """Say how late people follow references, and how much of that is the screen's."""
    initial = hardware_recordings.rename(columns={"position": "trial"}).assign(arm=INITIAL, bent_by="")
    where = ["participant", "experiment", "arm", "trial"]
    chosen = trials.assign(bent_by=trials.get("bent_by", ""))[[*where, "trajectory", "bent_by"]]
    designed = active_recordings.merge(chosen, on=where)
    columns = [*where, "trajectory", "bent_by", "time_s", "muscle", "joint_angle_rad", "reference_shown_s"]
    recordings = leave_out_lead_in(pd.concat([initial[columns], designed[columns]]))
    # of each joint, a muscle whose rows tell its angle
    muscles = {muscle.joint: muscle.name for muscle in reversed(cfg.exoskeleton.muscles)}
    rows = [row for joint, muscle in muscles.items() for row in measure(cfg, recordings, references, joint, muscle)]
    frame = pd.DataFrame(rows, columns=list(TRACKING_DELAYS.columns))
    return frame.sort_values(where, kind="stable", ignore_index=True)


def measure(
    cfg: Config, recordings: pd.DataFrame, references: pd.DataFrame, joint: str, muscle: str
) -> Iterator[tuple[Any, ...]]:
    """Yield a joint's row for each trial."""
    shown = references[references["muscle"] == muscle].groupby("trajectory")["joint_angle_rad"]
    reference = {int(str(trajectory)): its.to_numpy() for trajectory, its in shown}
    where = ["participant", "experiment", "arm", "trial", "trajectory", "bent_by"]
    joints = {each.name: each.joint for each in cfg.exoskeleton.muscles}
    window = speed_samples(cfg.exoskeleton.sampling_rate_hz)
    bending = Bending.read(references, joints, cfg.exoskeleton.samples, window)
    rate_hz, longest_s = cfg.exoskeleton.sampling_rate_hz, cfg.tracking_delay.longest_s
    for key, its in recordings[recordings["muscle"] == muscle].groupby(where, sort=False):
        *trial, trajectory, bent_by = key
        due, change = reference[int(str(trajectory))], read_changes(str(bent_by)).get(joint)
        due = due if change is None else bending.bend_angle(joint, due, change)
        count = min(len(its), len(due))
        followed = its["joint_angle_rad"].to_numpy()[:count]
        delay_s = find_delay(due[:count], followed, rate_hz, longest_s)
        late_s = (its["reference_shown_s"] - its["time_s"]).dropna()
        display_s = float(np.median(late_s)) if len(late_s) else float("nan")
        yield (*trial, joint, delay_s, display_s, delay_s - display_s)
