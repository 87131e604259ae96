"""Helpers of `test_attaching` and others."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from tests.support.inside import attached_to

from rsb_bridge.control import control_sockets, protocol

if TYPE_CHECKING:
    from tests.support.control import Machine


def consoles(machine: Machine) -> int:
    return len(attached_to(machine.served[-1]))


class Stalled:
    """A console that asks for everything and reads nothing."""

    def __init__(self, machine: Machine) -> None:
        self.connection = control_sockets.connect(machine.folder / "robot1.sock", 60.0)
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for message in (
            protocol.ConsoleHello(protocol.VERSION, "0.1.0"),
            protocol.PollState(),
            protocol.FollowEvents(0),
        ):
            self.connection.sendall(protocol.encode(message))
