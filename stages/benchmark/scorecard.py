"""How often the search is right: rates with intervals against targets, by kind and magnitude, and what is confused.

In: what was hidden and what was said of each session, and which names count as one class. Out: `scorecard` (rates),
`scorecard_cells` (each effect and magnitude, with what it was confused), `reliability` (probabilities that were said
against how often they were right) and `scorecard_sessions` (each session judged).
"""

import math
from collections import Counter
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from pipeline.config import Section
from pipeline.context import Context
from pipeline.stage import stage
from pipeline.table import Table, column, sentences
from stages.science.figures.scores import draw_confusion, draw_rates, draw_reliability_of_names
from stages.science.scorecard.scoring import Rules, list_said, score
from stages.science.statistics.intervals import bound_median, bound_rate

ALL, CLOSED = "all", "closed, median"
RESAMPLES = 499

SCORECARD_SESSIONS = Table(
    "scorecard_sessions",
    "A session, judged",
    {
        "session": column(str, "its name"),
        "kind": column(str, "what was hidden"),
        "hidden": column(str, "true names, by +; empty for nothing"),
        "muscles": column(str, "that carry them, by +"),
        "channel": column(str, "in which they show, by +"),
        "asked": column(str, "magnitude asked for"),
        "magnitude": column(str, "reached: by the gap that the effect leaves; none, absorbed, weak, medium or strong"),
        "gap_over_floor": column(float, "that gap, root mean square over muscles; 1 with nothing hidden", low=0),
        "absorbed_share": column(float, "least over muscles that the constants imitate", low=0, high=1.001),
        "status": column(str, "of the verdict"),
        "named": column(str, "names in the order added, by +"),
        "named_muscles": column(str, "of each of these, by +, the names parted by a semicolon"),
        "probability": column(float, "of the first name, or of none", low=0, high=1),
        "top": column(str, "the ranking's three most probable, with probabilities"),
        "listed_absorbed": column(bool, "whether a true name is listed as absorbed"),
        "right_name": column(bool, "whether the first name is a true one"),
        "right_class": column(bool, "or in a class with a true one"),
        "right_muscles": column(bool, "whether the first right name is on the true muscles and no others"),
        "all_named": column(bool, "whether each true name, or one of its class, is named, and there is one"),
        "unexplained_channel": column(str, "where something without a name is left, if so; empty otherwise"),
        "before": column(float, "gap on opened trials after the nominal fit, RMSE over range", low=0),
        "after": column(float, "the same with what was named", low=0),
        "oracle": column(float, "the same with the true names told", nullable=True),
        "floor": column(float, "the same, of what a flexible model leaves", low=0),
        "closed_share": column(float, "share of the closable gap that was closed", nullable=True),
        "further_gain": column(float, "share of the squared gap on further trials that what was named removes"),
        "worse": column(bool, "whether that is below zero, beyond its interval"),
    },
    key=("session",),
)
SCORECARD = Table(
    "scorecard",
    "How often the search is right",
    {
        "measure": column(str, "what is counted"),
        "magnitude": column(str, "of the effects, or all"),
        "n": column(int, "sessions", low=0),
        "value": column(float, "share of them, or median", percent=True, nullable=True),
        "low": column(
            float, "lower end of the interval: Wilson's, or of order statistics", percent=True, nullable=True
        ),
        "high": column(float, "upper end of it", percent=True, nullable=True),
        "target": column(float, "that it should reach, or stay below", percent=True),
        "at_most": column(bool, "whether it should stay below"),
        "met": column(bool, "whether it does; also where there are no sessions"),
    },
    key=("measure", "magnitude"),
    brief=("measure", "magnitude", "n", "value", "target", "met"),
)
SCORECARD_FINDINGS = sentences("scorecard_findings", "finding")
NAMED_FIRST = "named first, or its class"
SCORECARD_CELLS = Table(
    "scorecard_cells",
    "An effect in a magnitude",
    {
        "kind": column(str, "what was hidden"),
        "hidden": column(str, "true names"),
        "magnitude": column(str, "reached"),
        "n": column(int, "sessions", low=1),
        "right_name": column(int, "true name first", low=0),
        "right_class": column(int, "or one of its class", low=0),
        "right_muscles": column(int, "on the true muscles alone", low=0),
        "all_named": column(int, "each true name, or one of its class, named", low=0),
        "unexplained": column(int, "called unexplained", low=0),
        "listed_absorbed": column(int, "listed as absorbed", low=0),
        "closed_share": column(float, "median share of the closable gap closed", nullable=True),
        "said_instead": column(str, "what was said first where that was wrong, with counts"),
    },
    key=("kind", "hidden", "magnitude"),
    brief=("hidden", "magnitude", "n", "right_name", "right_class", "right_muscles", "closed_share", "said_instead"),
)
RELIABILITY = Table(
    "reliability",
    "Said probabilities of names between two bounds",
    {
        "from_probability": column(float, "lower bound", low=0, high=1),
        "to_probability": column(float, "upper bound", low=0, high=1),
        "n": column(int, "names said in a session, named or suspected", low=0),
        "said": column(float, "mean probability said", nullable=True),
        "right": column(float, "share in which it was a true name, or one of its class", nullable=True),
        "low": column(float, "lower end of Wilson's interval", nullable=True),
        "high": column(float, "upper end of it", nullable=True),
    },
    key=("from_probability",),
)

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Targets(Section):
    """Shares to be reached, or not to be passed."""

    named_first: dict[str, Share]
    closed: dict[str, Share]
    false_names: Share
    false_unexplained: Share
    outsiders_named: Share
    outsiders_found: Share
    both_named: Share
    right_muscle: Share
    absorbed_misnamed: Share
    absorbed_told: Share
    calibration_error: Share
    worse: Share
    two_names: Share


