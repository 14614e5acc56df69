"""Learning curves of every arm on the bank's forces, and paired tests of the design against each control.

In: `bank` (the test set, with force), `hyperprior`, `scaling`, `models`, `points`. Out: `learning_curve`,
`learning_summary`, `final_errors`, `paired_comparison`. This stage only reads: it chooses and measures nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.figures import draw_learning_curves
from stages.gp import Hyperprior, condition
from stages.signals import Scaling, error_rate
from stages.statistics import adjust_holm, compare_pairs

Array = NDArray[np.float64]

CONSTANT_MEAN = "constant_mean"
ALL_MUSCLES = "mean"
LEVEL = 0.05

LEARNING_CURVE = Table(
    "learning_curve",
    "Error of one muscle's model after one trial, over every sample of the bank",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "arm": column(str, "how trajectories were chosen"),
        "trial": column(int, "trials learned from; 0 = initial data alone", low=0),
        "muscle": column(str, "muscle"),
        "rmse_n": column(float, "root mean square error of the force", unit="N", low=0),
        "error_rate": column(float, "the same over the largest force of the test data", low=0),
    },
    key=("participant", "experiment", "arm", "trial", "muscle"),
)
LEARNING_SUMMARY = Table(
    "learning_summary",
    "Error rate after each trial over the experiments",
    {
        "arm": column(str, "how trajectories were chosen"),
        "trial": column(int, "trials learned from", low=0),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "error_rate_mean": column(float, "mean over experiments", low=0),
        "error_rate_sd": column(float, "standard deviation over experiments", low=0, nullable=True),
        "experiments": column(int, "how many", low=1),
    },
    key=("arm", "trial", "muscle"),
)
FINAL_ERRORS = Table(
    "final_errors",
    "Error rate before and after the designed trials (RMSE / largest test force; mean and SD over experiments)",
    {
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "arm": column(str, "how trajectories were chosen"),
        "before": column(float, "mean error rate of the initial data alone", low=0),
        "after": column(float, "mean error rate after the last trial", low=0),
        "after_sd": column(float, "standard deviation of the latter over experiments", low=0, nullable=True),
        "experiments": column(int, "how many", low=1),
    },
    key=("muscle", "arm"),
)
PAIRED_COMPARISON = Table(
    "paired_comparison",
    "The design against each control, paired over experiments: mean error rate of muscles, negative = design better",
    {
        "measure": column(str, "final: after the last trial; curve: averaged over trials 1 to the last"),
        "design": column(str, "arm"),
        "control": column(str, "arm"),
        "n": column(int, "experiments", low=1),
        "design_mean": column(float, "error rate", low=0),
        "control_mean": column(float, "error rate", low=0),
        "difference": column(float, "design minus control"),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "d_z": column(float, "effect size: difference over the SD of differences", nullable=True),
        "wins": column(int, "experiments in which the design is better", low=0),
        "p_t": column(float, "two-sided paired t-test", low=0, high=1, nullable=True),
        "p_wilcoxon": column(float, "two-sided Wilcoxon signed-rank test", low=0, high=1, nullable=True),
        "p_holm": column(float, "p_t adjusted by Holm over the rows", low=0, high=1, nullable=True),
        "verdict": column(str, f"at p_holm below {LEVEL}", among=["design better", "control better", "undecided"]),
    },
    key=("measure", "design", "control"),
    brief=("measure", "control", "n", "difference", "low", "high", "verdict"),
)


class Config(Section):
    """What this stage reads: tables alone."""


@stage(LEARNING_CURVE, LEARNING_SUMMARY, FINAL_ERRORS, PAIRED_COMPARISON)
def comparison(
    cfg: Config,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
    ctx: Context,
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Draw the learning curves of every arm and test the design against each control."""
    curves: list[tuple[Any, ...]] = []
    muscles = list(hyperprior["muscle"].unique())
    with ctx.progress("muscles", len(muscles)) as advance:
        for muscle in muscles:
            curves += measure_errors(muscle, bank, hyperprior, scaling, models, points)
            advance(muscle)
    order = {name: position for position, name in enumerate(models["arm"].unique())}
    curve = pd.DataFrame(curves, columns=list(LEARNING_CURVE.columns))
    curve = curve.sort_values(
        ["participant", "experiment", "arm", "trial", "muscle"],
        key=lambda values: values.map(order) if values.name == "arm" else values,
        ignore_index=True,
    )
    summary = summarise(curve, list(order), muscles)
    caption = (
        "Error rate (RMSE over the largest force of the test data) after each trial, for every muscle and their "
        f"average: mean and standard deviation over {summary['experiments'].max()} experiments. "
        "Trial 0 is the initial data, the same for every arm."
    )
    ctx.figure("learning_curve", draw_learning_curves(summary, list(order), [ALL_MUSCLES, *muscles]), caption)
    return curve, summary, tell_final_errors(summary, list(order), muscles), pair_arms(curve, list(order))


