"""Tables as entries of the verdict: where the gap is largest, and the effects with their parameters."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd

from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.statistics.sign_flips import least_p

Status = Literal["no_discrepancy", "named", "unexplained"]

PLACE = ("channel", "muscle")
UPSTREAM = ("command", "valve")
"""Sites that show in pressure alone."""


def list_confounded(ranking: pd.DataFrame, channels: Collection[str] = ()) -> list[str]:
    """Return the effects confounded with the constants in every round that could act in one of the channels.

    Parameters
    ----------
    ranking : DataFrame
        Table `ranking`.
    channels : collection of str
        In which there is a gap; none for all.
    """
    always = ranking["absorbed"].groupby(ranking["name"]).transform("all")
    rows = ranking[(ranking["round"] == 1) & always]
    sites = [site not in UPSTREAM if "pressure_kpa" not in channels and channels else True for site in rows["site"]]
    return [str(name) for name in rows.loc[sites, "name"]]


def decide_status(named: Sequence[float], unknown: float, certain: float) -> Status:
    """Return the status by the fitted trials: named if an effect is certain, else unexplained if a remainder is.

    Parameters
    ----------
    named : sequence of float
        Probabilities of the effects that were added, less the doubt; what exact values show stays sure.
    unknown : float
        Probability that something without a name is left.
    certain : float
        Probability above which that is said.
    """
    if max(named, default=0.0) > certain:
        return "named"
    if unknown > certain:
        return "unexplained"
    return "named" if named else "no_discrepancy"


def read_status(named: pd.DataFrame, unexplained: pd.DataFrame, certain: float) -> Status:
    """Return the status by the tables `named_effects` and `unexplained`; see `decide_status`."""
    return decide_status(list(named["probability"]), unexplained["probability"].max(), certain)


def confirm_status(status: Status, over_floor: float, smallest_gap: float, blind: bool) -> Status:
    """Return the status by the test trials: where nothing was named, they decide whether there is a gap.

    Parameters
    ----------
    status : str
        By the fitted trials.
    over_floor : float
        Gap of the test trials over their noise floor.
    smallest_gap : float
        That matters.
    blind : bool
        Whether so much counts as noise that a gap would not be seen.
    """
    if status == "named":
        return status
    return "unexplained" if blind or over_floor > smallest_gap else "no_discrepancy"


def summarise_unexplained(unexplained: pd.DataFrame, doubted: bool = False) -> dict[str, Any]:
    """Return what is left without a name, over channels, as the verdict tells it; line and memory, of the worst.

    Parameters
    ----------
    unexplained : DataFrame
        Table `unexplained`.
    doubted : bool
        Whether the noise floor of trials not fitted hides what there is where something was named.
    """
    worst = int(np.argmax(unexplained["probability"].to_numpy()))
    line_hz = float(unexplained["line_hz"].to_numpy()[worst])
    return {
        "unexplained_share": float(unexplained["share"].clip(lower=0.0).max()),
        "imitated": 1.0 if doubted else float(unexplained["imitated"].max()),
        "line_hz": None if np.isnan(line_hz) else line_hz,
        "remembered": bool(unexplained["remembered"].to_numpy()[worst]),
    }


def list_remainder(remainder: pd.DataFrame) -> list[dict[str, Any]]:
    """Return on which signals the unexplained residual depends, as the verdict lists it.

    Parameters
    ----------
    remainder : DataFrame
        Table `remainder`.
    """
    kept = ["channel", "muscle", "share", "low", "high", "hint", "hint_share"]
    return [
        {
            "inputs": str(row["inputs"]).split(", ") if row["inputs"] else [],
            **{name: _plain(row[name]) if row["hint"] or "hint" not in name else None for name in kept},
        }
        for row in remainder.to_dict("records")
    ]


def list_candidates(ranking: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the candidates of the first round as the verdict lists them.

    Parameters
    ----------
    ranking : DataFrame
        Table `ranking`.
    """
    first = ranking[ranking["round"] == 1]
    return [
        {
            "name": str(row["name"]),
            "probability": float(row["probability"]),
            "heldout_gap": float(row["heldout_gap"]),
            "absorbed": bool(row["absorbed"]),
        }
        for row in first.to_dict("records")
    ]