class Scorecard(Rules, Section):
    """Config group ``scorecard``."""

    confident: Share
    level: Annotated[float, Field(gt=0.5, lt=1.0)]
    reliability_edges: Annotated[list[Share], Field(min_length=2)]
    targets: Targets

    @model_validator(mode="after")
    def _order(self) -> Self:
        growing = {"reliability_edges": self.reliability_edges, "magnitudes": list(self.magnitudes.values())}
        for name, values in growing.items():
            if any(later <= earlier for earlier, later in pairwise(values)):
                raise ValueError(f"{name}: expected growing numbers, got {values}")
        for each in {*self.targets.named_first, *self.targets.closed} - set(self.magnitudes):
            raise ValueError(f"targets: no magnitude '{each}'; there are {', '.join(self.magnitudes)}")
        return self


class Config(Section):
    """What this stage reads."""

    scorecard: Scorecard
    seed: int


@stage(SCORECARD, SCORECARD_CELLS, RELIABILITY, SCORECARD_SESSIONS, SCORECARD_FINDINGS, stream="calibration_error")
def scorecard(
    cfg: Config,
    blind_sessions: pd.DataFrame,
    blind_truth: pd.DataFrame,
    blind_named: pd.DataFrame,
    blind_ranking: pd.DataFrame,
    ctx: Context,
) -> dict[str, pd.DataFrame]:
    """Compare what was said of every session with what was hidden in it."""
    section = cfg.scorecard
    scored = score(blind_sessions, blind_truth, blind_named, blind_ranking, section)
    sessions = pd.DataFrame(scored, columns=list(SCORECARD_SESSIONS.columns))
    said = list_said(blind_truth, blind_named, section)
    rows = [*_list_rates(sessions, section), _rate_calibration(said, section, ctx.generator("names"))]
    rates = pd.DataFrame(rows, columns=list(SCORECARD.columns))
    reached = np.where(rates["at_most"], rates["value"] <= rates["target"], rates["value"] >= rates["target"])
    rates["met"] = (rates["n"] == 0) | reached
    reliability = pd.DataFrame(_tabulate_reliability(said, section), columns=list(RELIABILITY.columns))
    level = f"{section.level:.0%}"
    told = f"Each share with its {level} interval, and the target; faults, which should stay below, are open."
    ctx.figure("scorecard", draw_rates(rates), told)
    ctx.figure("confusion", draw_confusion(sessions), "What was named first, by what was hidden; shares of sessions.")
    told = f"Share of right names against the probability that was said, with {level} intervals."
    ctx.figure("reliability", draw_reliability_of_names(reliability), told)
    return {
        SCORECARD.name: rates,
        SCORECARD_CELLS.name: pd.DataFrame(_list_cells(sessions), columns=list(SCORECARD_CELLS.columns)),
        RELIABILITY.name: reliability,
        SCORECARD_SESSIONS.name: sessions,
        SCORECARD_FINDINGS.name: pd.DataFrame({"sentence": describe_rates(rates, len(sessions))}),
    }


