"""The emulated CPX-E answers the vendor's library as the device would, and its faults are what they say."""

import select
import socket

import numpy as np
import pytest

from stages.rig import clock
from stages.rig.contract import Trial
from stages.rig.sim import SimulatedRig
from tests.cpx_e.described import describe
from tests.cpx_e.turned import emulate
from tests.plant.machines import configured

pytest.importorskip("cpx_io", reason="festo-cpx-io is not installed")
from cpx_io.cpx_system.cpx_e.cpx_e import CpxE
from cpx_io.cpx_system.cpx_e.e1ci import CpxE1Ci
from cpx_io.cpx_system.cpx_e.e4aiui import CpxE4AiUI
from cpx_io.cpx_system.cpx_e.e4aoui import CpxE4AoUI
from cpx_io.cpx_system.cpx_e.eep import CpxEEp
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

MADE = {"EP": CpxEEp, "4AO": CpxE4AoUI, "4AI": CpxE4AiUI, "1CI": CpxE1Ci}


class Connected:
    """The vendor's library on an emulator's port."""

    def __init__(self, emulator, timeout=0.1):
        self.cpx = CpxE(modules=[])
        self.cpx.client = ModbusTcpClient("127.0.0.1", port=emulator.port, timeout=timeout, retries=0)
        assert self.cpx.client.connect()
        self.modules = [self.cpx.add_module(MADE[name]()) for name in emulator.machine["device"]["modules"]]
        self.outputs, self.pressures, self.forces = self.modules[1:4]
        self.encoders = self.modules[4:]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.cpx.shutdown()


@pytest.fixture
def emulator():
    with emulate(describe()) as emulator:
        yield emulator


@pytest.fixture
def device(emulator):
    with Connected(emulator) as connected:
        yield connected


def test_it_has_the_modules_of_its_description(device):
    assert device.cpx.module_count() == 6
    assert device.cpx.read_status() == (False, False)
    assert not any(device.cpx.read_fault_detection())
    assert device.cpx.read_device_info()["vendor_name"] == "Festo"


def test_outputs_are_read_back_and_fill_the_muscles(emulator, device):
    device.outputs.write_channels([1000, 2000, 3000, 4000])
    assert device.outputs.read_channels() == [1000, 2000, 3000, 4000]
    device.outputs[1] = 2500
    assert device.outputs.read_channels() == [1000, 2500, 3000, 4000]
    assert emulator.state()["outputs_kpa"] == pytest.approx([40, 100, 120, 160])
    clock.sleep(0.5)
    assert 0.04 * np.array(device.pressures.read_channels()) == pytest.approx([40, 100, 120, 160], abs=2.5)
    assert min(device.forces.read_channels()) >= 0


def test_parameters_are_remembered(device):
    device.outputs.configure_channel_range(0, 1)
    device.outputs.configure_channel_range(1, 2)
    assert device.cpx.read_function_number(4828 + 64 + 11) == 0x21
    device.pressures.configure_channel_limits(2, upper=30000, lower=-5)
    assert device.cpx.read_function_number(4828 + 2 * 64 + 17 + 4) == 0xFB
    device.encoders[0].configure_signal_evaluation(2)


def test_counters_show_the_joint_and_can_be_set(device):
    joint = configured().exoskeleton.joints[0]
    middle = 0.5 * (joint.lower_rad + joint.upper_rad)
    counter = device.encoders[0]
    assert 0.000628 * counter.read_value() == pytest.approx(middle, abs=0.003)
    counter.configure_load_value(5)
    counter.write_process_data(set_counter=True)
    shown = (counter.read_value() + 2**31) % 2**32 - 2**31
    assert shown == pytest.approx(5, abs=4)
    assert counter.read_status_word().counter_set
    counter.write_process_data(set_counter=False)
    counter.configure_load_value(round(middle / 0.000628))
    counter.write_process_data(set_counter=True)
    counter.write_process_data(set_counter=False)


def test_addresses_that_are_not_there_are_refused(device):
    client = device.cpx.client
    assert client.read_holding_registers(45366, count=1).exception_code == 2
    assert client.write_registers(45391, [1]).exception_code == 2
    assert client.read_coils(0, count=1).exception_code == 1
    both = client.readwrite_registers(read_address=45395, read_count=4, write_address=40003, values=[7, 8, 9, 10])
    assert both.registers == [7, 8, 9, 10]


def test_watchdog_vents_in_time_and_not_before(emulator, device):
    device.cpx.set_timeout(200)
    for _ in range(10):
        device.outputs.write_channels([2500] * 4)
        clock.sleep(0.05)
    assert emulator.state()["vented_at_s"] is None
    device.outputs.write_channels([2500] * 4)
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
    device.outputs.write_channels([2500] * 4)
    emulator.freeze()
    clock.sleep(0.3)
    emulator.thaw()
    assert device.outputs.read_channels() == [0] * 4
    assert emulator.state()["watchdog_count"] == 1


