"""How well each utility ranks trajectories by what they tell, against mutual information by Monte Carlo.

In: `candidates`, `hyperprior`, `scaling`, `models`, `points`. Out: `utility_agreement`, for the design's models after
trials 0, the middle and the last, and `utility_summary`. The yardstick is I(y; theta) over draws of theta from the
Laplace approximation: of a trajectory's samples one by one, added up, and of all of them together. Nothing is executed.
"""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.experiments import draw_agreement
from stages.science.gp.marginal import condition
from stages.science.gp.mutual_information import Information, draw_models, path_information, point_information
from stages.science.gp.scoring import trajectory_utility
from stages.science.gp.utilities import UTILITIES
from stages.science.muscle_models.muscle_set import MuscleSet
from stages.science.signals.scaling import Array
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL, judge_differences

DESIGN = "y_y"
TRAJECTORY = "log_det"
RANDOM = "random"
CHOICES = (*UTILITIES, TRAJECTORY, RANDOM)
TARGETS = ("one by one", "together")

UTILITY = column(str, "what trajectories are ranked by; random: not at all", among=CHOICES)
TARGET = column(str, "what a trajectory's samples tell, added up one by one, or together", among=TARGETS)
UTILITY_AGREEMENT = Table(
    "utility_agreement",
    "A utility's scores of the bank's trajectories against Monte Carlo mutual information, for one set of models",
    {
        "participant": column(str, "who tracked"),
        "experiment": column(int, "experiment of this participant", low=1),
        "trial": column(int, "trials that the models learned from", low=0),
        "target": TARGET,
        "utility": UTILITY,
        "spearman": column(float, "rank correlation over trajectories; 0 for random", low=-1, high=1, nullable=True),
        "regret": column(
            float, "share of the best trajectory's information that the utility's choice forgoes", low=0, high=1
        ),
        "reliability": column(
            float,
            "of the yardstick itself: rank correlation of its two halves of draws, stepped up to all of them",
            low=-1,
            high=1,
            nullable=True,
        ),
        "information": column(float, "of the best trajectory, over all muscles", unit="nat"),
        "standard_error": column(float, "of that, over draws", unit="nat", low=0),
    },
    key=("participant", "experiment", "trial", "target", "utility"),
)
UTILITY_SUMMARY = Table(
    "utility_summary",
    "How well each utility agrees with Monte Carlo mutual information, over experiments, and against y_y",
    {
        "target": TARGET,
        "utility": UTILITY,
        "n": column(int, "experiments, each averaged over trials", low=1),
        "spearman": column(float, "mean rank correlation", low=-1, high=1, nullable=True),
        "spearman_low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "spearman_high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "reliability": column(
            float, "of the yardstick itself; a perfect utility's rank correlation is its root", nullable=True
        ),
        "regret": column(float, "mean share of information forgone", low=0, high=1),
        "difference": column(float, "regret less that of y_y", nullable=True),
        "low": column(float, "lower end of its 95 % interval (t)", nullable=True),
        "high": column(float, "upper end of its 95 % interval (t)", nullable=True),
        "d_z": column(float, "effect size", nullable=True),
        "p_holm": column(
            float, "paired t-test, adjusted by Holm over the rows of this target", low=0, high=1, nullable=True
        ),
        "verdict": column(
            str,
            f"at p_holm below {LEVEL}",
            among=["forgoes less than y_y", "forgoes more than y_y", "undecided", "the design"],
        ),
    },
    key=("target", "utility"),
    brief=("target", "utility", "n", "spearman", "regret", "difference", "low", "high", "p_holm", "verdict"),
)


class UtilityCheck(Section):
    """Config group ``utility_check``."""

    experiments: PositiveInt
    draws: Annotated[int, Field(ge=2, le=2000)]
    every: PositiveInt
    outputs: Annotated[int, Field(ge=1, le=1000)]


class Config(Section):
    """What this stage reads."""

    utility_check: UtilityCheck
    seed: int


