"""The rounds of a search as rows: each candidate's probability, and what it would leave."""

from __future__ import annotations

from typing import Any

from stages.science.discrepancy.evidence import NONE
from stages.science.discrepancy.naming import Round
from stages.science.discrepancy.search import Search

UNKNOWN = "unknown"


def rank_first(found: Search, unknown: float, most_absorbed: float) -> list[dict[str, Any]]:
    """Return a row for each candidate of each round, the most probable first.

    Parameters
    ----------
    found : Search
        Ended.
    unknown : float
        Probability of something without a name; it takes its part of every round.
    most_absorbed : float
        Share of an effect's change that the constants may imitate.
    """
    return [
        row
        for number, each in enumerate(found.rounds, start=1)
        for row in _rank_round(each, number, unknown, most_absorbed)
    ]


def _rank_round(looked: Round, number: int, unknown: float, most_absorbed: float) -> list[dict[str, Any]]:
    rows = []
    for name, probability in looked.verdicts.names.items():
        confounded = float(min(max(looked.confounded_with_constants.get(name, 0.0), 0.0), 1.0))
        rows.append(
            {
                "round": number,
                "name": name,
                "form": ",".join(sorted({form for form in looked.verdicts.forms.get(name, []) if form})),
                "site": looked.sites.get(name, ""),
                "probability": min(probability * (1.0 - unknown), 1.0),
                "heldout_gap": looked.heldout[name],
                "gap_over_floor": looked.gaps[name],
                "absorbed_share": confounded,
                "absorbed": confounded > most_absorbed,
            }
        )
    left = {"heldout_gap": looked.heldout[NONE], "gap_over_floor": looked.gaps[NONE]}
    bare = {"form": "", "site": "", "absorbed_share": 0.0, "absorbed": False}
    rows.append({"round": number, "name": UNKNOWN, "probability": unknown, **left, **bare})
    return sorted(rows, key=lambda row: -float(row["probability"]))