def play(emulator, device, command, announce):
    """Write a command at the machine's rate and return what is read before each write."""
    counts = np.round(command / 0.04).astype(int).tolist()
    device.outputs.write_channels(counts[0])
    clock.sleep(0.3)
    step_s = 1.0 / emulator.machine["exoskeleton"]["sampling_rate_hz"]
    started = announce()
    read = []
    for k, each in enumerate(counts):
        clock.sleep(started + (k + 0.5) * step_s - clock.now_s())
        client = device.cpx.client
        words = client.readwrite_registers(read_address=45395, read_count=31, write_address=40003, values=each)
        read.append(words.registers)
    values = np.array(read, dtype=float)
    signed = (values + 32768.0) % 65536.0 - 32768.0
    return 0.04 * signed[:, 5:9], 0.2 * signed[:, 10:14], 0.000628 * signed[:, [15, 23]]


def simulated(kind, who, command, reference=None):
    told = configured().model_dump()
    told["exoskeleton"] |= {"sampling_rate_hz": 100.0, "trial_s": len(command) / 100.0}
    rig = SimulatedRig.model_validate(told | {"lead_in_s": 0.0})
    with rig:
        return rig.execute(Trial(kind, who, command, reference), np.random.default_rng(0))


def test_passive_trial_goes_as_in_simulation(emulator, device):
    command = np.full((100, 4), 100.0)
    command[30:70] += [20.0, 60.0, 10.0, 30.0]
    pressure, force, angle = play(emulator, device, command, lambda: emulator.trial("passive", "nobody", 100))
    expected = simulated("passive", "nobody", command)
    off = np.abs(pressure - expected.pressure_kpa)
    assert 1.4826 * np.median(off, axis=0) == pytest.approx(0.4 * 2**0.5, rel=0.45)
    assert off.max() < 3.0
    assert np.abs(angle - expected.joint_angle_rad).max() < 0.005
    assert np.sqrt(((force - expected.force_n) ** 2).mean(axis=0)).max() < 4.5


def test_cut_drops_clients_and_refuses_new_ones(emulator, device):
    emulator.fault("cut", for_s=0.2)
    assert emulator.state()["clients"] == 0
    with pytest.raises(ConnectionAbortedError):
        device.pressures.read_channels()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", emulator.port), timeout=0.1)
    clock.sleep(0.25)
    with Connected(emulator) as again:
        assert again.cpx.module_count() == 6


def ask(emulator, client, request):
    client.sendall(request)
    while not select.select([client], [], [], 0.0)[0]:
        emulator.serve()
    return client.recv(300)


@pytest.mark.parametrize(
    ("variant", "header_holds"),
    [("length", slice(0, 4)), ("transaction", slice(2, 7)), ("function", slice(0, 7)), ("random", slice(0, 0))],
)
def test_garbage_is_an_answer_with_something_wrong(emulator, device, variant, header_holds):
    request = bytes.fromhex("000700000006 01 03 b15d 0004")
    with socket.create_connection(("127.0.0.1", emulator.port), timeout=1.0) as client:
        right = ask(emulator, client, request)
        assert right[:9] == bytes.fromhex("00070000000b 01 03 08")
        emulator.fault("garbage", variant=variant)
        wrong = []
        for _ in range(10):
            wrong.append(ask(emulator, client, request))
    assert all(each[:8] != right[:8] for each in wrong)
    assert all(each[header_holds] == right[header_holds] for each in wrong)
    if variant == "transaction":
        with pytest.raises(ModbusException):
            device.cpx.client.read_holding_registers(45405, count=4)


def test_silent_and_slow(emulator, device):
    emulator.fault("silent", for_s=0.15)
    before = emulator.state()["messages"]
    with pytest.raises(ModbusException):
        device.pressures.read_channels()
    assert emulator.state()["messages"] == before + 1
    clock.sleep(0.1)
    device.cpx.client.connect()
    emulator.fault("slow", delay_s=0.05)
    begun = clock.now_s()
    device.pressures.read_channels()
    assert 0.05 < clock.now_s() - begun < 0.1


def test_sensor_faults(emulator, device):
    device.outputs.write_channels([2500] * 4)
    emulator.fault("sensor", channel="pam1.pressure", mode="frozen")
    emulator.fault("sensor", channel="pam2.force", mode="counts", counts=-32768)
    emulator.fault("sensor", channel="SFE.encoder", mode="counts", counts=123456, after_s=0.05)
    clock.sleep(0.02)
    seen = [(device.pressures[0], device.pressures[1], device.forces[1]) for _ in range(20) if not clock.sleep(0.01)]
    assert len({each[0] for each in seen}) == 1
    assert len({each[1] for each in seen}) > 5
    assert {each[2] for each in seen} == {-32768}
    assert device.encoders[0].read_value() == 123456
    emulator.mend()
    assert device.encoders[0].read_value() != 123456


def test_overpressure_and_overspeed(emulator, device):
    emulator.fault("overpressure", muscle="pam3", kpa=400.0)
    emulator.fault("overspeed", joint="EFE", rad_per_s=5.0)
    first = device.encoders[1].read_value()
    clock.sleep(0.4)
    assert 0.04 * device.pressures[2] == pytest.approx(400.0, abs=5.0)
    assert 0.000628 * (device.encoders[1].read_value() - first) == pytest.approx(2.0, abs=0.3)
    assert emulator.state()["outputs_kpa"] == [0.0] * 4


def test_strange_requests_are_answered_with_an_error(emulator):
    with pytest.raises(RuntimeError, match="no fault 'fire'"):
        emulator.fault("fire")
    with pytest.raises(RuntimeError, match="reference_rad"):
        emulator.trial("tracked", "p1", 100)
