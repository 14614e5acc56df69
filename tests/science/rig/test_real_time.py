"""The real rig in real time, against an emulated device in a process of its own: what no turned clock can show."""

import os
import signal
import threading
import time

import numpy as np
import pandas as pd
import pytest

from stages.science.operator_ui.operator_session import OperatorSession, OperatorSettings
from stages.science.rig.attendance import TrialDeclined
from stages.science.rig.contract import TrialStopped, tidy
from stages.science.rig.pacing import measure_pace
from tests.conftest import Command
from tests.cpx_e.emulator import Emulator
from tests.cpx_e.rig import build_rig, describe_machine, describe_rig
from tests.science.rig.watching import execute, wave

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
pytestmark = pytest.mark.realtime

WATCHDOG_S = 1.0
REPLY_S = 0.4
"""Longest wait for a reply: longer than a rig's own, since the device's process may wait for a core here."""
DEVICE = f"rig.device.watchdog_s={WATCHDOG_S}", f"rig.device.reply_s={REPLY_S}", "rig.guard.missed_share=1.0"
SHORT = "exoskeleton.trial_s=1.6", "rig.lead_in_s=0.6", *DEVICE
LET_DOWN_S = 0.2
"""Time from the notice of a fault to commands of 0, where the link lives."""
LATE_S = 0.1
"""How much later than its time a watchdog may vent."""
WAKES = 3
"""Times that a turn waits for a core: when it is due, in the device's process, at the reply; a bare loop waits once."""
RUN = (
    "bank.trajectories=3",
    "subsampling.initial_trials=1",
    "active_loop.trials=1",
    "stages=[bank]",
    "rig=festo_cpx",
    "rig._target_=tests.cpx_e.rig.ToldFestoCpx",
    "rig.device.host=127.0.0.1",
    *SHORT,
)


@pytest.fixture(scope="module")
def section():
    return describe_rig(*SHORT)


@pytest.fixture(scope="module")
def emulator(section):
    with Emulator(describe_machine(section)) as emulator:
        yield emulator


@pytest.fixture
def rig(emulator, section):
    yield build_rig(section, emulator.port, emulator.control_port)
    emulator.ask("end")


@pytest.fixture
def command(emulator, tmp_path):
    return Command(tmp_path, *RUN, f"rig.device.port={emulator.port}", f"+rig.control_port={emulator.control_port}")


@pytest.fixture
def process(command):
    with command.start() as process:
        yield process
        process.kill()


def wait_for_pressure(emulator, process, after_s):
    end_s = time.monotonic() + 60.0
    while max(emulator.state(log=0)["outputs_kpa"]) <= 5.0:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end_s
        time.sleep(0.01)
    time.sleep(after_s)


def wake_late_s(turns=400, period_s=0.01):
    """Return how late a loop that does nothing but sleep wakes, s."""
    begun_s, late_s = time.monotonic(), []
    for due_s in begun_s + period_s * np.arange(turns):
        time.sleep(max(due_s - time.monotonic(), 0.0))
        late_s.append(time.monotonic() - due_s)
    return np.array(late_s)


def test_a_hundred_turns_a_second_are_held(emulator, section):
    longer = section | {"exoskeleton": section["exoskeleton"] | {"trial_s": 4.0}}
    rig = build_rig(longer, emulator.port, emulator.control_port)
    before_s = wake_late_s()
    recording = execute(rig, wave(rig))
    emulator.ask("end")
    bare_s = np.concatenate([before_s, wake_late_s()])
    measured = measure_pace(pd.DataFrame(tidy(recording, rig)), [])
    assert measured.p50_s == pytest.approx(0.01, abs=0.0005)
    assert measured.p99_s < 0.01 + max(0.005, WAKES * np.quantile(bare_s, 1.0 - 0.01 / WAKES))
    overrun_share = max(0.02, WAKES * np.mean(bare_s > 0.005 / WAKES))
    assert measured.overruns <= overrun_share * measured.samples
    taken = ((recording.status == "ok") & (recording.clipped_by == "")).all(axis=1)
    assert taken.mean() > 1.0 - max(0.03, overrun_share)
    np.testing.assert_array_equal(recording.pressure_command_kpa[taken], wave(rig).pressure_command_kpa[taken])
    assert emulator.state()["watchdog_count"] == 0


