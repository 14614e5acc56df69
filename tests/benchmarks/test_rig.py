"""The real rig's loop against an emulated device: whether it keeps its rate, and what a turn costs of its period."""

import numpy as np
import pandas as pd
import pytest

from stages.science.rig.contract import tidy
from stages.science.rig.pacing import measure_pace
from stages.science.rig.trial import Trial
from tests.cpx_e.emulator import Emulator
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")


@pytest.mark.long
def test_a_hundred_turns_a_second_are_held(benchmark, tell):
    """Over ten trials; those in real time that CI runs look at fewer."""
    trials = 10
    section = describe_rig()
    with Emulator(describe_machine(section)) as emulator:
        rig = build_rig(section, emulator.port, emulator.control_port)
        command = np.full((rig.samples, 4), 100.0) + 30.0 * np.sin(np.linspace(0.0, 20.0, rig.samples))[:, None]

        def execute_trials():
            with rig:
                return [
                    tidy(rig.execute(Trial("free", "experimenter", command), np.random.default_rng(k)), rig)
                    for k in range(trials)
                ]

        recorded = benchmark.pedantic(execute_trials, rounds=1)
    pace = measure_pace(pd.concat([pd.DataFrame(each).assign(trial=k) for k, each in enumerate(recorded)]), ["trial"])
    assert pace.samples == trials * 400
    tell("loop of the real rig at 100 Hz, median period", 1e3 * pace.p50_s, "ms")
    tell("loop of the real rig at 100 Hz, 99th percentile", 1e3 * pace.p99_s, "ms")
    tell("loop of the real rig at 100 Hz, overruns", 100.0 * pace.overruns / pace.samples, "%", limit=1.0)
