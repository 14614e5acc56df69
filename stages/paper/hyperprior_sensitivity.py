"""Whether the hyperpriors of Table 1 matter: Algorithm 1 over recordings, under other means and smaller variances.

In: `candidates`, `bank`, `hyperprior`, `scaling` and, where the workflow has it, `unseen_bank`. Out:
`sensitivity_hyperpriors` (what was set), `sensitivity_errors` and `sensitivity_comparison` (paper, section 6.1). Every
experiment under sampled means draws means and initial trials of its own, so that its group is independent of Table 1's
(Welch). Experiments under smaller variances share initial trials and searches with those under Table 1 (Wilcoxon).
Beside each test of a difference stands one of equivalence for a stated margin, with its power. No rig is run.
"""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from pipeline.config import Section, View
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.experiments import draw_sensitivity
from stages.science.gp.hyperprior import Hyperprior
from stages.science.muscle_models.error_rates import ALL_MUSCLES, ForceTest, average_muscles
from stages.science.muscle_models.inputs import MeasuredInputs
from stages.science.muscle_models.loop_settings import LoopSettings, Movements
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.muscle_models.replay import Replay
from stages.science.muscle_models.samples import list_tests
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.signals.scaling import Array
from stages.science.statistics.equivalence import judge_equivalence, judge_paired_equivalence
from stages.science.statistics.groups import compare_groups
from stages.science.statistics.signed_rank import compare_ranks
from stages.science.statistics.verdicts import LEVEL, judge_with_equivalence

TABLE_1, MEAN, VARIANCE = "table_1", "mean", "variance"