def test_an_operators_stop_lets_the_muscles_down_and_the_trial_can_be_repeated(rig, emulator):
    session = OperatorSession(OperatorSettings(countdown_s=0.0, result_s=0.0, lost_after_s=1.0, needed=[]))
    rig.connect_interface(session)
    stops, words = [], iter(["accept", "repeat", "accept", "keep"])

    def attend():
        word = next(words)
        while word:
            scene = session.see()
            if word in scene["choices"]:
                session.decide(word, "", scene["question"])
                word = next(words, None)
            elif not stops and session.moment is not None and session.moment.time_s > 0.5:
                stops.append(time.monotonic())
                session.stop("the operator stopped it")
            time.sleep(0.002)

    operator = threading.Thread(target=attend, daemon=True)
    operator.start()
    with rig:
        with pytest.raises(TrialDeclined, match="to be repeated"):
            rig.execute(wave(rig), np.random.default_rng(0))
        state = emulator.state()
        assert state["outputs_kpa"] == [0.0] * 4
        assert state["vented_at_s"] - stops[0] <= LET_DOWN_S
        assert state["watchdog_count"] == 0
        recording = rig.execute(wave(rig), np.random.default_rng(0))
    operator.join(timeout=5)
    assert len(recording.without_lead_in().time_s) == rig.samples
    assert not operator.is_alive()


def test_a_signal_lets_the_muscles_down_and_keeps_what_was_measured(emulator, process, tmp_path):
    wait_for_pressure(emulator, process, 0.8)
    sent = time.monotonic()
    os.kill(process.pid, signal.SIGTERM)
    _, told = process.communicate(timeout=30.0)
    state = emulator.state()
    assert process.returncode == 143
    assert "bank interrupted: stopped by SIGTERM; what was measured until then: " in told
    assert "to continue, type:" in told
    assert state["outputs_kpa"] == [0.0] * 4
    assert state["vented_at_s"] - sent <= LET_DOWN_S + 0.05
    (kept,) = tmp_path.glob("runs/*/interrupted/*.parquet")
    assert len(pd.read_parquet(kept)) > 200


def test_kill_9_has_the_watchdog_vent_and_leaves_what_was_measured(emulator, command, process, tmp_path):
    wait_for_pressure(emulator, process, 1.0)
    before = emulator.state(log=0)["watchdog_count"]
    process.kill()
    process.wait()
    time.sleep(WATCHDOG_S + 0.4)
    state = emulator.state()
    assert state["watchdog_count"] == before + 1
    assert state["outputs_kpa"] == [0.0] * 4
    assert WATCHDOG_S - 0.05 <= state["watchdog_fired_at_s"] - state["last_request_at_s"] <= WATCHDOG_S + LATE_S
    again = command()
    assert again.returncode == 0, again.stderr
    (kept,) = tmp_path.glob("runs/*/interrupted/*.parquet")
    rows = pd.read_parquet(kept)
    assert set(rows["stopped_by"]) == {"the process ended"}
    assert len(rows) > 200


def test_a_device_that_freezes_is_told(section):
    with Emulator(describe_machine(section)) as emulator:
        rig = build_rig(section, emulator.port, emulator.control_port)
        threading.Timer(1.2, emulator.freeze).start()
        begun_s = time.monotonic()
        with pytest.raises(TrialStopped, match=r"does not answer .*the watchdog does"):
            execute(rig, wave(rig))
        assert time.monotonic() - begun_s < 1.2 + REPLY_S + LET_DOWN_S + 0.5
