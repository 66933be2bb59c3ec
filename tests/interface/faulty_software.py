"""A guidance program whose configuration selects a fault; it speaks the protocol by itself."""

from __future__ import annotations

import os
import signal
import socket
import struct
import sys
import time

from lunarsim.interface.definitions import VERSION
from lunarsim.interface.protobuf import new_message

_CALLS = 20


def receive(connection: socket.socket) -> bytes | None:
    head = connection.recv(4, socket.MSG_WAITALL)
    if len(head) < 4:
        return None
    return connection.recv(struct.unpack("<I", head)[0], socket.MSG_WAITALL)


def send(connection: socket.socket, data: bytes) -> None:
    connection.sendall(struct.pack("<I", len(data)) + data)


def answer(fault: str, connection: socket.socket) -> None:
    """Answer a call with a fault."""
    reply = new_message("Reply")
    output = reply.guidance_output
    output.acceleration.extend([0.0, 0.0, 1.62])
    if fault == "die":
        sys.exit(3)
    if fault == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault == "hang":
        time.sleep(3600.0)
    if fault == "close":
        connection.close()
        time.sleep(3600.0)
    if fault == "late":
        time.sleep(1.2)
    if fault == "nan":
        output.acceleration[0] = float("nan")
    if fault == "size":
        output.acceleration.append(0.0)
    if fault == "empty":
        reply.Clear()
    if fault == "other-role":
        reply.Clear()
        reply.policy_output.action = 0
    if fault == "error":
        reply.Clear()
        reply.error = "no solution"
    if fault == "garbage":
        send(connection, b"\xff" * 40)
        return
    if fault == "long":
        connection.sendall(struct.pack("<I", 2**31))
        return
    if fault == "twice":
        send(connection, reply.SerializeToString())
    if fault == "half":
        connection.sendall(struct.pack("<I", 100) + b"\0" * 10)
        time.sleep(3600.0)
    send(connection, reply.SerializeToString())


def main() -> None:
    fault = sys.argv[1]
    kind, _, place = os.environ["LUNARSIM_ADDRESS"].partition(":")
    if fault == "no-connection":
        time.sleep(3600.0)
    assert kind == "unix"
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(place)
    hello = new_message("Reply")
    hello.interface_version = VERSION + 1 if fault == "version" else VERSION
    hello.token = "" if fault == "token" else os.environ["LUNARSIM_TOKEN"]
    send(connection, hello.SerializeToString())
    calls = -1
    while (data := receive(connection)) is not None:
        request = new_message("Request")
        request.ParseFromString(data)
        if calls < 0 and fault == "init":
            sys.exit(4)
        calls += 1
        is_good = calls <= _CALLS
        answer("" if is_good else fault, connection)


if __name__ == "__main__":
    main()
