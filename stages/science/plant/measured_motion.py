"""What a plant makes of a recording: the force that its load cells would show at the measured pressure and motion.

Rows of recordings flow in; a force for each row flows out. Nothing is integrated: force follows from what was measured
upstream, so that an error of the plant's motion does not enter.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stages.science.plant.chain import Chain
from stages.science.plant.exoskeleton import Exoskeleton
from stages.science.plant.plant import Plant
from stages.science.signals.filtering import smooth
from stages.science.signals.scaling import MODEL_INPUTS
from stages.science.signals.trajectories import Array


def simulate_force(
    plant: Plant,
    exoskeleton: Exoskeleton,
    recordings: pd.DataFrame,
    trial: Sequence[str],
    smoothing_s: float,
    in_session: bool = False,
) -> Array:
    """Return the force, N, that the plant's load cells would show in each of N rows, (N,).

    Parameters
    ----------
    plant, exoskeleton : Plant, Exoskeleton
        Constants, effects and learned maps; the muscles, and where tension is measured.
    recordings : DataFrame
        Columns `MODEL_INPUTS`, muscle, those of `trial` and, if some samples are amiss, status; every muscle of a trial
        has the same samples, in the order of time.
    trial : sequence of str
        Columns that name a trial.
    smoothing_s : float
        Width over which pressure and velocity are smoothed, s; their noise is not simulated.
    in_session : bool
        Whether the trials follow each other without a break; else each is simulated as the first of a session, whose
        sensors have not drifted.

    Raises
    ------
    ValueError
        When the plant does not fit the machine, or a muscle of it was not recorded.
    """
    force = np.empty(len(recordings))
    muscles = recordings["muscle"].to_numpy()
    signals = {name: recordings[name].to_numpy(dtype=float) for name in MODEL_INPUTS}
    usable = recordings["status"].to_numpy() == "ok" if "status" in recordings else np.ones(len(recordings), dtype=bool)
    step_s = 1.0 / exoskeleton.sampling_rate_hz
    start_s = 0.0
    for rows in recordings.groupby(list(trial), sort=False).indices.values():
        own = [rows[muscles[rows] == name] for name in exoskeleton.muscle_names]
        missing = [name for name, each in zip(exoskeleton.muscle_names, own, strict=True) if not len(each)]
        if missing:
            raise ValueError(f"recordings: expected rows of every muscle in each trial, got none of {missing[0]}")
        at = np.stack(own, axis=1)
        pressure, contraction, velocity = (_bridge(each[at], usable[at]) for each in signals.values())
        pressure, velocity = (smooth(each, step_s, smoothing_s) for each in (pressure, velocity))
        chain = Chain(exoskeleton, plant, start_s)
        pressure = chain.unsense_pressure(pressure)
        pulled = chain.pull(pressure, contraction, velocity)[exoskeleton.load_cell_site == "joint_end"]
        force[at] = chain.sense_force(pulled, pressure, contraction, velocity)
        start_s += in_session * len(at) * step_s
    return force


def _bridge(signal: Array, usable: Array) -> Array:
    """Return a signal, (T, M), with straight lines over samples that are not usable, and its ends held."""
    if usable.all():
        return signal
    bridged, time = signal.copy(), np.arange(len(signal))
    for column, known in zip(bridged.T, usable.T, strict=True):
        if known.any():
            column[:] = np.interp(time, time[known], column[known])
    return bridged