def describe_rates(rates: pd.DataFrame, sessions: int) -> list[str]:
    """Return how often the first name is right, and which targets are missed, by rows of `scorecard`."""
    known = rates[rates["n"] > 0]
    named = known[known["measure"] == NAMED_FIRST]
    shares = [
        f"{100 * row['value']:.0f} % of {row['n']} {row['magnitude']} effects ({100 * row['low']:.0f} to "
        f"{100 * row['high']:.0f} %)"
        for row in named.to_dict("records")
    ]
    missed = known[~known["met"]]
    lines = [
        f"{row['measure']}, {row['magnitude']}: {100 * row['value']:.3g} % of {row['n']}, to be at "
        f"{'most' if row['at_most'] else 'least'} {100 * row['target']:.3g} %"
        for row in missed.to_dict("records")
    ]
    right = ", ".join(shares) or "none, as none counts"
    kept = f"{len(known) - len(missed)} of {len(known)} targets are met, by the shares as they came out"
    return [
        f"In {sessions} sessions the first name, or its class, is right in {right}.",
        f"{kept}; missed: {'; '.join(lines)}." if lines else f"{kept}.",
    ]


def _list_rates(sessions: pd.DataFrame, section: Scorecard) -> list[dict[str, Any]]:
    targets = section.targets
    whole = sessions[sessions["magnitude"] != "absorbed"]
    kinds = ("none", "one_effect", "outsider", "two_effects", "one_muscle")
    none, one, foreign, pairs, single = (whole[whole["kind"] == kind] for kind in kinds)
    confident = (foreign["status"] == "named") & (foreign["probability"] > section.confident)
    lost = foreign["status"] == "unexplained"
    found = lost & (foreign["unexplained_channel"] == foreign["channel"])
    absorbed = sessions[sessions["magnitude"] == "absorbed"]
    misnamed = (absorbed["status"] == "named") & ~absorbed["right_class"]
    told = absorbed["listed_absorbed"] | absorbed["right_class"] | (absorbed["status"] == "no_discrepancy")
    amended = sessions[sessions["status"] == "named"]
    one_cause = amended[amended["kind"].isin(["one_effect", "one_muscle", "outsider"])]
    two_names = one_cause["named"].str.contains("+", regex=False)
    rows = [
        (measure, one[one["magnitude"] == size][judged], target, False, size)
        for measure, judged, sizes in (
            (NAMED_FIRST, "right_class", targets.named_first),
            ("named first, by its own name", "right_name", targets.named_first),
            (CLOSED, "closed_share", targets.closed),
        )
        for size, target in sizes.items()
    ]
    rows += [
        ("nothing hidden, something named", none["status"] == "named", targets.false_names, True, ALL),
        ("nothing hidden, unexplained", none["status"] == "unexplained", targets.false_unexplained, True, ALL),
        ("not in the library, named with confidence", confident, targets.outsiders_named, True, ALL),
        ("not in the library, unexplained", lost, targets.outsiders_found, False, ALL),
        ("not in the library, unexplained in its channel", found, targets.outsiders_found, False, ALL),
        ("two effects, both named", pairs["all_named"], targets.both_named, False, ALL),
        ("one muscle, named there alone", single["right_muscles"], targets.right_muscle, False, ALL),
        ("absorbed, misnamed", misnamed, targets.absorbed_misnamed, True, ALL),
        ("absorbed, listed so or nothing found", told, targets.absorbed_told, False, ALL),
        ("amended, worse on further trials", amended["worse"], targets.worse, True, ALL),
        ("one cause, two names", two_names, targets.two_names, True, ALL),
    ]
    return [_bound(*each, section.level) for each in rows]


