"""Further trials of a session that a rig recorded, each chosen to tell the leading names apart.

In: the session. Out: `further_recordings`, and `further_trials`: what each was chosen for, and how probable the leading
name was before it. Each is recorded, searched with all that there is, and the next chosen; they are all fitted.
"""

from typing import Annotated

import pandas as pd
from pydantic import Field

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.further_trial import choose_next, drive
from stages.science.discrepancy.parts import Parts
from stages.science.discrepancy.proposal import ProposalSettings
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.plant.plant import Plant
from stages.science.recording.blocks import PROPOSED, WHOLE
from stages.science.recording.datasets import list_trials
from stages.science.recording.measured_tables import MeasuredTables
from stages.science.recording.muscles import MUSCLE_COLUMNS
from stages.science.rig.contract import MEASUREMENT_COLUMNS

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
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Search, choose a trial, record it, and search again."""
    recorded, rows = session_recordings.assign(part=WHOLE), []
    with ctx.progress("further trials", cfg.next_trials) as advance:
        for taken in range(cfg.next_trials):
            settings = cfg.parts, cfg.discrepancy, cfg.propose_trial
            generators = ctx.generator("trials", taken), ctx.generator("unexplained", taken)
            known = choose_next(cfg.plant, list_tables(recorded, session_machine), *settings, *generators)
            weighed = known.weighed
            if weighed is None or known.question is None:
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
                    "rivals": ",".join(known.question.rivals),
                    "probability": known.question.leading,
                    "expected_before": weighed.expected_now,
                    "expected_after": weighed.probability[chosen],
                    "evidence": weighed.mean_evidence[chosen],
                }
            )
            advance(weighed.spell(chosen))
    kept = recorded.loc[recorded["part"] == PROPOSED, list(FURTHER_RECORDINGS.columns)]
    return kept, pd.DataFrame(rows, columns=list(FURTHER_TRIALS.columns))


def list_tables(recorded: pd.DataFrame, machine: pd.DataFrame) -> MeasuredTables:
    """Return what was recorded so far as a dataset."""
    told = machine.iloc[0]
    trials = list_trials(recorded, float(told["sampling_rate_hz"]))
    own = recorded.groupby("trial")[["part", "start_s"]].first()
    trials = trials.assign(part=trials["trial"].map(own["part"]), start_s=trials["trial"].map(own["start_s"]))
    session = machine[["load_cell_site", "sampling_rate_hz", "timing"]].head(1).assign(source="session", kind="muscles")
    return MeasuredTables(recorded, pd.DataFrame(columns=["signal"]), trials, machine[list(MUSCLE_COLUMNS)], session)
