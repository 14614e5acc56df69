"""The emulated CPX-E vents as the device would, and moves as the simulated machine does."""

import numpy as np
import pytest

from stages.science.rig import clock
from stages.science.rig.sim import SimulatedRig
from stages.science.rig.trial import Trial
from tests.cpx_e.rig import describe_machine, describe_rig
from tests.cpx_e.turned import emulate
from tests.science.plant.machines import configured

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
from pymodbus.client import ModbusTcpClient

KPA, RAD, N = 0.03125, 6.283185307e-4, np.array([0.1, 0.025, 0.1, 0.025])
"""What a count is worth."""
OUTPUTS, INPUTS, TIMEOUT = 40003, 45395, 46100
HALF = [3200] * 4
"""Counts of 100 kPa."""


@pytest.fixture
def emulator():
    with emulate(describe_machine(describe_rig("exoskeleton.trial_s=2.0"))) as emulator:
        yield emulator


@pytest.fixture
def client(emulator):
    connected = ModbusTcpClient("127.0.0.1", port=emulator.port, timeout=0.1, retries=0)
    assert connected.connect()
    yield connected
    connected.close()


def test_watchdog_vents_in_time_and_not_before(emulator, client):
    client.write_registers(TIMEOUT, [200])
    for _ in range(10):
        client.write_registers(OUTPUTS, HALF)
        clock.sleep(0.05)
    assert emulator.state()["vented_at_s"] is None
    client.write_registers(OUTPUTS, HALF)
    last = emulator.state()["last_request_at_s"]
    clock.sleep(0.199)
    assert emulator.state()["watchdog_count"] == 0
    clock.sleep(0.01)
    state = emulator.state()
    assert state["watchdog_count"] == 1
    assert 0.2 < state["watchdog_fired_at_s"] - last < 0.205
    assert state["vented_at_s"] == state["watchdog_fired_at_s"]
    assert state["outputs_kpa"] == [0.0] * 4
    assert client.read_holding_registers(OUTPUTS, count=4).registers == [0] * 4


def play(emulator, client, command):
    """Write a command at the machine's rate while nobody moves, and return what is read before each write."""
    counts = np.round(command / KPA).astype(int).tolist()
    client.write_registers(OUTPUTS, counts[0])
    clock.sleep(0.3)
    started, read = emulator.trial(kind="passive", samples=len(command), lead_samples=0), []
    for k, each in enumerate(counts):
        clock.sleep(started + 0.01 * (k + 0.5) - clock.now_s())
        words = client.readwrite_registers(read_address=INPUTS, read_count=31, write_address=OUTPUTS, values=each)
        read.append(words.registers)
    signed = (np.array(read, dtype=float) + 32768.0) % 65536.0 - 32768.0
    return KPA * signed[:, 5:9], N * signed[:, 10:14], RAD * signed[:, [15, 23]]


def simulate(command):
    told = configured().model_dump()
    told["exoskeleton"] |= {"sampling_rate_hz": 100.0, "trial_s": len(command) / 100.0}
    with SimulatedRig.model_validate(told | {"lead_in_s": 0.0}) as rig:
        return rig.execute(Trial("passive", "nobody", command), np.random.default_rng(0))


def test_passive_trial_goes_as_in_simulation(emulator, client):
    command = np.full((100, 4), 100.0)
    command[30:70] += [20.0, 60.0, 10.0, 30.0]
    pressure, force, angle = play(emulator, client, command)
    expected = simulate(command)
    off = np.abs(pressure - expected.pressure_kpa)
    assert 1.4826 * np.median(off, axis=0) == pytest.approx(0.4 * 2**0.5, rel=0.45)
    assert off.max() < 3.0
    assert np.abs(angle - expected.joint_angle_rad).max() < 0.005
    assert np.sqrt(((force - expected.force_n) ** 2).mean(axis=0)).max() < 4.5
