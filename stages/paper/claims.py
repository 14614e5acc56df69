"""The paper's claims beside what this study found: holds, does not hold, or cannot be tested in simulation.

In: whichever comparisons the workflow has. Out: `claims`, a row for each claim, setting and test set. Nothing is
measured here and no verdict is written down: each follows from its statistics by one of three rules.

A claim that something is better holds where the difference has that sign and its p-value, adjusted in the table that it
comes from, is below 5 %. A claim that something does not matter holds where the test of equivalence is below 5 %; of
several muscles, where every one's is (the largest p-value of an intersection-union test, Berger 1982). A claim that
choices agree holds where they are more alike than at random. What was tested otherwise does not hold; the finding says
whether the opposite was found, or nothing. What was not tested, for want of experiments or of an arm, is called that.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.muscle_models.error_rates import ALL_MUSCLES
from stages.science.statistics.paired import compare_pairs
from stages.science.statistics.verdicts import LEVEL

HOLDS, FAILS, UNTESTED, UNTESTABLE = "holds", "does not hold", "not tested", "not testable in simulation"

CLAIMS = Table(
    "claims",
    "A claim of the paper beside what this study found",
    {
        "claim": column(str, "short name"),
        "paper": column(str, "what the paper says, and where"),
        "setting": column(str, "what it was tested with; empty where there is one way only"),
        "tested_on": column(str, "test set, as in learning_curve; empty where the claim is not about errors"),
        "verdict": column(str, f"at p below {LEVEL}", among=[HOLDS, FAILS, UNTESTED, UNTESTABLE]),
        "finding": column(str, "what was found, in words"),
        "n": column(int, "units of the test (of the smaller group); 0 where nothing could be tested", low=0),
        "p": column(float, "p-value that decides", low=0, high=1, nullable=True),
        "estimate": column(float, "difference of error rates, negative = as claimed to be better", nullable=True),
        "low": column(float, "lower end of its 95 % interval", nullable=True),
        "high": column(float, "upper end of its 95 % interval", nullable=True),
        "effect": column(float, "effect size, of the kind that the statistic names", nullable=True),
        "statistic": column(str, "test, and kind of effect size"),
    },
    key=("claim", "setting", "tested_on"),
    brief=("claim", "setting", "tested_on", "estimate", "p", "verdict"),
)

CLAIM_FINDINGS = sentences("claim_findings", "finding")

PAPER = {
    "error_falls": "the models' error falls over the trials with a person moving (5.1, Fig. 6)",
    "beats_linear_all_along": "over the trials, the error is below the standard linear procedure's, which has no "
    "interaction (5.1, Fig. 6)",
    "beats_linear": "after the last trial, the error is below the standard linear procedure's (5.2, Fig. 7)",
    "beats_sparse_gp": "after the last trial, the error is below that of a sparse GP on all data without "
    "interaction (5.2, Fig. 7)",
    "participants_alike": "two participants give comparable models (5.2, Fig. 8)",
    "robust_to_shift": "learning is robust against the participant's tracking error (5.3, Fig. 9)",
    "best_without_shift": "without tracking error, learning is better (5.3, Fig. 9)",
    "beats_random_choice": "chosen trajectories hold more information than others (5.3); here, than random ones",
    "robust_to_prior_means": "performance is not highly sensitive to the hyperpriors' means (6.1)",
    "robust_to_prior_spread": "performance is not highly sensitive to the hyperpriors' variances (6.1)",
    "choices_agree": "some trajectories are chosen again and again (6.2, Fig. 10)",
    "sparse_model_gains": "a sparse model that keeps all samples would do better (7, future work)",
    "works_on_real_robot": "the error falls on a real exoskeleton with two healthy adults (5.1)",
}


ABSENT = "this study has no comparison for it: an arm, a second participant or an analysis is missing"


class Config(Section):
    """What this stage reads: tables alone."""


Verdict = tuple[float, str, str]
"""The p-value that decided, the verdict, and the finding in words."""

Judge = Callable[[float, float, float], Verdict]
"""Judges a difference, negative = as claimed to be better, by the p-values of the tests of difference, adjusted where
it is one of many, and of equivalence, NaN without such a test."""

TOO_FEW: Verdict = (np.nan, UNTESTED, "too few experiments for a test")


def judge_better(
    estimate: float,
    p: float,
    p_equivalent: float,
    shown: str = "shown",
    not_shown: str = "not shown: no difference was found, which is not the same as none",
) -> Verdict:
    """Judge a claim that something is better, or different where there is no estimate."""
    if np.isnan(p):
        return TOO_FEW
    if not p < LEVEL:
        return p, FAILS, not_shown
    return (p, FAILS, "the opposite was found") if estimate >= 0 else (p, HOLDS, shown)


def judge_same(estimate: float, p_different: float, p: float) -> Verdict:
    """Judge a claim that something does not matter."""
    different = p_different < LEVEL
    if np.isnan(p):
        return TOO_FEW
    if p < LEVEL:
        return p, HOLDS, "it matters, but by less than the margin" if different else "equivalent to the margin"
    if different:
        return p, FAILS, "it matters" if estimate > 0 else "it matters, and improves"
    return p, FAILS, "undecided: neither a difference nor equivalence was found"


def judge_all_same(estimate: float, p_different: float, p: float, differing: Sequence[str]) -> Verdict:
    """Judge a claim that something matters to none of several muscles, of which some were shown to differ."""
    p, verdict, finding = judge_same(estimate, p_different, p)
    if verdict == HOLDS:
        more = f"; within it, it matters to {', '.join(differing)}" if differing else ""
        return p, HOLDS, f"equivalent to the margin for every muscle{more}"
    if verdict == FAILS and differing:
        return p, FAILS, f"it matters to {', '.join(differing)}, and is not equivalent for every muscle"
    return p, verdict, finding


@stage(CLAIMS, CLAIM_FINDINGS)
def claims(
    cfg: Config,
    ctx: Context,
    executed_by: pd.DataFrame | None = None,
    learning_curve: pd.DataFrame | None = None,
    paired_comparison: pd.DataFrame | None = None,
    baseline_comparison: pd.DataFrame | None = None,
    participant_comparison: pd.DataFrame | None = None,
    shift_comparison: pd.DataFrame | None = None,
    sensitivity_comparison: pd.DataFrame | None = None,
    choice_concentration: pd.DataFrame | None = None,
    sparse_comparison: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Judge every claim that the workflow's comparisons bear on."""
    sources = [
        (weigh_fall, learning_curve),
        (weigh_baselines, baseline_comparison),
        (weigh_participants, participant_comparison),
        (weigh_time_shift, shift_comparison),
        (weigh_choices_against_random, paired_comparison),
        (weigh_hyperpriors, sensitivity_comparison),
        (weigh_concentration, choice_concentration),
        (weigh_sparse_model, sparse_comparison),
    ]
    rows = [row for tell, frame in sources if frame is not None for row in tell(frame)]
    if executed_by is not None:
        rows.append(describe_reality(bool(executed_by["real"].all()), rows))
        untested = [claim for claim in PAPER if claim not in {row["claim"] for row in rows}]
        rows += [describe(claim, (np.nan, UNTESTED, ABSENT)) for claim in untested]
    told = pd.DataFrame(rows, columns=list(CLAIMS.columns))
    return told, pd.DataFrame({"sentence": count_claims(told)})


