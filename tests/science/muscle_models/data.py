"""A small bank of a smooth law, as the tables that offline analyses read."""

import hashlib
from itertools import product

import numpy as np
import pandas as pd

from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT

MUSCLES = ("pam1", "pam2")
HYPERPARAMETERS = {
    "log_length_pressure": 0.5,
    "log_length_contraction": 0.5,
    "log_length_velocity": 0.5,
    "log_signal_sd": 0.0,
    "log_noise_sd": -2.5,
}
PERIOD_S = 0.02


def make_bank(generator, movements=7, samples=50):
    """Return recordings: random sums of sines, and a force that follows from them, N."""
    times = PERIOD_S * np.arange(samples)
    frames = []
    for trajectory, (position, muscle) in product(range(movements), enumerate(MUSCLES)):
        pressure, contraction, velocity = (
            generator.normal() + np.sin(generator.uniform(2, 9) * times + generator.uniform(0, 6)) for _ in range(3)
        )
        force = 50 + 20 * np.sin(pressure + position) + 8 * contraction**2 + 5 * np.tanh(velocity)
        force += 0.3 * generator.standard_normal(samples)
        inputs = dict(zip(MODEL_INPUTS, (100 + 30 * pressure, 0.1 + 0.05 * contraction, 0.2 * velocity), strict=True))
        frames.append(
            pd.DataFrame({"trajectory": trajectory, "time_s": times, "muscle": muscle, **inputs, MODEL_OUTPUT: force})
        )
    return pd.concat(frames, ignore_index=True)


def make_tables(generator, every=5, **sizes):
    """Return bank, candidates, hyperprior and scaling, by name."""
    bank = make_bank(generator, **sizes)
    rank = bank.groupby(["trajectory", "muscle"]).cumcount()
    candidates = bank.loc[rank % every == 0].drop(columns=MODEL_OUTPUT)
    prior = [(muscle, name, mean, 0.5) for muscle in MUSCLES for name, mean in HYPERPARAMETERS.items()]
    constants = zip((*MODEL_INPUTS, MODEL_OUTPUT), (100, 0.1, 0.0, 50), (30, 0.05, 0.2, 15), strict=True)
    scaling = [(muscle, *each) for each in list(constants) for muscle in MUSCLES]
    return {
        "bank": bank,
        "candidates": candidates,
        "hyperprior": pd.DataFrame(prior, columns=["muscle", "hyperparameter", "mean", "variance"]),
        "scaling": pd.DataFrame(scaling, columns=["muscle", "quantity", "centre", "scale"]),
    }


def draw(*key):
    """Return the generator of a key."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()[:8], "big"))


LOOP = {
    "trials": 3,
    "initial_trials": 2,
    "initial_points": 6,
    "points_per_trial": 2,
    "utility": "y_y",
    "subsample_utility": "y_y",
    "reduce": "sum",
    "reuse_trajectories": False,
    "joint_every": 2,
    "starts": 2,
    "memory_mb": 64.0,
}
