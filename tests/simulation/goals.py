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
        at: s, when it was asked last; None: not yet.
        servers: that took that.
        done: it is answered.
    """

    at: float | None = None
    servers: list[Server] = field(default_factory=list)
    done: bool = False

    @property
    def is_lost(self) -> bool:
        """Whether it has to be asked again, as whoever took it is gone."""
        return not self.done and all(each.closed for each in self.servers)


@dataclass(eq=False)
class Goal:
    """As its client and its server know it.

    Attributes:
        id: of the goal.
        plan: what its server does with it.
        sent: s, when its client sent it.
        client: the number of its client's life.
        server: that accepted it; None: none yet.
        arrived: times that it came to a server.
        state: in which it ended there; empty: it goes on.
        ended: s, when that was.
        told: its client, whether it was accepted; None: not yet.
        result: the state that its client was told; empty: none yet.
        cancelled: a cancel has come to its server.
        fed: the last feedback that its client heard.
        cancel: asked for by its client; None: it is not.
        asks: for the result; None: not yet.
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
        """Nobody waits for anything about it."""
        return self.told is False or bool(self.result)
