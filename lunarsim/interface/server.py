"""Flight software in Python that runs in another process.

A program defines a class for each of its roles and calls `serve`::

    class Law:
        def __init__(self, briefing):
            self.gravity = briefing.get("gravity")

        def step(self, given, answer):
            answer.set(acceleration=[0.0, 0.0, self.gravity])

    serve(guidance=Law)
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from lunarsim.errors import InputError
from lunarsim.interface.definitions import ROLES, VERSION
from lunarsim.interface.protobuf import from_protobuf, new_message, to_protobuf
from lunarsim.interface.structs import Struct
from lunarsim.interface.wire import (
    ADDRESS_VARIABLE,
    TOKEN_VARIABLE,
    Channel,
    SharedArrays,
    WireError,
)


class Software(Protocol):
    """Flight software of one role and one flight, made from its briefing."""

    def step(self, given: Struct, answer: Struct) -> None:
        """Compute the answer to one call.

        A method `close`, if there is one, is called at the end of the flight.

        Parameters
        ----------
        given, answer
            Input and output messages of the role.
        """
        ...


def serve(**roles: Callable[[Struct], Software]) -> None:
    """Connect to lunarsim, which has started this program, and answer its calls.

    The function returns when the flight has ended.

    Parameters
    ----------
    roles
        For each role, a class or function that makes the software from its briefing.

    Raises
    ------
    InputError
        If a role does not exist, or lunarsim has not started this program.

    Examples
    --------
    >>> serve(pilot=None)
    Traceback (most recent call last):
    lunarsim.errors.InputError: serve.pilot: must be a role. Roles: computer, guidance, policy, \
mapper, control.
    """
    for name in roles:
        if name not in ROLES:
            known = f"Roles: {', '.join(ROLES)}."
            raise InputError(f"serve.{name}", name, "must be a role", known, show_value=False)
    address = os.environ.get(ADDRESS_VARIABLE, "")
    kind, _, place = address.partition(":")
    if kind not in ("unix", "tcp"):
        raise InputError(
            ADDRESS_VARIABLE, address, "must be set by lunarsim, which starts this program",
            'Name the program in a scenario: kind = "process", path = "FILE".',
        )  # fmt: skip
    if kind == "unix":
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(place)
    else:
        host, _, port = place.rpartition(":")
        connection = socket.create_connection((host, int(port)))
    channel = Channel(connection)
    try:
        _answer_calls(channel, roles)
    except WireError:
        pass  # lunarsim has closed the connection: the flight has ended
    finally:
        channel.close()


def _answer_calls(channel: Channel, roles: dict[str, Callable[[Struct], Software]]) -> None:
    """Answer calls until lunarsim closes the connection."""
    hello = new_message("Reply")
    hello.interface_version, hello.token = VERSION, os.environ.get(TOKEN_VARIABLE, "")
    channel.send(hello)
    request, reply = new_message("Request"), new_message("Reply")
    channel.receive(request)
    memory = SharedArrays(Path(request.shared_memory), is_owner=False)
    role = request.role
    briefing = Struct("Briefing")
    from_protobuf(request.briefing, briefing, memory)
    software: Any = None
    if role not in roles:
        reply.error = f"the program has no role {role}"
    else:
        try:
            software = roles[role](briefing)
        except Exception as error:  # the software can raise anything
            reply.error = _description(error)
    channel.send(reply)
    try:
        _answer_steps(channel, role, software, memory)
    finally:
        if hasattr(software, "close"):
            software.close()


def _answer_steps(channel: Channel, role: str, software: Any, memory: SharedArrays) -> None:
    """Answer the calls of a role until lunarsim closes the connection."""
    request, reply = new_message("Request"), new_message("Reply")
    given, answer = Struct(ROLES[role].input), Struct(ROLES[role].output)
    while True:
        request.Clear()
        reply.Clear()
        channel.receive(request)
        try:
            from_protobuf(getattr(request, f"{role}_input"), given, memory)
            answer.clear()
            software.step(given, answer)
            to_protobuf(answer, getattr(reply, f"{role}_output"), memory)
        except Exception as error:  # the software can raise anything
            reply.Clear()
            reply.error = _description(error)
        channel.send(reply)


def _description(error: Exception) -> str:
    if isinstance(error, InputError):
        return f"{error.problem}. {error.remedy}".strip()
    if hasattr(error, "detail"):  # a failure of a library
        return str(error.detail)
    return f"{type(error).__name__}: {error}".partition("\n")[0][:500]