@stage(UTILITY_AGREEMENT, UTILITY_SUMMARY, stream="utility_check")
def utility_check(
    cfg: Config,
    candidates: pd.DataFrame,
    hyperprior: pd.DataFrame,
    scaling: pd.DataFrame,
    models: pd.DataFrame,
    points: pd.DataFrame,
    ctx: Context,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Check every utility against Monte Carlo mutual information."""
    muscles = MuscleSet.read(candidates, hyperprior, scaling)
    design = models["arm"].iloc[0]
    models, points = models[models["arm"] == design], points[points["arm"] == design]
    last = int(models["trial"].max())
    first = models["experiment"] <= cfg.utility_check.experiments
    chosen = models[first & models["trial"].isin([0, last // 2, last])]
    jobs = {}
    for key, its in chosen.groupby(["participant", "experiment", "trial"], sort=False):
        where = participant, experiment, trial = str(key[0]), int(str(key[1])), int(str(key[2]))
        thetas = [its.loc[its["muscle"] == name, "value"].to_numpy() for name in muscles.names]
        known = points[(points["participant"] == participant) & (points["experiment"] == experiment)]
        note = f"{participant} experiment {experiment} trial {trial}"
        jobs[note] = where, thetas, known[known["trial"] <= trial]
    rows = ctx.gather("models", partial(check_models, cfg.utility_check, ctx, muscles), jobs)
    agreement = pd.DataFrame(rows, columns=list(UTILITY_AGREEMENT.columns))
    caption = (
        "Share of the most telling trajectory's information that the choice of each utility forgoes, by Monte Carlo "
        "mutual information with the hyperparameters: each experiment (dots) and their mean with its 95 % interval."
    )
    ctx.figure("utility_agreement", draw_agreement(agreement, CHOICES, TARGETS), caption)
    return agreement, summarise(agreement)


def check_models(
    cfg: UtilityCheck,
    ctx: Context,
    muscles: MuscleSet,
    where: tuple[str, int, int],
    thetas: Sequence[Array],
    points: pd.DataFrame,
) -> list[tuple[Any, ...]]:
    """Return the rows of `utility_agreement` of the models of all muscles in one experiment after one trial."""
    inputs, outputs = muscles.standardise(points)
    data = zip(inputs, outputs, thetas, muscles.priors, strict=True)
    models = [condition(x, y, theta, prior, mean=muscles.mean) for x, y, theta, prior in data]
    paths = [each[:, :: cfg.every] for each in muscles.candidates]
    trajectories, samples, dimensions = paths[0].shape
    # each trajectory's information densities, (S, R), over all muscles: one by one, and together
    alone, together = np.zeros((2, cfg.draws, trajectories))
    for name, model, its in zip(muscles.names, models, paths, strict=True):
        generator = ctx.generator(*where, name)
        drawn = draw_models(model, cfg.draws, generator)
        densities = point_information(drawn, its.reshape(-1, dimensions))
        alone += densities.reshape(cfg.draws, trajectories, samples).sum(axis=2)
        noise = generator.standard_normal((cfg.outputs, cfg.draws, samples))
        together += path_information(drawn, its, noise)
    scores = {name: trajectory_utility(models, paths, name, stride=1) for name in CHOICES if name != RANDOM}
    rows = []
    for target, densities in zip(TARGETS, (alone, together), strict=True):
        information = densities.mean(axis=0)
        best = Information.of(densities[:, int(np.argmax(information))])
        yardstick = rely(densities), best.value, best.standard_error
        for name in CHOICES:
            random = 0.0, forgo(information.mean(), information)
            agreement = random if name == RANDOM else agree(scores[name], information)
            rows.append((*where, target, name, *agreement, *yardstick))
    return rows


def forgo(chosen: float, information: Array) -> float:
    """Return the share of the best trajectory's information, of (R,), that one forgoes who has chosen so much."""
    best = information.max()
    return float(np.clip(1.0 - chosen / best, 0.0, 1.0)) if best > 0 else 0.0


def agree(scores: Array, information: Array) -> tuple[float, float]:
    """Return rank correlation and regret of scores; NaN and the regret of the first where all scores are equal."""
    return _correlate_ranks(scores, information), forgo(information[int(np.argmax(scores))], information)


def rely(densities: Array) -> float:
    """Return how well (S, R) densities rank R trajectories, from the rank correlation r of the means of their halves.

    2 r / (1 + r) for all draws, after Spearman and Brown (1910), and r itself where that is negative. NaN where a half
    does not tell trajectories apart.
    """
    r = _correlate_ranks(*(densities[start::2].mean(axis=0) for start in (0, 1)))
    return r if r < 0 else 2 * r / (1 + r)


def _correlate_ranks(one: Array, other: Array) -> float:
    from scipy.stats import spearmanr  # slow to import

    return float(spearmanr(one, other).statistic) if np.ptp(one) and np.ptp(other) else np.nan


def summarise(agreement: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `utility_summary`."""
    keys = ["target", "utility", "participant", "experiment"]
    means = agreement.groupby(keys, sort=False)[["spearman", "reliability", "regret"]].mean().reset_index()
    frames = []
    for target, its in means.groupby("target", sort=False):
        of = {name: rows.sort_values(["participant", "experiment"]) for name, rows in its.groupby("utility")}
        design = of[DESIGN]["regret"].to_numpy()
        rows = []
        for name in CHOICES:
            ranks, regret = of[name]["spearman"].to_numpy(), of[name]["regret"].to_numpy()
            spread, told = compare_pairs(ranks, np.zeros_like(ranks)), compare_pairs(regret, design)
            row = {"spearman": spread.first_mean, "spearman_low": spread.low, "spearman_high": spread.high}
            row |= {"reliability": of[name]["reliability"].mean(), "regret": told.first_mean}
            rows.append({"target": target, "utility": name, **vars(told), **row})
        frame = judge_differences(pd.DataFrame(rows), "p_t", "forgoes less than y_y", "forgoes more than y_y")
        frame.loc[frame["utility"] == DESIGN, "verdict"] = "the design"
        frames.append(frame[list(UTILITY_SUMMARY.columns)])
    return pd.concat(frames, ignore_index=True)