def count_claims(told: pd.DataFrame) -> list[str]:
    """Return in words which claims hold in every way in which they were tested, which do not, and which were not."""
    verdicts = told.groupby("claim", sort=False)["verdict"].agg(set)
    tested = {claim: found & {HOLDS, FAILS} for claim, found in verdicts.items()}
    groups = {
        "Borne out in every way that was tested": [each for each, found in tested.items() if found == {HOLDS}],
        "Borne out in some ways only": [each for each, found in tested.items() if found == {HOLDS, FAILS}],
        "Not borne out": [each for each, found in tested.items() if found == {FAILS}],
        "Not tested": [each for each, found in tested.items() if not found],
    }
    names = {told: ", ".join(str(each).replace("_", " ") for each in claims) for told, claims in groups.items()}
    count = f"of the paper's {len(verdicts)} claims"
    return [f"{told}, {len(claims)} {count}: {names[told]}." for told, claims in groups.items() if claims]


def describe(claim: str, told: Verdict, setting: str = "", tested_on: str = "") -> dict[str, Any]:
    """Return the row of `claims` of what nothing was compared for."""
    where = {"claim": claim, "paper": PAPER[claim], "setting": setting, "tested_on": tested_on}
    nothing = {"statistic": "none", "n": 0, **dict.fromkeys(("estimate", "low", "high", "effect"), np.nan)}
    return where | nothing | dict(zip(("p", "verdict", "finding"), told, strict=True))