def locate_most(
    gap: pd.DataFrame, channels: pd.DataFrame, named: pd.DataFrame, settings: DiscrepancySettings
) -> list[dict[str, Any]]:
    """Return for each channel with a gap that matters the regime in which the gap is most concentrated.

    Parameters
    ----------
    gap : DataFrame
        Regimes with shares of the gap and of time.
    channels : DataFrame
        Unit and gap over floor of each channel.
    named : DataFrame
        Table `named_effects`; where one is, it matters, however large.
    settings : DiscrepancySettings
        Smallest gap over the floor, significance level and number of rows.
    """
    smallest_gap = settings.search.smallest_gap
    rows = gap.merge(channels[["channel", "muscle", "unit", "gap_over_floor"]], on=["channel", "muscle"])
    carried = set(zip(named["channel"], named["muscle"], strict=True))
    matters = [over > smallest_gap or (c, m) in carried for c, m, over in rows[[*PLACE, "gap_over_floor"]].to_numpy()]
    rows = rows[np.array(matters, dtype=bool) & (rows["regime"] != "everywhere")]
    rows = rows[~rows["regime"].str.contains("Hz") & (rows["share_of_time"] > 0.0)]
    if rows.empty:
        return []
    dense = rows["share_of_gap"].clip(lower=0.0) * (rows["share_of_gap"] / rows["share_of_time"])
    rows = rows.assign(dense=dense.where(rows["p_adjusted"] <= settings.significance, dense * 1e-3))
    best = rows.sort_values("dense", ascending=False).groupby(["channel", "muscle"], sort=False).head(1)
    best = best.sort_values("gap_over_floor", ascending=False).head(settings.report.most_places)
    kept = ["channel", "muscle", "unit", "regime", "share_of_gap", "share_of_time", "largest", "p_value", "p_adjusted"]
    return [{str(name): _plain(value) for name, value in row.items()} for row in best[kept].to_dict("records")]


def confirm_effects(
    named: pd.DataFrame, driven: pd.DataFrame, settings: DiscrepancySettings, hidden: Collection[str] = ()
) -> pd.DataFrame:
    """Return the added effects with the gap before and after each on the test trials, and whether these confirm it.

    An effect that does not reduce the gap of the test trials loses probability, and so does one in a channel whose
    noise floor hides what there is; an effect that exact values show keeps its probability.

    Parameters
    ----------
    named : DataFrame
        Table `named_effects`.
    driven : DataFrame
        Rows of the table `verification`, by step.
    settings : DiscrepancySettings
        Significance level of the fall from the step before, above whose p-value an effect is not confirmed; with so few
        trials that none could be less, the least that there can be. What is not confirmed loses probability.
    hidden : collection of str
        Channels whose noise floor on the test trials hides what there is.

    Returns
    -------
    DataFrame
        With columns ``gap_before``, ``gap_after``, ``p_step`` and ``confirmed`` too.
    """
    told = settings.confirmation
    gap, p_step = driven["gap"].to_numpy(), driven["p_step"].to_numpy()
    order = named["order"].to_numpy(dtype=int)
    bearable = max(settings.significance, least_p(int(driven["trials"].iloc[0])))
    shown = named["shown"].to_numpy(dtype=bool)
    confirmed = shown | (p_step[order] <= bearable)
    seen = shown | ~named["channel"].isin(list(hidden)).to_numpy(dtype=bool)
    probability = named["probability"].where(seen, named["probability"].clip(upper=told.hidden_probability))
    return named.assign(
        gap_before=gap[order - 1],
        gap_after=gap[order],
        p_step=p_step[order],
        confirmed=confirmed,
        probability=probability.where(confirmed, told.unconfirmed_factor * probability),
    )


def describe_effects(named: pd.DataFrame, values: pd.DataFrame) -> list[dict[str, Any]]:
    """Return each added effect with its muscles and parameters: the mean over muscles, and each muscle's own.

    The mean is over muscles that carry the commonest form, as forms differ in their parameters.

    Parameters
    ----------
    named : DataFrame
        Table `named_effects`, from `confirm_effects`.
    values : DataFrame
        Table `amended_values`.
    """
    effects = []
    for _, rows in named.groupby("order", sort=True):
        first, form = rows.iloc[0], str(rows["form"].mode().iloc[0])
        own = values[(values["effect"] == first["name"]) & values["muscle"].isin(rows["muscle"])]
        alike = own[own["form"] == form]
        pooled = alike.groupby("parameter", sort=False)[["value", "low", "high"]].mean()
        like = str(first["indistinguishable_from"])
        effects.append(
            {
                "name": str(first["name"]),
                "form": form,
                "site": str(first["site"]),
                "channel": str(first["channel"]),
                "muscles": [str(each) for each in rows["muscle"]],
                "probability": float(first["probability"]),
                "confirmed": bool(first["confirmed"]),
                "step": {"before": first["gap_before"], "after": first["gap_after"], "p_value": first["p_step"]},
                "parameters": {str(name): _interval(row) for name, row in pooled.iterrows()},
                "forms": dict(zip(rows["muscle"].astype(str), rows["form"].astype(str), strict=True)),
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
