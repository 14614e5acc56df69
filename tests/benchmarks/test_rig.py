"""The real rig's loop against an emulated device: whether it keeps its rate, and what a turn costs of its period."""

import numpy as np
import pandas as pd
import pytest

from stages.rig.contract import Trial, tidy
from stages.rig.pacing import measure_pace
from tests.cpx_e.emulator import Emulator
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")

TRIALS = 10


def test_a_hundred_turns_a_second_are_held_for_ten_trials():
    section = describe_rig()
    with Emulator(describe_machine(section)) as emulator:
        rig = build_rig(section, emulator.port, emulator.control_port)
        command = np.full((rig.samples, 4), 100.0) + 30.0 * np.sin(np.linspace(0.0, 20.0, rig.samples))[:, None]
        with rig:
            frames = [
                pd.DataFrame(tidy(rig.execute(Trial("free", "experimenter", command), np.random.default_rng(k)), rig))
                for k in range(TRIALS)
            ]
    recordings = pd.concat([frame.assign(trial=k) for k, frame in enumerate(frames)])
    pace = measure_pace(recordings, ["trial"])
    print(f"\n{TRIALS} trials at 100 Hz: {pace}")
    assert pace.samples == TRIALS * 400
    assert pace.p50_s == pytest.approx(0.01, rel=0.02)
    assert pace.overruns < 0.01 * pace.samples
