"""Serve an emulated CPX-E: ``python -m tests.cpx_e MACHINE``, described in JSON, until stdin closes."""

from __future__ import annotations

import json
import socket
import sys
from multiprocessing.connection import Connection, wait

from stages.science.rig import clock
from tests.cpx_e.emulator import Emulation


def _warm(emulation: Emulation) -> None:
    """Compile all that a trial takes."""
    plant = emulation.plant
    plant.announce({"do": "trial", "kind": "passive", "samples": 3, "lead_samples": 0, "seed": 0}, clock.now_s())
    for _ in range(4):
        clock.sleep(plant.tick())


def _answer(client: Connection, emulation: Emulation) -> bool:
    """Answer a control request; return whether the client may ask more."""
    heard_s = clock.now_s()
    try:
        client.send(emulation.do(client.recv(), heard_s))
    except (EOFError, OSError):
        client.close()
        return False
    return True


def main(machine: str) -> None:
    _warm(Emulation(json.loads(machine)))
    emulation = Emulation(json.loads(machine))
    listener = socket.create_server(("127.0.0.1", 0))
    clients: list[Connection] = []
    print(json.dumps({"port": emulation.server.port, "control": listener.getsockname()[1]}), flush=True)
    while True:
        rest_s = min(emulation.plant.tick(), emulation.device.tend())
        ready = wait([sys.stdin, listener, *clients, *emulation.server.list_sockets()], rest_s)
        if sys.stdin in ready:
            return
        emulation.server.serve(ready)
        clients = [each for each in clients if each not in ready or _answer(each, emulation)]
        if listener in ready:
            clients.append(Connection(listener.accept()[0].detach()))


if __name__ == "__main__":
    main(sys.argv[1])
