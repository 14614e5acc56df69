"""Whether it matters when a participant is early or late: Algorithm 1 over recordings, its samples shifted in time.

In: `candidates`, `bank`, `hyperprior`, `scaling` and, where the workflow has it, `unseen_bank`. Out: `shift_curve` and
`shift_comparison`. Where a trial's most informative sample at t would be taken, the recorded state and force at t + d
are taken together, d uniform between plus and minus an amplitude (paper, section 5.3). Experiments with and without
shift share initial trials, searches and the random numbers behind d, and no rig is run.
"""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Self

import pandas as pd
from pydantic import Field, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.learning_curves import draw_shift_curves
from stages.science.muscle_models.error_rates import ForceTest, average_muscles, summarise_error_rates
from stages.science.muscle_models.inputs import MeasuredInputs
from stages.science.muscle_models.loop_settings import LoopSettings, Movements
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.replay import Replay
from stages.science.muscle_models.samples import list_tests
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.statistics.equivalence import judge_paired_equivalence
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_with_equivalence, list_verdicts

NO_SHIFT = 0.0

TESTED_ON = column(str, "recordings that errors are measured on", among=["bank", "unseen_bank"])
SHIFT_CURVE = Table(
    "shift_curve",
    "Error of one muscle's model after one trial of a replayed experiment, with or without a time shift",
    {
        "amplitude_s": column(float, "largest shift of the samples taken; 0 = none", unit="s", low=0),
        "experiment": column(int, "replayed experiment", low=1),
        "trial": column(int, "trials learned from; 0 = initial data alone", low=0),
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", low=0),
    },
    key=("amplitude_s", "experiment", "trial", "tested_on", "muscle"),
)
SHIFT_COMPARISON = Table(
    "shift_comparison",
    "With a time shift against without, paired over experiments: mean error rate of muscles, positive = shift worse",
    {
        "amplitude_s": column(float, "largest shift of the samples taken", unit="s", low=0),
        "tested_on": TESTED_ON,
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last"),
        "n": column(int, "experiments", low=1),
        "before": column(float, "mean error rate of the initial data alone", low=0),
        "without_mean": column(float, "error rate without shift", low=0),
        "with_mean": column(float, "error rate with it", low=0),
        "difference": column(float, "with minus without"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "d_z": column(float, "effect size: difference over the SD of differences", nullable=True),
        "wins": column(int, "experiments in which the shift is better", low=0),
        "p_t": column(float, "two-sided paired t-test", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test", low=0, high=1, nullable=True),
        "p_holm": column(float, "p_t adjusted by Holm over the rows", low=0, high=1, nullable=True),
        "margin": column(float, "largest difference of error rates that does not matter", low=0),
        "p_tost": column(float, "two one-sided paired tests of equivalence", low=0, high=1, nullable=True),
        "power": column(float, "of that test, were the true difference zero", low=0, high=1, nullable=True),
        "n_needed": column(float, "experiments for a power of 0.8", low=2, nullable=True),
        "verdict": column(
            str,
            f"worse or better at p_holm below {LEVEL}, equivalent at p_tost below {LEVEL}, within the margin = both",
            among=list_verdicts("worse", "better", " with shift"),
        ),
    },
    key=("amplitude_s", "tested_on", "measure"),
    brief=("amplitude_s", "tested_on", "measure", "n", "difference", "low", "high", "power", "verdict"),
)


class TimeShift(Section):
    """Config group ``time_shift``."""

    amplitudes_s: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=1)]
    experiments: Annotated[int, Field(ge=1, le=1000)]
    margin: Annotated[float, Field(gt=0, le=1)]
    loop: LoopSettings

    @model_validator(mode="after")
    def _order_amplitudes(self) -> Self:
        ordered = sorted(set(self.amplitudes_s))
        if self.amplitudes_s != ordered:
            raise ValueError(
                f"amplitudes_s: expected each once, the smallest first, got {self.amplitudes_s}; "
                f"set time_shift.amplitudes_s={ordered}"
            )
        return self


