"""Verdicts of twelve short sessions, beside this file; `python -m tests.benchmark.verdicts` stores them anew."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.scenarios import named_scenario
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.settings import choose_verification
from stages.science.recording.datasets import tabulate_session
from stages.science.scorecard.judgement import judge
from tests.science.discrepancy.searches import DISCREPANCY

STORED = Path(__file__).with_suffix(".yaml")
TRIALS = 10
SESSIONS = (
    "none-75",
    "transport_delay-strong-71",
    "hysteresis-strong-73",
    "creep-medium-76",
    "cubic_stiffness-medium-79",
    "neighbour_pressure-strong-78",
    "foreign_building:none-100001",
    "foreign_building:none-100024",
    "foreign_building:force_late-strong-100169",
    "foreign_building:duhem-strong-100241",
    "foreign_building:bristle_friction-medium-100204",
    "foreign_building:dead_band-medium-100132",
)


def decide_on(name, trials=16):
    """Return what is said of a session of the blinded rig."""
    recorded = simulate(replace(named_scenario(name), trials=trials))
    tables = tabulate_session(recorded.samples, recorded.meta, name)
    outputs = build_muscle_channels(tables, DISCREPANCY)
    test = choose_verification(trials, DISCREPANCY.verification_share)
    return judge(outputs, test, DISCREPANCY, lambda *purpose: np.random.default_rng(len(purpose))).decision


def describe(said):
    """Return a decision in plain values: status, names with probabilities, and what is left by channel."""
    return {
        "status": said.status,
        "named": {each.name: round(float(each.probability), 2) for each in said.effects},
        "left": {channel: each.family for channel, each in said.remainders.items() if each.unknown > 0.5},
    }


if __name__ == "__main__":
    STORED.write_text(yaml.safe_dump({name: describe(decide_on(name, TRIALS)) for name in SESSIONS}, sort_keys=False))
