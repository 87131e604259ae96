"""The network between each client and the server: a relay of one TCP and UDP port that can fail in several ways.

It needs no rights: clients call an address of their own (127.0.1.x), and the relay calls the server's.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

from tests.support.relay import TCP, Relay

Condition: TypeAlias = Literal["whole", "cut", "stalled", "refusing"]
"""The packets that are carried: all; none, silently; UDP only; none, and TCP is reset."""

SERVER = "127.0.0.2"


class ClientNetwork(Relay):
    def __init__(self, number: int, port: int) -> None:
        super().__init__((SERVER, port), f"127.0.1.{number}", port, room=128 * 1024)

    def become(self, condition: Condition) -> None:
        carries_datagrams = condition in ("whole", "stalled")
        self.to_server = self.to_client = lambda datagram: [datagram] if carries_datagrams else []
        if condition in ("cut", "stalled"):
            self.hold(TCP)
        else:
            self.release(TCP)
        self.refuse(condition == "refusing")