class TrialsEnough(View):
    """The bank holds the movements of every trial, and trials the shifts."""

    model: MeasuredInputs
    bank: Movements
    exoskeleton: Exoskeleton
    time_shift: TimeShift

    @model_validator(mode="after")
    def _fit(self) -> Self:
        self.time_shift.loop.check_against("time_shift", self.bank.trajectories, self.exoskeleton.samples)
        amplitudes_s, sample_s = self.time_shift.amplitudes_s, 1 / self.exoskeleton.sampling_rate_hz
        if amplitudes_s[0] < sample_s or amplitudes_s[-1] > self.exoskeleton.trial_s:
            raise ValueError(
                f"time_shift.amplitudes_s: expected values from one sample, {sample_s:g} s, to a trial, "
                f"{self.exoskeleton.trial_s:g} s, got {amplitudes_s}"
            )
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (TrialsEnough,)

    time_shift: TimeShift
    seed: int


@stage(SHIFT_CURVE, SHIFT_COMPARISON, stream="time_shift")
def time_shift(
    cfg: Config,
    candidates: pd.DataFrame,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Replay experiments with and without time shifts and compare their errors."""
    section = cfg.time_shift
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    banks = list_tests({"bank": bank, "unseen_bank": unseen_bank})
    tests = [ForceTest.read(name, frame, muscles) for name, frame in banks.items()]
    replay = partial(replay_experiment, section, ctx, Replay.read(muscles, banks["bank"]), tests)
    jobs = {f"experiment {each}": (each,) for each in range(1, section.experiments + 1)}
    curve = ctx.land_each("experiments", replay, jobs)[SHIFT_CURVE.name]
    curve = curve.sort_values(["amplitude_s", "experiment", "trial"], kind="stable", ignore_index=True)
    caption = (
        "Error rate averaged over muscles after each trial, where the samples taken are shifted in time by up to so "
        f"much, on each set of recordings: mean and SD over {section.experiments} replayed experiments."
    )
    ctx.figure("time_shift", draw_shift_curves(summarise(curve)), caption)
    return curve, compare_shifts(curve, section.margin)


def replay_experiment(
    section: TimeShift, ctx: Context, replay: Replay, tests: Sequence[ForceTest], experiment: int
) -> dict[str, pd.DataFrame]:
    """Replay one experiment without shift and with each."""
    generator = partial(ctx.generator, "experiment", experiment)
    muscles, loop = replay.muscles, section.loop
    initial = generator("initial").choice(len(muscles.trajectories), loop.initial_trials, replace=False).tolist()
    rows: list[tuple[Any, ...]] = []
    for amplitude_s in (NO_SHIFT, *section.amplitudes_s):
        for trial, interaction in enumerate(replay.run(loop, muscles.priors, initial, generator, amplitude_s)):
            for test in tests:
                rates = test.error_rates(interaction.models)
                rows += [
                    (amplitude_s, experiment, trial, test.name, name, rate * largest, rate)
                    for name, rate, largest in zip(muscles.names, rates, test.largest_n, strict=True)
                ]
    return {SHIFT_CURVE.name: pd.DataFrame(rows, columns=list(SHIFT_CURVE.columns))}


def summarise(curve: pd.DataFrame) -> pd.DataFrame:
    """Return mean and SD over experiments of the error rate averaged over muscles."""
    return summarise_error_rates(average_muscles(curve), ["tested_on", "amplitude_s", "trial"])


def compare_shifts(curve: pd.DataFrame, margin: float) -> pd.DataFrame:
    """Return the rows of `shift_comparison`."""
    table = average_muscles(curve).pivot_table(
        index="experiment", columns=["tested_on", "amplitude_s", "trial"], values="error_rate"
    )
    rows = []
    for amplitude_s in (each for each in curve["amplitude_s"].unique() if each != NO_SHIFT):
        for tested_on in curve["tested_on"].unique():
            without, shifted = table[tested_on][NO_SHIFT], table[tested_on][amplitude_s]
            before = float(without[0].mean())
            pairs = {
                "final": [each.iloc[:, -1].to_numpy() for each in (shifted, without)],
                "curve": [each.drop(columns=0).to_numpy().mean(axis=1) for each in (shifted, without)],
            }
            for measure, (ours, theirs) in pairs.items():
                where = {"amplitude_s": amplitude_s, "tested_on": tested_on, "measure": measure, "before": before}
                compared = compare_pairs(ours, theirs).tabulate("with", "without")
                rows.append(where | compared | vars(judge_paired_equivalence(ours, theirs, margin)))
    frame = judge_with_equivalence(pd.DataFrame(rows), "p_t", "better", "worse", ending=" with shift")
    return frame[list(SHIFT_COMPARISON.columns)]
