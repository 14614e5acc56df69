"""Which trials are fitted, which are test trials (opened once, at the end), and which are only reported.

The parts and records that a recording tells of its trials flow in; what each trial is for flows out, and how many
samples keep neighbouring ones apart.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Self

import pandas as pd
from pydantic import Field, model_validator

from stages.science.discrepancy.settings import choose_verification
from stages.science.plant.declaration import Declared, nearest
from stages.science.recording.blocks import PROPOSED

PURPOSES = FITTED, VERIFICATION, OTHER = "fitted", "verification", "other"
FEWEST_RECORDS = 3
"""Records of one part from which whole ones are kept aside: two to fit, one to open."""
Names = Annotated[list[str], Field(min_length=1)]


class Parts(Declared):
    """Parts of a recording that have a purpose; null where the workflow is to choose."""

    fitted: Names | None = Field(description="parts that are fitted; null = all but those of verification")
    verification: Names | None = Field(description="parts opened once; null = trials spread over the fitted parts")
    last_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = Field(
        description="share of the fitted parts' trials, at the end, that is opened; null = spread evenly"
    )
    gap_share: Annotated[float, Field(ge=0.0, lt=0.5)] = Field(
        description="share of a fitted block that is left out where it meets one that is opened"
    )

    @model_validator(mode="after")
    def _keep_apart(self) -> Self:
        both = sorted(set(self.fitted or []) & set(self.verification or []))
        if both:
            raise ValueError(f"expected parts that are either fitted or opened for verification, got {both[0]} in both")
        if self.verification and self.last_share is not None:
            raise ValueError("expected verification or last_share, got both; set one of them to null")
        return self


def list_parts(trials: pd.DataFrame, parts: Parts, share: float) -> pd.DataFrame:
    """Return what each trial is for, by `assign_parts`, and how many of its samples are left out: `trial_parts`.

    Trials have columns ``trial part record samples``, in the order of time within a record.
    """
    purposes = assign_parts(list(trials["part"]), parts, share, list(trials["record"]))
    told = pd.DataFrame({"trial": trials["trial"].to_numpy(), "part": purposes})
    return told.join(leave_gaps(trials, purposes, parts.gap_share))


def assign_parts(given: Sequence[str], parts: Parts, share: float, records: Sequence[str] = ()) -> list[str]:
    """Return what each trial is for: ``fitted``, ``verification`` or ``other``.

    `given` is the part of each trial, as recorded, and `records` the record that it is a block of; empty where trials
    are no blocks. Where no part is named for that, a share of the fitted parts' trials become test trials: of a part
    with at least three records, whole records do.

    Raises
    ------
    ValueError
        When a part is unknown, or when there are fewer than two trials to fit or none to open.
    """
    for name in [*(parts.fitted or []), *(parts.verification or [])]:
        if name not in given:
            raise ValueError(f"parts: no part '{name}' was recorded; {nearest(name, set(given))}")
    test = parts.verification or []
    candidates = [k for k, part in enumerate(given) if part not in test and part in (parts.fitted or given)]
    chosen = [k for k, part in enumerate(given) if part in test]
    if not chosen and parts.last_share is not None:
        chosen = _choose_last([k for k in candidates if given[k] != PROPOSED], records, parts.last_share)
    if not chosen:
        chosen = _choose([k for k in candidates if given[k] != PROPOSED], given, records, share)
    fitted = [k for k in candidates if k not in chosen]
    if len(fitted) < 2:
        raise ValueError(f"parts: expected at least 2 trials to fit, got {len(fitted)}; name other parts")
    return [VERIFICATION if k in chosen else FITTED if k in fitted else OTHER for k in range(len(given))]


def _choose_last(candidates: Sequence[int], records: Sequence[str], share: float) -> list[int]:
    """Return the last trials: of each record that has several blocks its own last ones, of all others the last."""
    blocks: dict[str, list[int]] = {}
    for k in candidates:
        blocks.setdefault(records[k] if records else "", []).append(k)
    single = [k for own in blocks.values() if len(own) == 1 for k in own]
    streams = [single, *(own for own in blocks.values() if len(own) > 1)]
    return sorted(k for own in streams for k in own[len(own) - max(round(share * len(own)), 1) :])


def _choose(candidates: Sequence[int], given: Sequence[str], records: Sequence[str], share: float) -> list[int]:
    """Return which trials are opened: whole records of the parts that have enough of them, else spread evenly."""
    held: dict[str, list[str]] = {}
    for k in candidates if records else []:
        held.setdefault(given[k], []).append(records[k])
    distinct = {part: list(dict.fromkeys(names)) for part, names in held.items() if all(names)}
    whole = {part: names for part, names in distinct.items() if len(names) >= FEWEST_RECORDS}
    taken = set()
    for names in whole.values():
        nearest_share = max(math.floor(share * len(names) + 0.5), 1) / len(names)  # opens a whole number of records
        taken |= {names[k] for k in choose_verification(len(names), nearest_share)}
    rest = [k for k in candidates if given[k] not in whole]
    chosen = [k for k in candidates if given[k] in whole and records[k] in taken]
    if rest and (len(rest) >= FEWEST_RECORDS or not whole):
        chosen += [rest[k] for k in choose_verification(len(rest), share)]
    return chosen


def leave_gaps(trials: pd.DataFrame, purposes: Sequence[str], share: float) -> pd.DataFrame:
    """Return how many samples of each trial are left out: columns ``left_before`` and ``left_after``.

    Noise is correlated in time, so a fitted block next to a test block would know some of its noise. The fitted block
    therefore ends earlier, or begins later, by a share of it; the test block stays whole. A trial's ``record`` is empty
    where trials do not follow each other.
    """
    before, after = [0] * len(trials), [0] * len(trials)
    records, left = list(trials["record"]), [math.ceil(share * samples) for samples in trials["samples"]]
    for k in [k for k in range(len(trials) - 1) if records[k] and records[k] == records[k + 1]]:
        if (purposes[k], purposes[k + 1]) == (FITTED, VERIFICATION):
            after[k] = left[k]
        if (purposes[k], purposes[k + 1]) == (VERIFICATION, FITTED):
            before[k + 1] = left[k + 1]
    return pd.DataFrame({"left_before": before, "left_after": after})
