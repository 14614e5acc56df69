"""Whether the people differ: every pair of participants after the last trial, for difference and for equivalence.

In: `learning_curve`. Out: `participant_comparison`. "Not significant" is not "equal": beside Welch's test stands that
of equivalence for a stated margin, with the power that it had.
"""

from collections.abc import Sequence
from itertools import combinations, product
from typing import Annotated

import pandas as pd
from pydantic import Field, PositiveInt

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.figures.learning_curves import draw_learning_curves
from stages.science.muscle_models.error_rates import (
    ALL_MUSCLES,
    ENDED,
    add_average,
    carry_forward,
    summarise_error_rates,
)
from stages.science.statistics.equivalence import judge_equivalence
from stages.science.statistics.groups import compare_groups
from stages.science.statistics.verdicts import LEVEL, judge_with_equivalence

PARTICIPANT_COMPARISON = Table(
    "participant_comparison",
    "Two participants' error rates after the last designed trial: Welch's test and the test of equivalence",
    {
        "first": column(str, "participant"),
        "second": column(str, "participant"),
        "tested_on": column(str, "test set, as in learning_curve"),
        "muscle": column(str, "muscle, or mean for the average over muscles"),
        "n_first": column(int, "experiments of the first", low=1),
        "n_second": column(int, "experiments of the second", low=1),
        "first_mean": column(float, "error rate", percent=True, low=0),
        "second_mean": column(float, "error rate", percent=True, low=0),
        "difference": column(float, "first minus second", percent=True),
        "low": column(float, "lower end of its 95 % interval (Welch)", percent=True, nullable=True),
        "high": column(float, "upper end of its 95 % interval (Welch)", percent=True, nullable=True),
        "hedges_g": column(float, "effect size", nullable=True),
        "p_welch": column(float, "two-sided Welch's t-test", low=0, high=1, nullable=True),
        "p_holm": column(
            float, "p_welch raised (Holm) as all rows of this test set and n are compared", low=0, high=1, nullable=True
        ),
        "margin": column(float, "largest difference of error rates that does not matter", percent=True, low=0),
        "p_tost": column(float, "two one-sided tests of equivalence", low=0, high=1, nullable=True),
        "power": column(float, "of that test, were the true difference zero", low=0, high=1, nullable=True),
        "n_needed": column(float, "experiments of each for a power of 0.8", low=2, nullable=True),
        "verdict": column(
            str,
            f"different at p_holm below {LEVEL}, equivalent at p_tost below {LEVEL}, both, or neither",
            among=["different", "equivalent", "different within the margin", "undecided"],
        ),
    },
    key=("first", "second", "tested_on", "muscle", "n_first"),
    brief=("tested_on", "difference", "low", "high", "verdict"),
    main=("muscle", ALL_MUSCLES),
)


class ParticipantDifferences(Section):
    """Config group ``participant_differences``."""

    experiments: Annotated[list[PositiveInt | None], Field(min_length=1)]
    margin: Annotated[float, Field(gt=0, le=1)]


class Config(Section):
    """What this stage reads."""

    participant_differences: ParticipantDifferences


@stage(PARTICIPANT_COMPARISON)
def participant_differences(cfg: Config, learning_curve: pd.DataFrame, ctx: Context) -> pd.DataFrame:
    """Compare the participants' error rates in the design's arm."""
    design = learning_curve["arm"].iloc[0]
    executed = learning_curve[learning_curve["arm"] == design].drop(columns="arm")
    carried = carry_forward(executed)
    curve = add_average(carried)
    ended = "" if carried is executed else ENDED
    muscles = [ALL_MUSCLES, *learning_curve["muscle"].unique()]
    people = list(curve["participant"].unique())
    experiments = curve["experiment"].nunique()
    caption = (
        f"Error rate after each trial of the design ({design}), for every participant: mean and SD over "
        f"each one's {experiments} experiment{'s' * (experiments > 1)}, tested on {curve['tested_on'].iloc[0]}.{ended}"
    )
    shown = curve[curve["tested_on"] == curve["tested_on"].iloc[0]]
    shown = summarise_error_rates(shown, ["participant", "trial", "muscle"])
    ctx.figure("participants", draw_learning_curves(shown, people, muscles, "participant", "participant"), caption)
    section = cfg.participant_differences
    return compare_participants(curve, people, muscles, section.margin, section.experiments)


def compare_participants(
    curve: pd.DataFrame, people: list[str], muscles: list[str], margin: float, sizes: Sequence[int | None]
) -> pd.DataFrame:
    """Return the rows of `participant_comparison`, from a curve with the average over muscles.

    Each size is a family of tests: so many experiments of each participant count, or all where it is None.
    """
    last = curve[curve["trial"] == curve["trial"].max()]
    rank = last.groupby("participant")["experiment"].rank(method="dense")
    taken = [rank <= (rank.max() if size is None else size) for size in sizes]
    distinct = {int(rows.sum()): rows for rows in taken}
    if len(people) < 2:
        return pd.DataFrame(columns=list(PARTICIPANT_COMPARISON.columns))
    frames = []
    for tested_on, chosen in product(last["tested_on"].unique(), distinct.values()):
        family = last[chosen & (last["tested_on"] == tested_on)].groupby(["participant", "muscle"])
        values = {key: its["error_rate"].to_numpy() for key, its in family}
        rows = []
        for (first, second), muscle in product(combinations(people, 2), muscles):
            pair = values[(first, muscle)], values[(second, muscle)]
            where = {"first": first, "second": second, "tested_on": tested_on, "muscle": muscle}
            rows.append(where | vars(compare_groups(*pair)) | vars(judge_equivalence(*pair, margin)))
        frames.append(judge_with_equivalence(pd.DataFrame(rows), "p_welch", "different", "different"))
    return pd.concat(frames, ignore_index=True)[list(PARTICIPANT_COMPARISON.columns)]