def measure_errors(
    muscle: str,
    bank: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of `learning_curve` of one muscle."""
    rows = hyperprior[hyperprior["muscle"] == muscle]
    prior = Hyperprior(rows["mean"].to_numpy(), rows["variance"].to_numpy())
    mean = "constant" if CONSTANT_MEAN in set(rows["hyperparameter"]) else "zero"
    constants = Scaling.of_muscle(scaling, muscle)
    test = bank[bank["muscle"] == muscle]
    test_inputs = constants.inputs_of(test)
    test_force = test["force_n"].to_numpy()
    largest = float(test_force.max())
    its_points = points[points["muscle"] == muscle]
    its_models = models[models["muscle"] == muscle]
    loops = ["participant", "experiment", "arm"]
    points_of = dict(list(its_points.groupby(loops, sort=False)))
    for (*loop, trial), model in its_models.groupby([*loops, "trial"], sort=False):
        known = points_of[tuple(loop)]
        known = known[known["trial"] <= trial]
        inputs, force = constants.inputs_of(known), constants.output_of(known)
        gp = condition(inputs, force, model["value"].to_numpy(), prior, mean=mean)
        predicted = constants.restore_force(gp.predict_mean(test_inputs))
        rate = error_rate(predicted, test_force)
        yield (*loop, trial, muscle, rate * largest, rate)


def summarise(curve: pd.DataFrame, arms: Sequence[str], muscles: Sequence[str]) -> pd.DataFrame:
    """Return mean and SD over experiments, for each muscle and for their average."""
    average = average_muscles(curve).assign(muscle=ALL_MUSCLES)
    rows = pd.concat([curve, average], ignore_index=True)
    grouped = rows.groupby(["arm", "trial", "muscle"])["error_rate"].agg(["mean", "std", "count"])
    keys = [
        (arm, trial, muscle)
        for arm in arms
        for trial in sorted(curve["trial"].unique())
        for muscle in [*muscles, ALL_MUSCLES]
    ]
    ordered = grouped.loc[keys].reset_index()
    ordered.columns = pd.Index(LEARNING_SUMMARY.columns)
    return ordered


def average_muscles(curve: pd.DataFrame) -> pd.DataFrame:
    """Return the error rate averaged over muscles."""
    return curve.groupby(["participant", "experiment", "arm", "trial"], sort=False)["error_rate"].mean().reset_index()


def tell_final_errors(summary: pd.DataFrame, arms: Sequence[str], muscles: Sequence[str]) -> pd.DataFrame:
    """Return the rows of `final_errors`."""
    before = summary[summary["trial"] == 0].set_index(["muscle", "arm"])
    after = summary[summary["trial"] == summary["trial"].max()].set_index(["muscle", "arm"])
    found = pd.DataFrame(
        {
            "before": before["error_rate_mean"],
            "after": after["error_rate_mean"],
            "after_sd": after["error_rate_sd"],
            "experiments": after["experiments"],
        }
    )
    keys = [(muscle, arm) for muscle in [*muscles, ALL_MUSCLES] for arm in arms]
    return found.loc[keys].reset_index()


def pair_arms(curve: pd.DataFrame, arms: Sequence[str]) -> pd.DataFrame:
    """Return the rows of `paired_comparison`: the first arm against each other one."""
    table = average_muscles(curve).pivot_table(
        index=["participant", "experiment"], columns=["arm", "trial"], values="error_rate"
    )
    last = curve["trial"].max()
    measures = {
        "final": {arm: table[arm][last].to_numpy() for arm in arms},
        "curve": {arm: table[arm].drop(columns=0).to_numpy().mean(axis=1) for arm in arms},
    }
    design, controls = arms[0], arms[1:]
    rows = []
    for measure, values in measures.items():
        for control in controls:
            told = compare_pairs(values[design], values[control])
            rows.append(
                (
                    measure,
                    design,
                    control,
                    told.n,
                    told.mean_first,
                    told.mean_second,
                    told.difference,
                    told.low,
                    told.high,
                    told.effect_size,
                    told.wins,
                    told.t_p_value,
                    told.wilcoxon_p_value,
                )
            )
    frame = pd.DataFrame(rows, columns=list(PAIRED_COMPARISON.columns)[:-2])
    adjusted = adjust_holm(frame["p_t"].to_numpy(dtype=float))
    better = np.where(frame["difference"] < 0, "design better", "control better")
    return frame.assign(p_holm=adjusted, verdict=np.where(adjusted < LEVEL, better, "undecided"))
