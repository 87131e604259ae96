"""A goal of an action, as its client and its server know it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.simulation.action_server import ActionServer, Plan
    from tests.simulation.services import Server


@dataclass(eq=False)
class Asked:
    """A cancel or a result that a goal's client asks for.

    Attributes:
        at: s, time of the last request, or None before the first.
    """

    at: float | None = None
    servers: list[Server] = field(default_factory=list)
    done: bool = False

    @property
    def is_lost(self) -> bool:
        """Whether it has to be repeated, because the servers that got it are gone."""
        return not self.done and all(each.closed for each in self.servers)


@dataclass(eq=False)
class Goal:
    """A goal's state at its client and its server.

    Attributes:
        client: the number of its client's life.
        arrived: times that it came to a server.
        state: in which it ended there, or empty while it runs.
        ended: s, when that was.
        told: whether its client got "accepted" or "rejected", or None before the answer.
        result: the state that reached its client, or empty before that.
    """

    id: bytes
    plan: Plan
    sent: float
    client: int
    server: ActionServer | None = None
    arrived: int = 0
    state: str = ""
    ended: float = 0.0
    told: bool | None = None
    result: str = ""
    cancelled: bool = False
    fed: int = 0
    cancel: Asked | None = None
    asks: Asked | None = None

    def __str__(self) -> str:
        return f"goal {int.from_bytes(self.id[12:], 'little')} of client {self.client}"

    @property
    def is_over(self) -> bool:
        return self.told is False or bool(self.result)
