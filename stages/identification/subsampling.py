"""Thins the bank to what the interaction design may see, and draws the initial trials of each experiment.

In: `bank`. Out: `candidates` (thinned, without force), `references` (what a trial replays) and `initial_trials`.
"""

from typing import ClassVar, Self

import pandas as pd
from pydantic import Field, PositiveInt, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.errors import ConfigError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.muscle_models.inputs import ModelSettings, describe_features
from stages.science.muscle_models.loop_settings import Movements
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.participant import Participant
from stages.science.rig.contract import MEASUREMENT_COLUMNS, MOST_ROWS
from stages.science.signals.lead_in import leave_out_lead_in
from stages.science.signals.scaling import MODEL_INPUTS

TRAJECTORY = column(int, "movement of the bank", low=0)
CANDIDATES = Table(
    "candidates",
    "A sample of a bank movement as the models' input, without force",
    {
        "trajectory": TRAJECTORY,
        **{name: MEASUREMENT_COLUMNS[name] for name in ("time_s", "muscle", *MODEL_INPUTS)},
        **describe_features(),
    },
    key=("trajectory", "muscle", "time_s"),
)
REFERENCES = Table(
    "references",
    "A sample of what a trial displays to the person (joint angle) and plays on the robot (pressure command)",
    {
        "trajectory": TRAJECTORY,
        **{name: MEASUREMENT_COLUMNS[name] for name in ("time_s", "muscle", "pressure_command_kpa", "joint_angle_rad")},
    },
    key=("trajectory", "muscle", "time_s"),
)
INITIAL_TRIALS = Table(
    "initial_trials",
    "A trial that gives an experiment its initial data, the same for every arm",
    {
        "participant": column(str, "who tracks"),
        "experiment": column(int, "experiment of this participant", low=1),
        "position": column(int, "order of execution", low=1),
        "trajectory": TRAJECTORY,
    },
    key=("participant", "experiment", "position"),
)


class Subsampling(Section):
    """Config group ``subsampling``."""

    every: PositiveInt
    experiments: PositiveInt
    initial_trials: PositiveInt


class TrialsFit(View):
    """The bank holds the initial trials, thinning leaves a movement, and the recordings fit in memory."""

    bank: Movements
    subsampling: Subsampling
    participants: dict[str, Participant]
    exoskeleton: Exoskeleton

    @model_validator(mode="after")
    def _fit(self) -> Self:
        section, samples = self.subsampling, self.exoskeleton.samples
        check_initial_trials(section.initial_trials, self.bank.trajectories)
        if section.every >= samples:
            raise ValueError(
                f"subsampling.every: expected less than the {samples} samples of a trial, so that a trajectory keeps "
                f"more than one, got {section.every}; lower it or raise exoskeleton.trial_s or "
                "exoskeleton.sampling_rate_hz"
            )
        rows = samples * len(self.exoskeleton.muscles) * section.initial_trials
        most = MOST_ROWS // (rows * len(self.participants))
        if section.experiments > most:
            raise ValueError(
                f"subsampling.experiments: expected at most {most} for each participant, as {MOST_ROWS} rows of "
                f"recordings of the initial trials still fit in memory, got {section.experiments}; lower it, "
                "subsampling.initial_trials, exoskeleton.trial_s or exoskeleton.sampling_rate_hz"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (TrialsFit,)

    subsampling: Subsampling
    model: ModelSettings
    participants: dict[str, Participant] = Field(min_length=1)
    seed: int


@stage(CANDIDATES, REFERENCES, INITIAL_TRIALS, stream="subsampling")
def subsampling(cfg: Config, bank: pd.DataFrame, ctx: Context) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Thin the bank to candidates without force and draw each experiment's initial trials."""
    known = leave_out_lead_in(cfg.model.extend(bank, ["trajectory"]))
    rank = known.groupby(["trajectory", "muscle"], sort=False).cumcount()
    candidates = CANDIDATES.select(known[rank % cfg.subsampling.every == 0])
    trajectories, count = [int(each) for each in bank["trajectory"].unique()], cfg.subsampling.initial_trials
    check_initial_trials(count, len(trajectories))
    rows = []
    for participant in cfg.participants:
        for experiment in range(1, cfg.subsampling.experiments + 1):
            drawn = ctx.generator(participant, experiment).choice(trajectories, size=count, replace=False)
            rows += [(participant, experiment, position, int(each)) for position, each in enumerate(drawn, start=1)]
    return candidates, known[list(REFERENCES.columns)], pd.DataFrame(rows, columns=list(INITIAL_TRIALS.columns))


def check_initial_trials(count: int, movements: int) -> None:
    """Refuse more initial trials than the bank has movements."""
    if count > movements:
        raise ConfigError(
            f"subsampling.initial_trials: expected at most the bank's {movements} movements, got {count}; "
            "lower it or raise bank.trajectories"
        )
