"""The seal is opened, after the verdict: what was hidden beside what was named.

In: the seal, the further trials, the nominal gaps, the decision and what it names, and the verification, which comes
before this. Out: `comparison_with_truth`, muscle by muscle, and `outcome`, the same in words.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from pipeline.config import Section, Target
from pipeline.context import Context
from pipeline.errors import InputError
from pipeline.stage import stage
from pipeline.table import Table, column
from stages.science.discrepancy.report_text import say_sure
from stages.science.plant.effect import list_effects
from stages.science.rig.sessions import seal_truth

COMPARISON_WITH_TRUTH = Table(
    "comparison_with_truth",
    "A muscle: what was hidden in it, and what was named",
    {
        "muscle": column(str, "its name"),
        "channel": column(str, "in which the effect shows"),
        "hidden": column(str, "true names, by +; empty for nothing"),
        "named": column(str, "names that were said, by +; empty for nothing"),
        "right": column(bool, "whether these are the same"),
        "hidden_gap_over_floor": column(float, "gap that is hidden, over the noise, by the rig's own fit", low=0),
        "found_gap_over_floor": column(float, "gap after the nominal fit over the noise floor, as found", low=0),
    },
    key=("muscle", "channel"),
)
OUTCOME = Table(
    "outcome", "What came out when the seal was opened", {"outcome": column(str, "a sentence")}, role="finding"
)


class Config(Section):
    """What this stage reads."""

    next_trials: int
    rig: Target


@stage(COMPARISON_WITH_TRUTH, OUTCOME)
def unblinding(
    cfg: Config,
    seal: pd.DataFrame,
    further_trials: pd.DataFrame,
    channels: pd.DataFrame,
    decision: pd.DataFrame,
    named_effects: pd.DataFrame,
    verification: pd.DataFrame,
    ctx: Context,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Open the seal, and compare what was hidden with what was named."""
    recorded = ctx.device.record()
    digest = seal_truth(recorded)
    if digest != seal["sha256"].iloc[0]:
        raise InputError("seal: the rig tells another truth than the one that was sealed; run blinded_session again")
    left = decision["status"].iloc[0] == "unexplained"
    hidden = recorded.truth["effects"]
    rows = _compare(recorded.truth, named_effects, channels)
    driven = verification[verification["simulation"] == "measured upstream"]
    named = named_effects["order"].max() if len(named_effects) else 0
    after, *learned = driven["gap"].iloc[named:-1]
    mended = f", and to {100 * learned[0]:.2g} % with learned maps, which have no name" if learned else ""
    names = " and ".join(f"{each['name'].replace('_', ' ')} on {', '.join(each['muscles'])}" for each in hidden)
    told = f"{names} ({recorded.truth['scenario']['magnitude']})" if hidden else "nothing"
    outcome = [
        f"{_describe_named(named_effects, hidden, left=left)} Hidden was {told}, "
        f"as sealed before the search (SHA-256 {digest[:12]}).",
        f"The gap on trials opened once went from {100 * driven['gap'].iloc[0]:.2g} % of the range to "
        f"{100 * after:.2g} %{mended}; the noise floor is {100 * driven['gap'].iloc[-1]:.2g} %.",
    ]
    if len(further_trials) < cfg.next_trials:
        outcome.append(
            f"Of {cfg.next_trials} further trials {len(further_trials)} were recorded: then there were no two names to "
            "tell apart, or no trial that would."
        )
    return pd.DataFrame(rows, columns=list(COMPARISON_WITH_TRUTH.columns)), pd.DataFrame({"outcome": outcome})


def _compare(truth: Mapping[str, Any], said: pd.DataFrame, channels: pd.DataFrame) -> list[tuple[Any, ...]]:
    hidden, gaps, rows = truth["effects"], truth["gap_over_floor"], []
    for row in channels.to_dict("records"):
        channel, muscle = str(row["channel"]), str(row["muscle"])
        true = [each["name"] for each in hidden if each["channel"] == channel and muscle in each["muscles"]]
        here = said[(said["channel"] == channel) & (said["muscle"] == muscle)]["name"]
        names = "+".join(true), "+".join(here), set(true) == set(here)
        rows.append((muscle, channel, *names, float(gaps[channel][muscle]), float(row["gap_over_floor"])))
    return rows


def _describe_named(said: pd.DataFrame, hidden: Sequence[Mapping[str, Any]], *, left: bool) -> str:
    """Return what was said, and whether it is right, in a sentence."""
    true = {each["name"] for each in hidden}
    if left:
        judged = "though no effect was hidden"
        if true:
            judged = "which is wrong, as it has one" if true & {*list_effects()} else "which is right"
        return f"Nothing was named: something without a name in the library was found to be left, {judged}."
    first = said.drop_duplicates("order")
    if first.empty:
        return f"Nothing was named, which is {'wrong' if true else 'right'}."
    said_so = zip(first["name"], first["probability"], strict=True)
    names = " and ".join(f"{name.replace('_', ' ')} (probability {say_sure(p)})" for name, p in said_so)
    like = set(str(first["indistinguishable_from"].iloc[0]).split(","))
    if set(first["name"]) == true:
        verdict = "right"
    elif first["name"].iloc[0] in true:
        verdict = "right in the first place"
    else:
        verdict = "not the truth, which was told not to be excluded" if like & true else "wrong"
    return f"Named was {names}, which is {verdict}."