def describe_reality(real: bool, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of the claim about a real robot: that of `error_falls` if a real rig executed the trials."""
    claim = "works_on_real_robot"
    for row in rows:
        if real and row["claim"] == "error_falls":
            return {**row, "claim": claim, "paper": PAPER[claim]}
    why = (UNTESTED, ABSENT) if real else (UNTESTABLE, "all trials were simulated")
    return describe(claim, (np.nan, *why))


def weigh(row: Any, claim: str, setting: str, judge: Judge, statistic: str, n: int, effect: str) -> dict[str, Any]:
    """Return the row of `claims` by what a comparison's row says, with n units in the smaller group."""
    names = ("difference", "low", "high", effect, "p_holm", "p_tost")
    estimate, low, high, size, *p = (float(row.get(name, np.nan)) for name in names)
    found = {"statistic": statistic, "n": int(n), "estimate": estimate, "low": low, "high": high, "effect": size}
    return describe(claim, judge(estimate, *p), setting, row.get("tested_on", "")) | found


def weigh_fall(curve: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Compare the design's error after the last trial with that of its initial data, paired over experiments."""
    design = curve[curve["arm"] == curve["arm"].iloc[0]]
    for tested_on, its in design.groupby("tested_on", sort=False):
        means = its.groupby(["participant", "experiment", "trial"])["error_rate"].mean().unstack("trial")
        told = compare_pairs(means[means.columns.max()].to_numpy(), means[0].to_numpy())
        row = {**vars(told), "p_holm": told.p_t, "tested_on": str(tested_on)}
        yield weigh(row, "error_falls", "", judge_better, "paired t, d_z", told.n, "d_z")


def weigh_participants(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take the comparison of every two participants, over all muscles and their largest number of experiments."""
    average = compared[compared["muscle"] == ALL_MUSCLES]
    for _, its in average.groupby(["first", "second", "tested_on"], sort=False):
        row = its.sort_values("n_first").to_dict("records")[-1]
        people, n = f"{row['first']}, {row['second']}", min(row["n_first"], row["n_second"])
        statistic = f"Welch, TOST to {row['margin']:g}, Hedges g"
        yield weigh(row, "participants_alike", people, judge_same, statistic, n, "hedges_g")


def weigh_time_shift(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take each amplitude's comparison: equivalence after the last trial, and the curve without shift against with."""
    for row in compared.to_dict("records"):
        setting, n = f"up to {plain(row['amplitude_s'])} s", row["n"]
        if row["measure"] == "final":
            statistic = f"paired t, TOST to {row['margin']:g}, d_z"
            yield weigh(row, "robust_to_shift", setting, judge_same, statistic, n, "d_z")
        else:
            # the table tells the shift less none; the claim is about none
            turned = {"difference": -row["difference"], "low": -row["high"], "high": -row["low"], "d_z": -row["d_z"]}
            statistic = "paired t of the curve, d_z"
            yield weigh(row | turned, "best_without_shift", setting, judge_better, statistic, n, "d_z")


def weigh_choices_against_random(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take the design's comparison with the control that chooses at random, over the largest number of experiments."""
    its = compared[compared["control"] == "random"]
    for _, rows in its.groupby(["tested_on", "measure"], sort=False):
        row = rows.sort_values("n").to_dict("records")[-1]
        setting = "after the last trial" if row["measure"] == "final" else "over the curve"
        yield weigh(row, "beats_random_choice", setting, judge_better, "paired t, d_z", row["n"], "d_z")


def weigh_baselines(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take the design's comparisons with the two baselines of the paper, over all muscles."""
    about = {
        ("linear", "curve"): "beats_linear_all_along",
        ("linear", "final"): "beats_linear",
        ("sparse_gp", "final"): "beats_sparse_gp",
    }
    for row in compared[compared["muscle"] == ALL_MUSCLES].to_dict("records"):
        claim = about.get((row["baseline"], row["measure"]))
        if claim:
            n = min(row["n_design"], row["n_baseline"])
            yield weigh(row, claim, "", judge_better, "Welch, Hedges g", n, "effect")


def weigh_hyperpriors(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take each setting's comparison with Table 1, of the muscle that is least surely equivalent."""
    means = "robust_to_prior_means", "means with SD {}", "Welch, Welch's TOST", "hedges_g", "difference"
    spread = "robust_to_prior_spread", "variances x {}", "Wilcoxon, paired t TOST", "rank_biserial", "hodges_lehmann"
    for (kind, *_), rows in compared.groupby(["kind", "setting", "tested_on"], sort=False):
        claim, described, test, effect, estimate = means if kind == "mean" else spread
        its = rows[rows["muscle"] != ALL_MUSCLES].sort_values("p_tost", na_position="last")
        row = its.to_dict("records")[-1]
        least = {"difference": row[estimate], "p_holm": its["p_holm"].min()}
        statistic = f"{test} to {row['margin']:g}, {effect}: of {row['muscle']}, least surely equivalent"
        judge = partial(judge_all_same, differing=sorted(its.loc[its["p_holm"] < LEVEL, "muscle"]))
        yield weigh(row | least, claim, described.format(plain(row["setting"])), judge, statistic, row["n"], effect)


def plain(value: float) -> str:
    """Return a number with all the digits that tell it from others."""
    return repr(float(value)).removesuffix(".0")


def weigh_concentration(concentration: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take the design's test, the first of the arms."""
    row = {**concentration.to_dict("records")[0], "low": np.nan, "high": np.nan}
    statistic = "Monte Carlo test of dispersion, over its mean at random"
    shown, not_shown = "chosen more alike than at random", "not shown: choices as spread as at random"
    judge = partial(judge_better, shown=shown, not_shown=not_shown)
    yield weigh(row, "choices_agree", "", judge, statistic, row["n"], "effect")


def weigh_sparse_model(compared: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Take the comparison of a sparse model that keeps all samples with an exact one of few, after the last trial."""
    its = compared[(compared["question"] == "keeping all samples") & (compared["measure"] == "final")]
    for row in its.drop_duplicates("tested_on").to_dict("records"):  # the design's comparison stands first
        lines = f"{row['first']} - {row['second']}"
        yield weigh(row, "sparse_model_gains", lines, judge_better, "paired t, d_z", row["n"], "d_z")