def _bound(measure: str, judged: pd.Series, target: float, at_most: bool, size: str, level: float) -> dict[str, Any]:
    """Return the row of a share, or of a median, with its interval."""
    values, told = (judged.dropna(), bound_median) if measure == CLOSED else (judged.astype(bool), bound_rate)
    value, low, high = told(np.asarray(values), level)
    row = {"measure": measure, "magnitude": size, "target": target, "at_most": at_most}
    return {**row, "n": len(values), "value": value, "low": low, "high": high}


def _list_cells(sessions: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    for (kind, hidden, size), its in sessions.groupby(["kind", "hidden", "magnitude"], sort=False):
        wrong = its[~its["right_class"]] if hidden else its[its["status"] == "named"]
        if kind == "outsider":
            wrong = wrong[wrong["status"] != "unexplained"]
        said = Counter(wrong["named"].where(wrong["named"] != "", wrong["status"]))
        counts = ("right_name", "right_class", "right_muscles", "all_named", "listed_absorbed")
        row = {"kind": kind, "hidden": hidden, "magnitude": size, "n": len(its)}
        row |= {name: int(its[name].sum()) for name in counts}
        row |= {"unexplained": int((its["status"] == "unexplained").sum())}
        row |= {"closed_share": float(its["closed_share"].median())}
        rows.append({**row, "said_instead": ", ".join(f"{name} {count}" for name, count in said.most_common())})
    return rows


def _rate_calibration(said: pd.DataFrame, section: Scorecard, generator: np.random.Generator) -> dict[str, Any]:
    """Return the row of the expected calibration error, whose interval is from names drawn again with replacement."""
    drawn = (said.iloc[generator.integers(len(said), size=len(said))] for _ in range(RESAMPLES if len(said) else 0))
    spread = [_find_calibration_error(_tabulate_reliability(each, section)) for each in drawn]
    outside = 0.5 * (1.0 - section.level)
    low, high = np.quantile(spread, [outside, 1.0 - outside]) if spread else (math.nan, math.nan)
    value = _find_calibration_error(_tabulate_reliability(said, section))
    row = {"measure": "calibration error of what was said", "magnitude": ALL, "n": len(said), "at_most": True}
    target = section.targets.calibration_error
    return {**row, "value": value, "low": float(low), "high": float(high), "target": target}


def _find_calibration_error(reliability: list[dict[str, Any]]) -> float:
    """Return the mean distance between what was said and how often it was right, over all that was said.

    Source: Naeini, Cooper and Hauskrecht, Obtaining well calibrated probabilities using Bayesian binning, AAAI 2015.
    """
    told = [each for each in reliability if each["n"]]
    off = sum(each["n"] * abs(each["said"] - each["right"]) for each in told)
    return off / sum(each["n"] for each in told) if told else math.nan


def _tabulate_reliability(named: pd.DataFrame, section: Scorecard) -> list[dict[str, Any]]:
    """Return how often names were right, by the probability that was said."""
    rows = []
    for low, high in pairwise(section.reliability_edges):
        last = high == section.reliability_edges[-1]
        inside = (named["probability"] >= low) & ((named["probability"] < high) | last)
        its = named[inside]
        value, least, most = bound_rate(its["right"].to_numpy(dtype=bool), section.level)
        row = {"from_probability": low, "to_probability": high, "n": len(its), "said": float(its["probability"].mean())}
        rows.append({**row, "right": value, "low": least, "high": most})
    return rows
