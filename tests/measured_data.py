"""A small measured dataset for tests: two muscles of one joint whose every column follows from a formula."""

import json

import numpy as np
import pandas as pd
import pytest

from pipeline.config import read_study
from pipeline.errors import InputError
from tests.composing import compose_values
from tests.studies import run_stage

RATE_HZ = 250.0
GEOMETRY = {
    "pam1": {"moment_arm_m": 0.04, "rest_length_m": 0.32, "contraction_at_angle_0": 0.02, "sign": 1},
    "pam2": {"moment_arm_m": 0.03, "rest_length_m": 0.30, "contraction_at_angle_0": 0.19, "sign": -1},
}


def make_samples(trials=3, samples=100, muscles=("pam1", "pam2")):
    """Return tidy rows by trial, time and muscle, as in samples.parquet."""
    time_s = np.arange(samples) / RATE_HZ
    frames = []
    for trial in range(trials):
        angle, velocity = 0.5 + 0.3 * np.sin(5.0 * time_s + trial), 1.5 * np.cos(5.0 * time_s + trial)
        for muscle in muscles:
            place = GEOMETRY[muscle]
            per_rad = place["sign"] * place["moment_arm_m"] / place["rest_length_m"]
            columns = {
                "trial": trial,
                "time_s": time_s,
                "muscle": muscle,
                "pressure_command_kpa": 150.0 + 50.0 * np.sin(3.0 * time_s + trial),
                "pressure_kpa": 148.0 + 50.0 * np.sin(3.0 * time_s + trial - 0.1),
                "contraction": place["contraction_at_angle_0"] + per_rad * angle,
                "contraction_velocity_per_s": per_rad * velocity,
                "force_n": 300.0 + 100.0 * np.cos(4.0 * time_s),
                "joint_angle_rad": angle,
                "joint_velocity_rad_per_s": velocity,
            }
            frames.append(pd.DataFrame(columns))
    return pd.concat(frames).sort_values(["trial", "time_s", "muscle"]).reset_index(drop=True)


def make_meta(**changed):
    """Return what meta.json holds."""
    muscles = {
        name: {"joint": "SFE", "role": role, "type": kind, "nominal_diameter_m": wide, **GEOMETRY[name]}
        for name, role, kind, wide in (("pam1", "agonist", "MAS-40", 0.04), ("pam2", "antagonist", "MAS-10", 0.01))
    }
    nominal = {"valve_tau_s": 0.04, "damping_n_s": {"pam1": 90.0, "pam2": 7.5}}
    told = {"sampling_rate_hz": RATE_HZ, "load_cell_site": "joint_end", "muscles": muscles, "nominal": nominal}
    return {**told, **changed}


def write_dataset(folder, samples=None, meta=None):
    """Write a dataset and return its folder."""
    folder.mkdir(exist_ok=True)
    (make_samples() if samples is None else samples).to_parquet(folder / "samples.parquet")
    (folder / "meta.json").write_text(json.dumps(make_meta() if meta is None else meta))
    return folder


def read_measured(tmp_path, path, *overrides):
    """Return the tables that the stage makes of a path."""
    composed = compose_values("workflow=discrepancy", f"measured={path}", *overrides)
    composed.workflow.stages, composed.workflow.headline = ["measurement"], []
    composed.workflow.quoted = [str(name) for name in composed]
    study, (stage,) = read_study(composed)
    return run_stage(study, stage, tmp_path, {})


def refuse_measured(tmp_path, path, *overrides):
    """Return the line in which a path is refused."""
    with pytest.raises(InputError) as refused:
        read_measured(tmp_path, path, *overrides)
    assert "\n" not in str(refused.value)
    return str(refused.value)
