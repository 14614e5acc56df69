"""Rows of tables as the verdict tells them: where the gap is largest, and which effects with which parameters."""

from __future__ import annotations

from typing import Any

import pandas as pd

MOST_PLACES = 6


def locate_most(gap: pd.DataFrame, channels: pd.DataFrame, smallest_gap: float) -> list[dict[str, Any]]:
    """Return the rows of `gap` that say most, for each muscle's channel whose gap matters: one regime each.

    Parameters
    ----------
    gap : DataFrame
        Regimes with shares of the gap and of time.
    channels : DataFrame
        Gap over floor of each channel.
    smallest_gap : float
        Over the floor; smaller ones are passed over.
    """
    rows = gap.merge(channels[["channel", "muscle", "gap_over_floor"]], on=["channel", "muscle"])
    rows = rows[(rows["gap_over_floor"] > smallest_gap) & (rows["regime"] != "everywhere")]
    rows = rows[~rows["regime"].str.contains("Hz") & (rows["share_of_time"] > 0.0)]
    if rows.empty:
        return []
    dense = rows["share_of_gap"].clip(lower=0.0) * (rows["share_of_gap"] / rows["share_of_time"])
    rows = rows.assign(dense=dense.where(rows["p_adjusted"] <= 0.05, dense * 1e-3))
    best = rows.sort_values("dense", ascending=False).groupby(["channel", "muscle"], sort=False).head(1)
    best = best.sort_values("gap_over_floor", ascending=False).head(MOST_PLACES)
    kept = ["channel", "muscle", "regime", "share_of_gap", "share_of_time", "largest", "p_value", "p_adjusted"]
    return [{str(name): _plain(value) for name, value in row.items()} for row in best[kept].to_dict("records")]


def describe_effects(named: pd.DataFrame, values: pd.DataFrame) -> list[dict[str, Any]]:
    """Return each added effect with its muscles and parameters: the mean over muscles, and each muscle's own.

    Parameters
    ----------
    named : DataFrame
        Table `named_effects`.
    values : DataFrame
        Table `amended_values`.
    """
    effects = []
    for _, rows in named.groupby("order", sort=True):
        first = rows.iloc[0]
        own = values[(values["effect"] == first["name"]) & values["muscle"].isin(rows["muscle"])]
        pooled = own.groupby("parameter", sort=False)[["value", "low", "high"]].mean()
        like = str(first["indistinguishable_from"])
        effects.append(
            {
                "name": str(first["name"]),
                "form": str(first["form"]),
                "site": str(first["site"]),
                "channel": str(first["channel"]),
                "muscles": [str(each) for each in rows["muscle"]],
                "probability": float(first["probability"]),
                "parameters": {str(name): _interval(row) for name, row in pooled.iterrows()},
                "by_muscle": {
                    str(muscle): {str(row["parameter"]): _interval(row) for _, row in mine.iterrows()}
                    for muscle, mine in own.groupby("muscle", sort=False)
                },
                "indistinguishable_from": like.split(",") if like else [],
            }
        )
    return effects


def _interval(row: Any) -> dict[str, float]:
    return {name: float(row[name]) for name in ("value", "low", "high")}


def _plain(value: Any) -> Any:
    return value if isinstance(value, str) else float(value)
