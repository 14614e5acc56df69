"""Tables as entries of the verdict: where the gap is largest, and the effects with their parameters."""

from collections.abc import Collection
from typing import Any

import numpy as np
import pandas as pd

from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.statistics.sign_flips import least_p

DEPENDS_ON = {
    "": ("channel", "muscle", "share", "low", "high"),
    "hint": ("hint", "hint_share"),
    "drift": ("drift", "drift_unit", "drift_first", "drift_last", "drift_share"),
}
"""Columns of the table `remainder`, by the one that is empty where the others tell nothing."""
AMENDED = "documents/amended.yaml"
"""Document that holds the amended plant."""
INTERVAL = ["value", "low", "high"]
UPSTREAM = ("command", "valve")
"""Sites that show in pressure alone."""


def list_confounded(ranking: pd.DataFrame, channels: Collection[str] = ()) -> list[str]:
    """Return the effects of `ranking` confounded in every round; with channels, only those that could act there."""
    always = ranking["absorbed"].groupby(ranking["name"]).transform("all")
    rows = ranking[(ranking["round"] == 1) & always]
    sites = [site not in UPSTREAM if "pressure_kpa" not in channels and channels else True for site in rows["site"]]
    return [str(name) for name in rows.loc[sites, "name"]]


def summarise_remainder(
    unexplained: pd.DataFrame, remainder: pd.DataFrame, maps: list[dict[str, Any]], certain: float
) -> dict[str, Any]:
    """Return what is left without a name, as the verdict tells it: of the channel in which that is most probable.

    The tables are of these names, `maps` what learned maps do; from the probability `certain` on something is said to
    be left.
    """
    worst = unexplained.sort_values("probability", kind="stable").iloc[-1]
    line_hz = float(worst["line_hz"])
    return {
        "status": "unexplained" if worst["probability"] >= certain else "none",
        "family": (str(worst["family"]) or None) if worst["share"] > 0.0 else None,
        "share": min(max(float(worst["share"]), 0.0), 1.0),
        "probability": float(worst["probability"]),
        "channel": str(worst["channel"]),
        "line_hz": None if np.isnan(line_hz) else line_hz,
        "imitated": float(unexplained["imitated"].max()),
        "patch": AMENDED if maps else None,
        "learned_maps": maps,
        "depends_on": [
            {
                "inputs": str(row["inputs"]).split(", ") if row["inputs"] else [],
                **{each: row[each] if row.get(of, True) else None for of, its in DEPENDS_ON.items() for each in its},
            }
            for row in remainder.to_dict("records")
        ],
    }


def locate_most(
    gap: pd.DataFrame, channels: pd.DataFrame, named: pd.DataFrame, settings: DiscrepancySettings
) -> list[dict[Any, Any]]:
    """Return the regime where the gap is most concentrated, by channel in which it matters or an effect is named."""
    place = ["channel", "muscle"]
    rows = gap.merge(channels[[*place, "unit", "gap_over_floor"]], on=place)
    carried = set(zip(named["channel"], named["muscle"], strict=True))
    shown = np.array([each in carried for each in zip(rows["channel"], rows["muscle"], strict=True)], dtype=bool)
    rows = rows[(shown | (rows["gap_over_floor"] > settings.search.smallest_gap)) & (rows["regime"] != "everywhere")]
    rows = rows[~rows["regime"].str.contains("Hz") & (rows["share_of_time"] > 0.0)]
    dense = rows["share_of_gap"] ** 2 / rows["share_of_time"]
    rows = rows.assign(dense=dense.where(rows["p_adjusted"] <= settings.significance, dense * 1e-3))
    best = rows.sort_values("dense", ascending=False).groupby(place, sort=False).head(1)
    best = best.sort_values("gap_over_floor", ascending=False).head(settings.report.most_places)
    kept = [*place, "unit", "regime", "share_of_gap", "share_of_time", "largest", "p_value", "p_adjusted"]
    return best[kept].to_dict("records")


def reproduce_effects(
    named: pd.DataFrame, driven: pd.DataFrame, counted: Collection[tuple[str, str, str]], settings: DiscrepancySettings
) -> pd.DataFrame:
    """Return the table `named_effects` with columns ``gap_before gap_after p_step reproduced``, on the test trials.

    The gaps are those of the rows of `verification`, by step. An effect is reproduced where the fall from the step
    before is significant or, with so few trials that none could be, has the least p-value that there can be; counts of
    a sensor where they show: `counted` are effect, channel and muscle of those that the test trials show.
    """
    gap, p_step = driven["gap"].to_numpy(), driven["p_step"].to_numpy()
    order = named["order"].to_numpy(dtype=int)
    bearable = max(settings.significance, least_p(int(driven["trials"].iloc[0])))
    seen = [place in counted for place in zip(named["name"], named["channel"], named["muscle"], strict=True)]
    reproduced = (p_step[order] <= bearable) | np.array(seen, dtype=bool)
    return named.assign(gap_before=gap[order - 1], gap_after=gap[order], p_step=p_step[order], reproduced=reproduced)


def list_suspected(suspected: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the effects that the search added and the decision took out, as the verdict lists them."""
    return [
        {
            "name": str(rows["name"].iloc[0]),
            "channel": str(rows["channel"].iloc[0]),
            "muscles": [str(each) for each in rows["muscle"]],
            "probability": float(rows["probability"].iloc[0]),
            "p_value": float(rows["p_value"].iloc[0]),
        }
        for _, rows in suspected.groupby("order")
    ]


def describe_effects(named: pd.DataFrame, values: pd.DataFrame) -> list[dict[str, Any]]:
    """Return each effect of `reproduce_effects`, with `amended_values` by muscle, and means over the commonest form."""
    effects = []
    for _, rows in named.groupby("order"):
        first, form = rows.iloc[0], str(rows["form"].mode().iloc[0])
        its = (values["effect"] == first["name"]) & (values["channel"] == first["channel"])
        own = values[its & values["muscle"].isin(rows["muscle"])]
        alike = own[own["form"] == form]
        pooled = alike.groupby("parameter", sort=False)[INTERVAL].mean()
        like = str(first["indistinguishable_from"])
        effects.append(
            {
                "name": str(first["name"]),
                "form": form,
                "site": str(first["site"]),
                "channel": str(first["channel"]),
                "muscles": [str(each) for each in rows["muscle"]],
                "probability": float(first["probability"]),
                "p_value": float(first["p_value"]),
                "reproduced": bool(first["reproduced"]),
                "step": {"before": first["gap_before"], "after": first["gap_after"], "p_value": first["p_step"]},
                "parameters": pooled.to_dict("index"),
                "forms": dict(zip(rows["muscle"].astype(str), rows["form"].astype(str), strict=True)),
                "by_muscle": {
                    str(muscle): mine.set_index("parameter")[INTERVAL].to_dict("index")
                    for muscle, mine in own.groupby("muscle", sort=False)
                },
                "indistinguishable_from": like.split(",") if like else [],
            }
        )
    return effects
