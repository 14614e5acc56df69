"""What a rig records that records whole sessions and knows what it hid in them.

Such a rig lies outside this package and is named by configuration.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Protocol

import pandas as pd


class RecordedSession(Protocol):
    """One session, the truth apart."""

    samples: pd.DataFrame
    """A row per trial, time and muscle, in the columns and units of a measured dataset."""
    meta: Mapping[str, Any]
    """What a user knows of the machine: geometry, starting values, timing, start of each trial."""
    truth: Mapping[str, Any]
    """What was hidden: ``scenario``, and ``effects`` with key, name, channel, muscles, gap and share.

    The gap over the floor is what an effect leaves after a nominal fit, the share what the constants absorb.
    """


def seal_truth(recorded: RecordedSession) -> str:
    """Return the SHA-256 of what was hidden in a session: the same for the same truth, and telling nothing of it."""
    return hashlib.sha256(json.dumps(recorded.truth, sort_keys=True).encode()).hexdigest()
