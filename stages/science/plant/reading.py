"""What a sensor that ends shows of a signal: nothing beyond its lowest and its highest reading, or a share less.

Signals flow in, readings in the same unit flow out. All machines whose records are simulated read by this.
"""

from __future__ import annotations

import numpy as np

from stages.science.signals.trajectories import Array


def read(signal: Array, unread: Array | float, lowest: Array | float, highest: Array | float) -> Array:
    """Return a signal less a share of what lies beyond its ends; bit for bit itself where the share is zero.

    Parameters
    ----------
    signal : (T, ...) ndarray
        What is measured.
    unread : float or ndarray
        Share of what lies beyond an end that is not read: 1 for a sensor that stops there.
    lowest, highest : float or ndarray
        Ends, in the signal's unit; infinite where there is none.
    """
    if not np.any(unread):
        return signal
    shown = np.clip(signal, lowest, highest)
    left = (1.0 - np.asarray(unread)) * (signal - shown)
    return np.where(np.equal(unread, 0.0), signal, shown + left)
