"""Score of one session: which names are right, on the right muscles, and what share of the gap was closed."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import BaseModel, Field

from stages.science.discrepancy.report_text import LEAST_SUSPECTED

NONE, ABSORBED = "none", "absorbed"
SHOWN = 3
"""Number of candidates of the ranking that are listed."""


class NameClass(BaseModel, extra="forbid", frozen=True, strict=True):
    """Names that count as one."""

    names: Annotated[list[str], Field(min_length=2, max_length=3)]
    reason: str


class Rules(BaseModel):
    """When an effect is absorbed, how large it is (gap over the floor, growing), and which names count as one."""

    smallest_gap: Annotated[float, Field(gt=1.0, le=10.0)]
    most_confounded: Annotated[float, Field(gt=0.5, lt=1.0)]
    magnitudes: dict[str, Annotated[float, Field(ge=1.0)]]
    least_closable: Annotated[float, Field(ge=0.0, lt=1.0)]
    classes: list[NameClass]

    def alike(self, said: str, true: str) -> bool:
        """Return whether two names are the same or of one class."""
        return said == true or any({said, true} <= {*each.names} for each in self.classes)

    def size(self, truth: pd.DataFrame) -> str:
        """Return how large what was hidden is: of two effects, the smaller."""
        sizes = []
        for _, rows in truth.groupby("order"):
            imitated = rows["absorbed_share"].min() > self.most_confounded
            lost = imitated or rows["gap_over_floor"].max() < self.smallest_gap
            gap = _root_mean_square(rows["gap_over_floor"])
            reached = [name for name, least in self.magnitudes.items() if gap >= least and not lost]
            sizes.append(reached[-1] if reached else ABSORBED)
        return min(sizes, key=[ABSORBED, *self.magnitudes].index, default=NONE)


def _root_mean_square(values: pd.Series) -> float:
    return float(np.sqrt((values**2).mean()))


def score(
    sessions: pd.DataFrame, truth: pd.DataFrame, named: pd.DataFrame, ranking: pd.DataFrame, rules: Rules
) -> list[dict[str, Any]]:
    """Return a row for each session, of the tables ``blind_...`` of `blinded_suite`."""
    found, stood = [], named[~named["suspected"]]
    for row in sessions.to_dict("records"):
        its = (frame[frame["session"] == row["session"]] for frame in (truth, stood, ranking))
        found.append(_judge(row, *its, rules=rules))
    return found


def _judge(
    row: Mapping[Any, Any], truth: pd.DataFrame, named: pd.DataFrame, ranking: pd.DataFrame, *, rules: Rules
) -> dict[str, Any]:
    hidden, said = _by_name(truth), _by_name(named)
    first = next(iter(said), "")
    right = [(name, true) for name in said for true in hidden if rules.alike(name, true)]
    kept = ("session", "kind", "asked", "status", "before", "after", "oracle", "floor", "further_gain")
    best = ranking.sort_values("place").head(SHOWN)
    closable, least = row["before"] - row["oracle"], rules.least_closable * row["before"]
    probable = named["probability"].iloc[0] if len(named) else ranking.loc[ranking["name"] == NONE, "probability"].sum()
    return {
        **{name: row[name] for name in kept},
        "hidden": "+".join(hidden),
        "muscles": "+".join(dict.fromkeys(truth["muscle"])),
        "channel": "+".join(dict.fromkeys(truth["channel"])),
        "magnitude": rules.size(truth),
        "gap_over_floor": _root_mean_square(truth["gap_over_floor"]) if len(truth) else 1.0,
        "absorbed_share": float(truth["absorbed_share"].min()) if len(truth) else 0.0,
        "named": "+".join(said),
        "named_muscles": ";".join("+".join(muscles) for muscles in said.values()),
        "probability": float(probable),
        "top": ", ".join(f"{name} {p:.2f}" for name, p in zip(best["name"], best["probability"], strict=True)),
        "listed_absorbed": bool(ranking.loc[ranking["absorbed"], "name"].isin(list(hidden)).any()),
        "right_name": first in hidden,
        "right_class": any(rules.alike(first, true) for true in hidden),
        "right_muscles": bool(right) and set(said[right[0][0]]) == set(hidden[right[0][1]]),
        "all_named": bool(hidden) and all(any(rules.alike(name, true) for name in said) for true in hidden),
        "unexplained_channel": row["unexplained_channel"] if row["status"] == "unexplained" else "",
        "closed_share": (row["before"] - row["after"]) / closable if closable > least else math.nan,
        "worse": row["further_gain_high"] < 0.0,
    }


def list_said(truth: pd.DataFrame, named: pd.DataFrame, rules: Rules) -> pd.DataFrame:
    """Return every name that was said, once a session, under ``session name probability right``.

    The suspected ones are among them, as far as a verdict tells their probability in words.
    """
    hidden = truth.groupby("session")["name"].unique()
    told = named[~named["suspected"] | (named["probability"] >= LEAST_SUSPECTED)]
    said = told.drop_duplicates(["session", "order"])[["session", "name", "probability"]]
    right = [
        any(rules.alike(name, true) for true in hidden.get(session, ()))
        for session, name in zip(said["session"], said["name"], strict=True)
    ]
    return said.assign(right=np.array(right, dtype=bool)).reset_index(drop=True)


def _by_name(effects: pd.DataFrame) -> dict[str, list[str]]:
    """Return the muscles of each effect, in the effects' order."""
    ordered = effects.sort_values("order", kind="stable")
    return {str(name): list(rows["muscle"]) for name, rows in ordered.groupby("name", sort=False)}
