"""The emulated CPX-E answers the vendor's library as the device would, and moves as the simulated machine does."""

import numpy as np
import pytest

from stages.rig import clock
from stages.rig.contract import Trial
from stages.rig.sim import SimulatedRig
from tests.cpx_e.rig import describe_machine, describe_rig
from tests.cpx_e.turned import emulate
from tests.plant.machines import configured

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
from cpx_io.cpx_system.cpx_e.cpx_e import CpxE
from cpx_io.cpx_system.cpx_e.e1ci import CpxE1Ci
from cpx_io.cpx_system.cpx_e.e4aiui import CpxE4AiUI
from cpx_io.cpx_system.cpx_e.e4aoui import CpxE4AoUI
from cpx_io.cpx_system.cpx_e.eep import CpxEEp
from pymodbus.client import ModbusTcpClient

MADE = {"EP": CpxEEp, "4AO": CpxE4AoUI, "4AI": CpxE4AiUI, "1CI": CpxE1Ci}
KPA, RAD, N = 0.03125, 6.283185307e-4, np.array([0.1, 0.025, 0.1, 0.025])
"""What a count is worth."""
HALF = [3200] * 4
"""Counts of 100 kPa."""


class Connected:
    """The vendor's library on an emulator's port."""

    def __init__(self, emulator, timeout=0.1):
        self.cpx = CpxE(modules=[])
        self.cpx.client = ModbusTcpClient("127.0.0.1", port=emulator.port, timeout=timeout, retries=0)
        assert self.cpx.client.connect()
        self.modules = [self.cpx.add_module(MADE[name]()) for name in emulator.machine["device"]["modules"]]
        self.outputs, self.pressures, self.forces = self.modules[1:4]
        self.encoders = self.modules[4:]


@pytest.fixture
def emulator():
    with emulate(describe_machine(describe_rig("exoskeleton.trial_s=2.0"))) as emulator:
        yield emulator


@pytest.fixture
def device(emulator):
    connected = Connected(emulator)
    yield connected
    connected.cpx.shutdown()


def test_it_has_the_modules_and_registers_of_its_description(device):
    assert device.cpx.module_count() == 6
    assert device.cpx.read_status() == (False, False)
    assert not any(device.cpx.read_fault_detection())
    device.outputs.configure_channel_range(0, 1)
    device.outputs.configure_channel_range(1, 2)
    assert device.cpx.read_function_number(4828 + 64 + 11) == 0x21
    client = device.cpx.client
    assert client.read_holding_registers(45366, count=1).exception_code == 2
    assert client.write_registers(45391, [1]).exception_code == 2
    assert client.read_coils(0, count=1).exception_code == 1


def test_outputs_are_read_back_and_fill_the_muscles(emulator, device):
    device.outputs.write_channels([1280, 2560, 3840, 5120])
    assert device.outputs.read_channels() == [1280, 2560, 3840, 5120]
    device.outputs[1] = 3200
    assert device.outputs.read_channels() == [1280, 3200, 3840, 5120]
    assert emulator.state()["outputs_kpa"] == pytest.approx([40, 100, 120, 160])
    clock.sleep(0.5)
    assert KPA * np.array(device.pressures.read_channels()) == pytest.approx([40, 100, 120, 160], abs=2.5)
    assert min(device.forces.read_channels()) >= 0
    joint = configured().exoskeleton.joints[0]
    middle = 0.5 * (joint.lower_rad + joint.upper_rad)
    assert RAD * device.encoders[0].read_value() == pytest.approx(middle, abs=0.003)


def test_watchdog_vents_in_time_and_not_before(emulator, device):
    device.cpx.set_timeout(200)
    for _ in range(10):
        device.outputs.write_channels(HALF)
        clock.sleep(0.05)
    assert emulator.state()["vented_at_s"] is None
    device.outputs.write_channels(HALF)
    last = emulator.state()["last_request_at_s"]
    clock.sleep(0.199)
    assert emulator.state()["watchdog_count"] == 0
    clock.sleep(0.01)
    state = emulator.state()
    assert state["watchdog_count"] == 1
    assert 0.2 < state["watchdog_fired_at_s"] - last < 0.205
    assert state["vented_at_s"] == state["watchdog_fired_at_s"]
    assert state["outputs_kpa"] == [0.0] * 4
    assert device.outputs.read_channels() == [0] * 4


def test_watchdog_counts_over_a_freeze(emulator, device):
    device.cpx.set_timeout(200)
    device.outputs.write_channels(HALF)
    emulator.freeze()
    clock.sleep(0.3)
    emulator.thaw()
    assert device.outputs.read_channels() == [0] * 4
    assert emulator.state()["watchdog_count"] == 1


def play(emulator, device, command):
    """Write a command at the machine's rate while nobody moves, and return what is read before each write."""
    counts = np.round(command / KPA).astype(int).tolist()
    device.outputs.write_channels(counts[0])
    clock.sleep(0.3)
    started, read = emulator.trial("passive", "nobody", len(command)), []
    for k, each in enumerate(counts):
        clock.sleep(started + 0.01 * (k + 0.5) - clock.now_s())
        words = device.cpx.client.readwrite_registers(
            read_address=45395, read_count=31, write_address=40003, values=each
        )
        read.append(words.registers)
    signed = (np.array(read, dtype=float) + 32768.0) % 65536.0 - 32768.0
    return KPA * signed[:, 5:9], N * signed[:, 10:14], RAD * signed[:, [15, 23]]


def simulate(command):
    told = configured().model_dump()
    told["exoskeleton"] |= {"sampling_rate_hz": 100.0, "trial_s": len(command) / 100.0}
    with SimulatedRig.model_validate(told | {"lead_in_s": 0.0}) as rig:
        return rig.execute(Trial("passive", "nobody", command), np.random.default_rng(0))


def test_passive_trial_goes_as_in_simulation(emulator, device):
    command = np.full((100, 4), 100.0)
    command[30:70] += [20.0, 60.0, 10.0, 30.0]
    pressure, force, angle = play(emulator, device, command)
    expected = simulate(command)
    off = np.abs(pressure - expected.pressure_kpa)
    assert 1.4826 * np.median(off, axis=0) == pytest.approx(0.4 * 2**0.5, rel=0.45)
    assert off.max() < 3.0
    assert np.abs(angle - expected.joint_angle_rad).max() < 0.005
    assert np.sqrt(((force - expected.force_n) ** 2).mean(axis=0)).max() < 4.5
