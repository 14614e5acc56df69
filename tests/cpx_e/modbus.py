"""Modbus/TCP on sockets: frames in, the device's words out, with faults put into the bytes.

Functions 3, 6 and 16; everything else is answered with an exception.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
from collections.abc import Collection

from stages.science.rig import clock
from tests.cpx_e.device import Device, Refused
from tests.cpx_e.machine import Faults


class ModbusServer:
    """Serves a device's registers to any number of clients; faults of the connection are put in here."""

    def __init__(self, device: Device, faults: Faults):
        self.device, self.faults = device, faults
        self.listener: socket.socket | None = socket.create_server(("127.0.0.1", 0), reuse_port=False)
        self.port: int = self.listener.getsockname()[1]
        self.clients: set[socket.socket] = set()
        self.chance = random.Random(device.machine.seed)

    def list_sockets(self) -> list[socket.socket]:
        """Return what may be ready to be served; none while the link is cut, and all anew afterwards."""
        if self.faults.now("cut"):
            self.close()
            return []
        if self.listener is None:
            self.listener = socket.create_server(("127.0.0.1", self.port), reuse_port=False)
        return [self.listener, *self.clients]

    def serve(self, ready: Collection[object]) -> None:
        """Accept those who connect and answer those who ask, of these."""
        if self.listener in ready:
            client, _ = self.listener.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.clients.add(client)
        for each in self.clients.intersection(ready):
            if not self._serve_one(each):
                self._drop(each)

    def close(self) -> None:
        if self.listener is not None:
            self.listener.close()
            self.listener = None
        for client in list(self.clients):
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self.clients.discard(client)
        with contextlib.suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)
        client.close()

    def _serve_one(self, client: socket.socket) -> bool:
        """Answer a request; return whether the client may ask more."""
        try:
            transaction, protocol, length, unit = struct.unpack(">HHHB", _receive(client, 7))
            if protocol != 0 or not 2 <= length <= 254:
                return False
            request = _receive(client, length - 1)
            if self.faults.now("cut"):
                return False
            self.device.note_request()
            reply = self._spoil(transaction, unit, self._answer(request))
            if reply is not None:
                client.sendall(reply)
        except OSError:
            return False
        return True

    def _spoil(self, transaction: int, unit: int, answer: bytes) -> bytes | None:
        for each in self.faults.now("slow"):
            clock.sleep(each["delay_s"])
        if self.faults.now("silent"):
            return None
        length = len(answer) + 1
        for each in self.faults.now("garbage"):
            if each["variant"] == "random":
                return self.chance.randbytes(self.chance.randint(1, 300))
            if each["variant"] == "length":
                length += self.chance.choice((-1, 1, 7, 200, 40000))
            elif each["variant"] == "transaction":
                transaction = (transaction + self.chance.randint(1, 60000)) & 0xFFFF
            else:
                answer = bytes([(answer[0] ^ self.chance.randint(1, 127)) & 0x7F]) + answer[1:]
        return struct.pack(">HHHB", transaction, 0, length, unit) + answer

    def _answer(self, request: bytes) -> bytes:
        function = request[0]
        try:
            return bytes([function]) + self._perform(function, request[1:])
        except Refused as refusal:
            return bytes([function | 0x80, refusal.args[0]])
        except (struct.error, IndexError):
            return bytes([function | 0x80, 3])

    def _perform(self, function: int, body: bytes) -> bytes:
        if function == 3:
            address, count = struct.unpack(">HH", body)
            if not 1 <= count <= 125:
                raise Refused(3)
            return struct.pack(f">B{count}H", 2 * count, *self.device.read(address, count))
        if function == 6:
            address, word = struct.unpack(">HH", body)
            self.device.write(address, [word])
            return body
        if function == 16:
            self._write(body)
            return body[:4]
        raise Refused(1)

    def _write(self, body: bytes) -> None:
        address, count, size = struct.unpack(">HHB", body[:5])
        if not 1 <= count <= 123 or size != 2 * count or len(body) != 5 + size:
            raise Refused(3)
        if self.faults.now("refuse"):
            raise Refused(4)
        if self.faults.now("deaf"):
            return
        self.device.write(address, list(struct.unpack(f">{count}H", body[5:])))


def _receive(client: socket.socket, size: int) -> bytes:
    data = client.recv(size, socket.MSG_WAITALL)
    if len(data) < size:
        raise OSError("closed")
    return data
