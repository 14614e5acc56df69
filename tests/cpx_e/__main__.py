"""Serve an emulated CPX-E: ``python -m tests.cpx_e MACHINE.json``, until stdin closes."""

from __future__ import annotations

import ctypes
import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from tests.cpx_e.control import Control
from tests.cpx_e.device import Device
from tests.cpx_e.faults import Faults
from tests.cpx_e.machine import Machine
from tests.cpx_e.modbus import ModbusServer
from tests.cpx_e.physics import Physics, run
from tests.cpx_e.shared import Shared

DIE_WITH_PARENT = 1
ENDING = threading.Event()


def _run(machine: Machine, shared: Shared, announced: Connection) -> None:
    ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run(machine, shared, announced)


def _warm(machine: Machine, shared: Shared) -> list[int]:
    """Compile all that a trial takes before the fork, and return what sensors show of an idle machine."""
    vented = np.zeros(len(machine.exoskeleton.muscles))
    physics = Physics(machine)
    physics.announce({"do": "trial", "kind": "passive", "samples": 3, "lead_samples": 0}, vented)
    for _ in range(3):
        physics.step(vented)
        physics.show(shared.run_rad_per_s)
    return Physics(machine).show(shared.run_rad_per_s)


def _tend(device: Device) -> None:
    while True:
        time.sleep(device.tend())


def _end_with(plant: BaseProcess) -> None:
    multiprocessing.connection.wait([plant.sentinel])
    if not ENDING.is_set():
        os._exit(1)


def _stop(plant: BaseProcess) -> int:
    ENDING.set()
    plant.kill()
    plant.join()
    return 0


def main(path: str) -> None:
    """Serve the machine that a file describes."""
    machine = Machine.model_validate(json.loads(Path(path).read_text()))
    shared = Shared(len(machine.exoskeleton.muscles), len(machine.exoskeleton.joints))
    shared.publish(_warm(machine, shared))
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    plant = context.Process(target=_run, args=(machine, shared, theirs), daemon=True)
    plant.start()
    faults = Faults(machine)
    device = Device(machine, shared, faults)
    server = ModbusServer(device, faults, machine.port)

    def announce(trial: dict[str, Any]) -> None:
        ours.send(trial)
        ours.recv()

    control = Control(device, server, faults, shared, announce)
    threading.Thread(target=_tend, args=(device,), daemon=True).start()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.setswitchinterval(0.0005)
    print(json.dumps({"port": server.port, "control": control.port}), flush=True)
    threading.Thread(target=_end_with, args=(plant,), daemon=True).start()
    while os.read(0, 4096):
        pass
    os._exit(_stop(plant))


if __name__ == "__main__":
    main(sys.argv[1])
