"""Which trials are fitted, which are opened once at the end, and which are only reported.

The parts that a recording tells of its trials flow in; what each trial is for flows out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field, model_validator

from stages.discrepancy.settings import choose_verification
from stages.plant.declaration import Declared, nearest

PURPOSES = FITTED, VERIFICATION, OTHER = "fitted", "verification", "other"
Names = Annotated[list[str], Field(min_length=1)]


class Parts(Declared):
    """Parts of a recording that have a purpose; null where the workflow is to choose."""

    fitted: Names | None = Field(description="parts that are fitted; null = all but those of verification")
    verification: Names | None = Field(description="parts opened once; null = trials spread over the fitted parts")
    last_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = Field(
        description="share of the fitted parts' trials, at the end, that is opened; null = spread evenly"
    )

    @model_validator(mode="after")
    def _keep_apart(self) -> Self:
        both = sorted(set(self.fitted or []) & set(self.verification or []))
        if both:
            raise ValueError(f"expected parts that are either fitted or opened for verification, got {both[0]} in both")
        if self.verification and self.last_share is not None:
            raise ValueError("expected verification or last_share, got both; set one of them to null")
        return self


def assign_parts(given: Sequence[str], parts: Parts, share: float) -> list[str]:
    """Return what each trial is for: ``fitted``, ``verification`` or ``other``.

    Parameters
    ----------
    given : sequence of str
        Part of each trial, as recorded.
    parts : Parts
        Which parts are fitted and opened.
    share : float
        Of the fitted parts' trials that are opened, where no part is named for that.

    Raises
    ------
    ValueError
        When a part is unknown, or when there are fewer than two trials to fit or none to open.
    """
    for name in [*(parts.fitted or []), *(parts.verification or [])]:
        if name not in given:
            raise ValueError(f"parts: no part '{name}' was recorded; {nearest(name, set(given))}")
    opened = parts.verification or []
    candidates = [k for k, part in enumerate(given) if part not in opened and part in (parts.fitted or given)]
    chosen = [k for k, part in enumerate(given) if part in opened]
    if not chosen and parts.last_share is not None:
        chosen = candidates[len(candidates) - max(round(parts.last_share * len(candidates)), 1) :]
    if not chosen:
        chosen = [candidates[k] for k in choose_verification(len(candidates), share)]
    fitted = [k for k in candidates if k not in chosen]
    if len(fitted) < 2:
        raise ValueError(f"parts: expected at least 2 trials to fit, got {len(fitted)}; name other parts")
    return [VERIFICATION if k in chosen else FITTED if k in fitted else OTHER for k in range(len(given))]
