"""What a rig is that records whole sessions and knows what it hid in them.

Names of sessions flow in; recordings flow out, the truth apart. Such a rig lies outside this package and is named by
configuration.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import pandas as pd


class RecordedSession(Protocol):
    """One session.

    Attributes
    ----------
    samples : DataFrame
        A row per trial, time and muscle, in the columns and units of a measured dataset.
    meta : mapping
        What a user knows of the machine: geometry, starting values, timing, start of each trial.
    truth : mapping
        What was hidden: ``scenario``, and ``effects`` with key, name, channel, muscles, the gap over the floor that
        each leaves after a nominal fit, and the share that the constants absorb.
    """

    @property
    def samples(self) -> pd.DataFrame:
        """Samples."""

    @property
    def meta(self) -> Mapping[str, Any]:
        """What a user knows."""

    @property
    def truth(self) -> Mapping[str, Any]:
        """What was hidden."""


class SessionRig(Protocol):
    """A rig of whole sessions."""

    def catalogue(self) -> Sequence[str]:
        """Return the names of the sessions that a scorecard is made of."""

    def record(self, name: str | None = None, further: int = 0) -> RecordedSession:
        """Return the session of a name, or the one that the configuration asks for, with further trials at its end."""

    def effects(self) -> Sequence[Mapping[str, Any]]:
        """Return key, name, channel, only_form and outsider of each effect that it can hide."""

    def record_quietly(self, key: str) -> tuple[RecordedSession, RecordedSession]:
        """Return one session without noise, with an effect and without."""


def seal_truth(recorded: RecordedSession) -> str:
    """Return the SHA-256 of what was hidden in a session: the same for the same truth, and telling nothing of it."""
    return hashlib.sha256(json.dumps(recorded.truth, sort_keys=True).encode()).hexdigest()
