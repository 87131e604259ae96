"""The nodes at both ends of a route, and what they counted: the reference that the bridge is judged by.

A flow has a node at the near end, where messages or calls enter the bridge, and one at the far end. Each message and
each call carries the number of its flow and a number of its own, so each can be checked by itself.
"""

from __future__ import annotations

import contextvars
from collections import Counter
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from tests.simulation.action_server import ActionServer
from tests.simulation.services import Server

if TYPE_CHECKING:
    from collections import OrderedDict
    from collections.abc import Callable
    from random import Random

    from tests.simulation.ros import Domain

    from rsb_bridge.model.session import Topic

CDR = b"\0\1\0\0"
_REMEMBERED = 4096
_OF_NOBODY = contextvars.Context()

S = TypeVar("S", Server, ActionServer)


class Flow:
    """One entry of a session, with its nodes.

    Attributes:
        near: the domain of the publisher, or of the callers.
        far: the domain of the listener, or of the server.
        troubles: reasons why it may be interrupted, with how often each applies.
    """

    def __init__(
        self,
        number: int,
        topic: Topic,
        robot: str,
        ends: tuple[Domain, Domain],
        names: tuple[str, str],
        *,
        random: Random,
        period: float,
        on_wrong: Callable[[str], None],
    ) -> None:
        """Make it, without any node.

        Args:
            period: s from one message, call or goal to the next, on average.
        """
        self.number = number
        self.topic = topic
        self.robot = robot
        self.near, self.far = ends
        self.near_name, self.far_name = names
        self.period = period
        self.changed = 0.0
        self.troubles: Counter[str] = Counter()
        self._random = random
        self._loop = self.near.loop
        self._on_wrong = on_wrong

    def _later(self, seconds: float, doing: Callable[..., object], *args: Any) -> None:
        """Do something after a time, in a context of its own, so that no simulated process is charged for it."""
        self._loop.call_later(seconds, doing, *args, context=_OF_NOBODY)

    def _soon_again(self, doing: Callable[..., object], *args: Any) -> None:
        self._later(self.period * self._random.uniform(0.5, 1.5), doing, *args)


class CallFlow(Flow, Generic[S]):
    near_services: list[str]
    far_services: list[str]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.server: S | None = None
        self.answered = 0
        self._dead: list[S] = []
        self._slow = False

    def _new_server(self) -> S:
        raise NotImplementedError

    def call(self) -> None:
        raise NotImplementedError

    def appear(self) -> None:
        if self.server is None:
            self.changed = self._loop.time()
            self.server = self._new_server()

    def vanish(self, *, killed: bool = False) -> None:
        """End the server, if one runs; a killed one stays visible for a while."""
        server, self.server = self.server, None
        if server is not None:
            self.changed = self._loop.time()
            server.close(killed=killed)
            self._dead += [server] if killed else []

    @property
    def dead_is_seen(self) -> bool:
        self._dead = [each for each in self._dead if each.seen]
        return bool(self._dead)

    def hesitate(self, slow: bool) -> None:
        """Make the server slow, or quick again; a slow one leaves some calls unanswered."""
        self._slow = slow
        self.changed = self._loop.time()


def bound(table: OrderedDict[Any, Any]) -> None:
    while len(table) > _REMEMBERED:
        table.popitem(last=False)
