"""Sessions of machines whose static law is not the textbook's: what has no name gets none, what has one keeps it."""

from dataclasses import replace

import numpy as np
import pytest

from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.sessions import named_scenario
from stages.science.discrepancy.judgement import judge
from stages.science.discrepancy.muscle_dataset import build_muscle_channels
from stages.science.discrepancy.settings import choose_verification
from stages.science.recording.datasets import tabulate_session
from tests.science.discrepancy.searches import DISCREPANCY


def decide_on(name, trials=16):
    """Return what is said of a session of a foreign machine."""
    recorded = simulate(replace(named_scenario(f"foreign_building:{name}", "foreign_building"), trials=trials))
    tables = tabulate_session(recorded.samples, recorded.meta, name)
    outputs = build_muscle_channels(tables, DISCREPANCY)
    test = choose_verification(trials, DISCREPANCY.verification_share)
    return judge(outputs, test, DISCREPANCY, lambda *purpose: np.random.default_rng(len(purpose))).decision


@pytest.mark.parametrize("seed", [100000, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (100001, 100009))])
def test_a_law_that_is_not_the_nominal_one_gets_no_name(seed):
    said = decide_on(f"none-{seed}")
    assert (said.status, said.effects) == ("unexplained", [])
    assert said.remainders["force_n"].family == "static_map"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("session", "name", "channel"),
    [
        ("force_late-strong-100169", "channel_misalignment", "force_n"),
        ("duhem-strong-100241", "hysteresis", "force_n"),
        ("transport_delay-strong-100160", "transport_delay", "pressure_kpa"),
    ],
)
def test_what_is_there_beside_a_wrong_law_is_named(session, name, channel):
    said = decide_on(session)
    assert [(each.name, each.channel) for each in said.effects[:1]] == [(name, channel)]
    assert said.effects[0].probability > 0.8
