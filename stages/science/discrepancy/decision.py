"""The one decision: whether something is missing, and which of the named effects the test trials confirm.

What the search found, and every output on all trials, flow in; a `Decision` flows out. The workflow's verdict, the
unblinding of a hidden effect and the scorecard all read it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stages.science.discrepancy.resampling import resample
from stages.science.discrepancy.restoring import SearchTables
from stages.science.discrepancy.settings import DiscrepancySettings
from stages.science.discrepancy.verdict import Status, confirm_effects, confirm_status
from stages.science.discrepancy.verification import (
    Verified,
    bound_ratio,
    compare_steps,
    is_hidden,
    list_hidden,
)

DRIVEN, TEST = "measured upstream", "verification"
Draw = Callable[..., np.random.Generator]
"""Returns the generator of a purpose and a part of the trials."""


@dataclass(frozen=True)
class Decision:
    """What is said of a dataset.

    Parameters
    ----------
    status : str
        ``named``, ``unexplained`` or ``no_discrepancy``.
    status_of_fitted : str
        The same by the fitted trials alone.
    accepted : int
        Added effects that stand: all, or none.
    effects : DataFrame
        Table `named_effects`, with what `confirm_effects` adds; empty unless the status is ``named``.
    hidden : list of str
        Channels whose noise floor on the test trials hides what there is.
    over_floor : dict of str to float
        Gap of the test trials over their noise floor, in the channel where it is largest, with limits.
    left_over_std : float
        Error of the test trials over their measured standard deviation.
    uninformative : bool
        Whether that is so large that a mean would do nearly as well.
    """

    status: Status
    status_of_fitted: Status
    accepted: int
    effects: pd.DataFrame
    hidden: list[str]
    over_floor: dict[str, float]
    left_over_std: float
    uninformative: bool


def select_judged(found: SearchTables, verified: Sequence[Verified]) -> list[Verified]:
    """Return the outputs of the channels in which something was named, or all where nothing was."""
    concerned = set(found.named_effects["channel"]) or set(found.channels["channel"])
    return [each for each in verified if each.output.channel in concerned]


def compare_part(
    found: SearchTables,
    judged: Sequence[Verified],
    part: str,
    trials: Sequence[int],
    settings: DiscrepancySettings,
    draw: Draw,
) -> list[dict[str, object]]:
    """Return the gap of some trials before and after each addition, and the noise floor; see `compare_steps`.

    Parameters
    ----------
    found : SearchTables
        What the search found.
    judged : sequence of Verified
        Outputs that count.
    part : str
        What the trials are for.
    trials : sequence of int
        Their positions.
    settings : DiscrepancySettings
        Number of resamplings and level.
    draw : callable
        Returns the generator of a purpose and a part.
    """
    added = found.named_effects.drop_duplicates("order")
    labels = ["nominal", *(f"+ {name}" for name in added["name"])][: found.last_step + 1]
    weights = resample(len(trials), settings.bootstraps, draw("resample", part))
    rows = compare_steps(judged, labels, trials, weights, settings.level, draw("signs", part))
    return [{"part": part, **row} for row in rows]


def decide(
    found: SearchTables,
    verified: Sequence[Verified],
    verification: pd.DataFrame,
    test: Sequence[int],
    settings: DiscrepancySettings,
    draw: Draw,
) -> Decision:
    """Return what is said of a dataset.

    Parameters
    ----------
    found : SearchTables
        What the search found.
    verified : sequence of Verified
        All outputs on all trials.
    verification : DataFrame
        Rows of `compare_part`, those of the test trials among them.
    test : sequence of int
        Positions of the test trials.
    settings : DiscrepancySettings
        When a gap matters and a name is accepted.
    draw : callable
        Returns the generator of a purpose and a part.
    """
    channels, limits = found.channels, settings.search.remainder
    status = found.read_status(settings.search.certain)
    accepted = found.last_step if status == "named" else 0
    driven = select_driven(verification)
    hidden = list_hidden(verified, channels, test, limits)
    weights = resample(len(test), settings.bootstraps, draw("resample", TEST))
    over_floor = bound_ratio(verified, accepted, test, weights, settings.level)
    left_over_std = float(driven["gap_over_std"].iloc[accepted])
    uninformative = left_over_std > settings.confirmation.uninformative_error
    blind = bool(hidden) or is_hidden(channels, limits) or uninformative
    said = confirm_status(status, over_floor["value"], settings.search.smallest_gap, blind)
    effects = confirm_effects(found.named_effects, driven, settings, hidden)
    return Decision(
        said,
        status,
        accepted,
        effects if said == "named" else effects.iloc[:0],
        hidden,
        over_floor,
        left_over_std,
        uninformative,
    )


def select_driven(verification: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that decide: test trials, simulated from measured upstream signals."""
    driven = (verification["simulation"] == DRIVEN) & (verification["part"] == TEST)
    return verification[driven].reset_index(drop=True)
