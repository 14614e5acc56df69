"""Measured sessions with something wrong with them: short ones of the hidden rig, spoilt in one way each."""

import numpy as np
import pandas as pd

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.scenarios import Scenario

TWO = ("pam1", "pam2")


def record_session(effects=(), trials=6, seconds=1.2, muscles=TWO, seed=11, magnitude="strong"):
    """Return samples and what meta.json says, of the first part of each trial."""
    made = simulate(Scenario(tuple(effects), magnitude, seed, trials=trials))
    samples = made.samples[made.samples["muscle"].isin(muscles) & (made.samples["time_s"] < seconds - 1e-9)]
    told = {name: facts for name, facts in made.meta["muscles"].items() if name in muscles}
    return samples.reset_index(drop=True), {**made.meta, "muscles": told}


def lose_stretches(samples):
    """Unequal trials, and stretches without force, pressure or contraction, other ones in each."""
    spoilt = samples[samples["time_s"] < 0.6 + 0.1 * samples["trial"]].copy()
    for signal, start in (("force_n", 0.3), ("pressure_kpa", 0.6), ("contraction", 0.8)):
        first = start + 0.02 * spoilt["trial"]
        spoilt.loc[spoilt["time_s"].between(first, first + 0.15), signal] = np.nan
    return spoilt


def silence(samples):
    """One muscle has neither force nor pressure."""
    return samples.assign(**samples[["force_n", "pressure_kpa"]].where(samples["muscle"] != "pam2"))


def shake(samples):
    """The force of one trial is far off."""
    noise = np.random.default_rng(5).normal(0.0, 300.0, len(samples))
    return samples.assign(force_n=samples["force_n"].where(samples["trial"] != 1, 2.5 * samples["force_n"] + noise))


def hold_pressure(samples):
    """One muscle was never commanded to move."""
    still = samples["muscle"] == "pam2"
    noise = np.random.default_rng(5).normal(0.0, 0.3, len(samples))
    return samples.assign(
        pressure_command_kpa=samples["pressure_command_kpa"].where(~still, 200.0),
        pressure_kpa=samples["pressure_kpa"].where(~still, 200.0 + noise),
    )


def resample(samples, rate_hz):
    """The same session by a slower or quicker recorder: straight lines between samples."""
    frames, key = [], ["trial", "muscle"]
    for (trial, muscle), rows in samples.groupby(key):
        time_s = np.arange(0.0, rows["time_s"].max(), 1.0 / rate_hz)
        made = {name: np.interp(time_s, rows["time_s"], rows[name]) for name in rows.columns.difference(key)}
        frames.append(pd.DataFrame({**made, "trial": trial, "muscle": muscle, "time_s": time_s}))
    return pd.concat(frames, ignore_index=True)