SETTING = {
    "kind": column(
        str, "what differs from Table 1: nothing, the means or the variances", among=[TABLE_1, MEAN, VARIANCE]
    ),
    "setting": column(
        float, "SD of the sampled means in Table 1's SDs, or factor on its variances; Table 1 itself: 1", low=0
    ),
}
TESTED_ON = column(str, "recordings that errors are measured on", among=["bank", "unseen_bank"])
EXPERIMENT = column(int, "replayed experiment; variances share it with Table 1", low=1)
SENSITIVITY_HYPERPRIORS = Table(
    "sensitivity_hyperpriors",
    "Gaussian hyperprior of one hyperparameter of one muscle in a replayed experiment",
    {
        **SETTING,
        "experiment": EXPERIMENT,
        "muscle": column(str, "muscle"),
        "hyperparameter": column(str, "as in hyperprior"),
        "mean": column(float, "mean of the hyperparameter, in the unit that hyperprior names"),
        "variance": column(float, "variance of the hyperparameter, in its square", low=0),
    },
    key=("kind", "setting", "experiment", "muscle", "hyperparameter"),
)
SENSITIVITY_ERRORS = Table(
    "sensitivity_errors",
    "Error rate (RMSE / largest test force) of one muscle's model in a replayed experiment under a hyperprior",
    {
        **SETTING,
        "experiment": EXPERIMENT,
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle"),
        "before": column(float, "error rate of the initial data alone", low=0),
        "after": column(float, "error rate after the last trial", low=0),
    },
    key=("kind", "setting", "experiment", "tested_on", "muscle"),
)
SENSITIVITY_COMPARISON = Table(
    "sensitivity_comparison",
    "Error rate after the last trial under another hyperprior against Table 1's, positive = Table 1 better",
    {
        **SETTING,
        "tested_on": TESTED_ON,
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "n": column(int, "experiments under the other hyperprior", low=1),
        "n_table_1": column(int, "experiments under Table 1, the same ones where variances differ", low=1),
        "before": column(float, "mean error rate of the initial data alone under the other hyperprior", low=0),
        "mean": column(float, "error rate under the other hyperprior", low=0),
        "table_1_mean": column(float, "error rate under Table 1", low=0),
        "difference": column(float, "the former minus the latter"),
        "hodges_lehmann": column(float, "median of the averages of any two paired differences", nullable=True),
        "low": column(
            float, "lower end of the 95 % interval: Welch's of difference, or that of hodges_lehmann", nullable=True
        ),
        "high": column(float, "upper end of it", nullable=True),
        "hedges_g": column(float, "effect size of groups", nullable=True),
        "rank_biserial": column(float, "effect size of pairs, -1 to 1", low=-1, high=1, nullable=True),
        "p_welch": column(float, "two-sided Welch's t-test of groups", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test of pairs", low=0, high=1, nullable=True),
        "p_holm": column(
            float,
            "the one that there is, adjusted by Holm over the muscles and their average",
            low=0,
            high=1,
            nullable=True,
        ),
        "margin": column(float, "largest difference of error rates that does not matter", low=0),
        "p_tost": column(float, "two one-sided tests of equivalence, of groups or pairs", low=0, high=1, nullable=True),
        "power": column(float, "of that test, were the true difference zero", low=0, high=1, nullable=True),
        "n_needed": column(float, "experiments of each for a power of 0.8", low=2, nullable=True),
        "verdict": column(
            str,
            f"sensitive at p_holm below {LEVEL}, insensitive at p_tost below {LEVEL}, both, or neither",
            among=["sensitive", "insensitive", "sensitive within the margin", "undecided"],
        ),
    },
    key=("kind", "setting", "tested_on", "muscle"),
    brief=("kind", "setting", "tested_on", "muscle", "difference", "low", "high", "p_holm", "power", "verdict"),
)


class HyperpriorSensitivity(Section):
    """Config group ``hyperprior_sensitivity``.

    Means are drawn within what standard units make sense of: Table 1's SDs are of order one, and log 10^4 is 9.2.
    """

    mean_shifts: Annotated[list[Annotated[float, Field(gt=0, le=5)]], Field(min_length=1)]
    variance_factors: Annotated[list[Annotated[float, Field(ge=1e-4, lt=1)]], Field(min_length=1)]
    experiments: Annotated[int, Field(ge=1, le=1000)]
    margin: Annotated[float, Field(gt=0, le=1)]
    loop: LoopSettings

    @model_validator(mode="after")
    def _set_each_once(self) -> Self:
        for name, values in (("mean_shifts", self.mean_shifts), ("variance_factors", self.variance_factors)):
            if len(set(values)) < len(values):
                raise ValueError(
                    f"{name}: expected each value once, got {values}; "
                    f"set hyperprior_sensitivity.{name}={list(dict.fromkeys(values))}"
                )
        return self

    @property
    def settings(self) -> list[tuple[str, float]]:
        """Kind and value of every setting, Table 1's first."""
        means, variances = [(MEAN, each) for each in self.mean_shifts], self.variance_factors
        return [(TABLE_1, 1.0), *means, *((VARIANCE, each) for each in variances)]


class MovementsEnough(View):
    """The bank holds the movements of every trial."""

    model: MeasuredInputs
    bank: Movements
    exoskeleton: Exoskeleton
    hyperprior_sensitivity: HyperpriorSensitivity

    @model_validator(mode="after")
    def _find_movements(self) -> Self:
        loop = self.hyperprior_sensitivity.loop
        loop.check_against("hyperprior_sensitivity", self.bank.trajectories, self.exoskeleton.samples)
        return self


class Config(Section):
    """What this stage reads."""

    checks: ClassVar = (MovementsEnough,)

    hyperprior_sensitivity: HyperpriorSensitivity
    seed: int


@stage(SENSITIVITY_HYPERPRIORS, SENSITIVITY_ERRORS, SENSITIVITY_COMPARISON, stream="hyperprior_sensitivity")
def hyperprior_sensitivity(
    cfg: Config,
    candidates: pd.DataFrame,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    ctx: Context,
    unseen_bank: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Replay experiments under Table 1 and other hyperpriors and compare their errors."""
    section = cfg.hyperprior_sensitivity
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    banks = list_tests({"bank": bank, "unseen_bank": unseen_bank})
    tests = [ForceTest.read(name, frame, muscles) for name, frame in banks.items()]
    replay = partial(replay_experiment, section, ctx, Replay.read(muscles, banks["bank"]), tests)
    jobs = {f"experiment {each}": (each,) for each in range(1, section.experiments + 1)}
    tables = ctx.land_each("experiments", replay, jobs)
    priors, errors = (  # setting by setting; parts are those of experiments
        pd.concat([rows for _, rows in tables[table.name].groupby(list(SETTING), sort=False)], ignore_index=True)
        for table in (SENSITIVITY_HYPERPRIORS, SENSITIVITY_ERRORS)
    )
    errors_and_average = add_average(errors)
    average = errors_and_average[errors_and_average["muscle"] == ALL_MUSCLES]
    words = {TABLE_1: "Table 1", MEAN: "means drawn\nwith {:g} SD", VARIANCE: "variances\n×{:g}"}
    labels = {(kind, setting): words[kind].format(setting) for kind, setting in section.settings}
    caption = (
        "Error rate averaged over muscles after the last trial under each hyperprior, for every one of "
        f"{section.experiments} replayed experiments, with the mean after and before the trials."
    )
    ctx.figure("hyperprior_sensitivity", draw_sensitivity(average, labels), caption)
    return priors, errors, compare_settings(errors_and_average, section.margin)


def replay_experiment(
    section: HyperpriorSensitivity, ctx: Context, replay: Replay, tests: Sequence[ForceTest], experiment: int
) -> dict[str, pd.DataFrame]:
    """Replay one experiment under every setting."""
    muscles, loop = replay.muscles, section.loop
    set_out, errors = [], []
    for kind, setting in section.settings:
        where = kind, setting, experiment
        group = (MEAN, f"{setting:g}") if kind == MEAN else (TABLE_1,)
        generator = partial(ctx.generator, *group, experiment)
        priors = [
            change_prior(prior, kind, setting, generator("means", name))
            for name, prior in zip(muscles.names, muscles.priors, strict=True)
        ]
        for name, prior in zip(muscles.names, priors, strict=True):
            values = zip(muscles.hyperparameters, prior.mean, prior.variance, strict=True)
            set_out += [(*where, name, *each) for each in values]
        initial = generator("initial").choice(len(muscles.trajectories), loop.initial_trials, replace=False)
        known = list(replay.run(loop, priors, initial.tolist(), generator))
        for test in tests:
            before, after = (test.error_rates(each.models) for each in (known[0], known[-1]))
            errors += [(*where, test.name, *each) for each in zip(muscles.names, before, after, strict=True)]
    return {
        SENSITIVITY_HYPERPRIORS.name: pd.DataFrame(set_out, columns=list(SENSITIVITY_HYPERPRIORS.columns)),
        SENSITIVITY_ERRORS.name: pd.DataFrame(errors, columns=list(SENSITIVITY_ERRORS.columns)),
    }


def change_prior(prior: Hyperprior, kind: str, setting: float, generator: np.random.Generator) -> Hyperprior:
    """Return Table 1's prior, one around means drawn near its own, or one of smaller variances."""
    if kind == MEAN:
        around = Hyperprior(prior.mean, setting**2 * prior.variance)
        return Hyperprior(around.draw(1, generator)[0], prior.variance)
    return Hyperprior(prior.mean, setting * prior.variance) if kind == VARIANCE else prior


def add_average(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the errors with rows of the average over muscles."""
    average = average_muscles(errors, ["before", "after"])
    return pd.concat([average[list(errors.columns)], errors], ignore_index=True)


def compare_settings(errors: pd.DataFrame, margin: float) -> pd.DataFrame:
    """Return the rows of `sensitivity_comparison` from errors with their average over muscles."""
    families = []
    of_table_1 = dict(list(errors[errors["kind"] == TABLE_1].groupby(["tested_on", "muscle"])))
    for (kind, setting), its in errors[errors["kind"] != TABLE_1].groupby(list(SETTING), sort=False):
        for tested_on, tested in its.groupby("tested_on", sort=False):
            compare, p = (compare_means, "p_welch") if kind == MEAN else (compare_variances, "p_wilcoxon")
            rows = []
            for muscle, changed in tested.groupby("muscle", sort=False):
                where = {"kind": kind, "setting": setting, "tested_on": tested_on, "muscle": muscle}
                own = of_table_1[(tested_on, muscle)]
                after, expected = (each.sort_values("experiment")["after"].to_numpy() for each in (changed, own))
                rows.append({**where, "before": changed["before"].mean(), **compare(after, expected, margin)})
            family = judge_with_equivalence(pd.DataFrame(rows), p, "sensitive", "sensitive", equivalent="insensitive")
            families.append(family)
    return pd.concat(families, ignore_index=True)[list(SENSITIVITY_COMPARISON.columns)]


def compare_means(changed: Array, table_1: Array, margin: float) -> dict[str, Any]:
    """Return what independent groups of error rates say, (n,) and (m,)."""
    told = compare_groups(changed, table_1)
    row = {"n": told.n_first, "n_table_1": told.n_second, "mean": told.first_mean, "table_1_mean": told.second_mean}
    none = dict.fromkeys(("hodges_lehmann", "rank_biserial", "p_wilcoxon"), np.nan)
    return row | none | vars(told) | vars(judge_equivalence(changed, table_1, margin))


def compare_variances(changed: Array, table_1: Array, margin: float) -> dict[str, Any]:
    """Return what paired error rates say, (n,) each."""
    told = compare_ranks(changed, table_1)
    row = {"n_table_1": told.n, "mean": float(changed.mean()), "table_1_mean": float(table_1.mean())}
    row |= {"difference": float((changed - table_1).mean()), "hedges_g": np.nan, "p_welch": np.nan}
    return row | vars(told) | vars(judge_paired_equivalence(changed, table_1, margin))
