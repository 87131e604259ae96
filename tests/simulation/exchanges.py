"""Services with a server at one end and callers at the other, and what they know of their calls: the outside truth.

Each request says which exchange it belongs to, which caller asked, and its number; each answer repeats that. So
whatever comes to a caller can be checked by itself, whatever the bridge says of it.
"""

from __future__ import annotations

import contextvars
import struct
from collections import Counter, OrderedDict
from typing import TYPE_CHECKING, NamedTuple

from tests.simulation.ros import hash_of
from tests.simulation.services import Client, Server

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from random import Random

    from tests.simulation.ros import Domain

    from rsb_bridge.model.session import Topic
    from rsb_bridge.ros.ros_interface import Request, Response

_HEAD = struct.Struct("<4sIII")
_CDR = b"\0\1\0\0"
_ANSWERED = b"answered"
_REMEMBERED = 4096
_NEVER = 0.1
"""Of the calls that a server is slow with, those that it never answers."""
_OF_NOBODY = contextvars.Context()


class Label(NamedTuple):
    """What a request carries.

    Attributes:
        exchange: its number.
        caller: the number of the client that asked, among all that the exchange has had.
        number: of the call, as the client counts.
    """

    exchange: int
    caller: int
    number: int


class Exchange:
    """One service that is to be bridged.

    Attributes:
        number: of the exchange.
        topic: the service as the client's session has it.
        robot: the client's name.
        near: where the callers are.
        far: where the server is.
        near_name: the service's name there.
        far_name: likewise.
        near_services: the names of all services that it consists of there.
        far_services: likewise.
        changed: s, when something was last done to its ends.
        troubles: what goes on that may keep it from being answered.
        server: None: there is none.
        dead: servers that were killed, as long as they may be seen.
        asked: calls made.
        answered: calls that had their answer.
        last_asked: s, when the last call was made that nothing kept from being answered at once.
        last_answered: s, when the last answer came.
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
        self.number = number
        self.topic = topic
        self.robot = robot
        self.near, self.far = ends
        self.near_name, self.far_name = names
        self.near_services, self.far_services = [self.near_name], [self.far_name]
        self.changed = 0.0
        self.troubles: Counter[str] = Counter()
        self.server: Server | None = None
        self.dead: list[Server] = []
        self.asked = 0
        self.answered = 0
        self.last_answered = 0.0
        self._type_name = f"exchange{number}_msgs/srv/Ask"
        self._random = random
        self._period = period
        self._loop = self.near.loop
        self._on_wrong = on_wrong
        self._slow = False
        self._callers = 0
        self._client: Client | None = None
        self._waiting: OrderedDict[Label, tuple[float, list[Server]]] = OrderedDict()  # when, and which servers took it
        self._done: OrderedDict[Label, None] = OrderedDict()
        self._served: OrderedDict[Label, None] = OrderedDict()

    def __str__(self) -> str:
        return f"{self.robot}'s calls of {self.near_name}"

    # --- the nodes at its ends

    def appear(self) -> None:
        """A server is there."""
        if self.server is None:
            self.changed = self._loop.time()
            type_hash = hash_of(self._type_name)
            node = f"/server{self.number}"
            self.server = Server(self.far.services, node, self.far_name, self._type_name, type_hash, self._serve)

    def vanish(self, *, killed: bool = False) -> None:
        """The server is gone; if it is killed, others see it for a while."""
        server, self.server = self.server, None
        if server is None:
            return
        self.changed = self._loop.time()
        if killed:
            server.closed = True
            self.far.forget_later(server)
            self.dead = [each for each in self.dead if each in self.far.services.servers[self.far_name]] + [server]
        else:
            server.close()

    def hesitate(self, slow: bool) -> None:
        """Whether the server takes its time, and sometimes never answers."""
        self._slow = slow
        self.changed = self._loop.time()

    def call(self) -> None:
        """A new client is there, in the place of the one before, and calls."""
        if self._client is not None:
            self._client.close()
        self._callers += 1
        self._waiting.clear()
        caller, type_hash = self._callers, hash_of(self._type_name)

        def take(batch: Sequence[Response]) -> None:
            self._take(caller, batch)

        self._client = Client(
            self.near.services, f"/caller{self.number}", self.near_name, self._type_name, type_hash, take
        )
        self._loop.call_later(self._random.uniform(0.0, self._period), self._beat, caller, context=_OF_NOBODY)

    def _beat(self, caller: int) -> None:
        if caller != self._callers:
            return
        for _ in range(self._random.choice((1, 1, 1, 5))):
            self._ask(caller)
        self._loop.call_later(self._period * self._random.uniform(0.5, 1.5), self._beat, caller, context=_OF_NOBODY)

    def _ask(self, caller: int) -> None:
        client = self._client
        assert client is not None
        if not client.ready:
            return  # as those do who wait for the service
        label = Label(self.number, caller, client.called + 1)
        self.asked += 1
        self._waiting[label] = self._loop.time(), [each for each in client.matched if not each.closed]
        while len(self._waiting) > _REMEMBERED:
            self._waiting.popitem(last=False)
        client.call(_HEAD.pack(_CDR, *label) + bytes(self._random.randrange(2000)))

    @property
    def overdue(self) -> float:
        """S since when the oldest call waits that was made after the last change; 0: there is none."""
        taken = [at for at, servers in self._waiting.values() if not all(each.closed for each in servers)]
        since = min((at for at in taken if at > self.changed), default=None)
        return 0.0 if since is None else self._loop.time() - since

    def forgive(self) -> None:
        """Whatever waits has been given up by the bridge, with a reason."""
        self._waiting.clear()

    # --- what they see

    def _serve(self, batch: Sequence[Request]) -> None:
        server = self.server
        assert server is not None
        for request in batch:
            label = self._label(request.payload)
            if label is None:
                self._on_wrong(f"{self}: the server was asked something else: {request.payload[:24]!r}")
                return
            if label in self._served:
                self._on_wrong(f"{self}: the server was asked twice: {label}")
            _remember(self._served, label)
            if self._slow and self._random.random() < _NEVER:
                continue
            delay = self._random.uniform(0.0, 20.0) if self._slow else self._random.uniform(0.0, 0.1)
            answer = request.payload[: _HEAD.size] + _ANSWERED + bytes(self._random.randrange(2000))
            self._loop.call_later(delay, server.answer, request.caller, answer, context=_OF_NOBODY)

    def _take(self, caller: int, batch: Sequence[Response]) -> None:
        for response in batch:
            label, rest = self._label(response.payload), response.payload[_HEAD.size :]
            if label is None or not rest.startswith(_ANSWERED):
                self._on_wrong(f"{self}: an answer of something else came: {response.payload[:24]!r}")
            elif (label.caller, label.number) != (caller, response.number):
                self._on_wrong(f"{self}: caller {caller} got for call {response.number} the answer to {label}")
            elif label in self._done:
                self._on_wrong(f"{self}: {label} was answered twice")
            else:
                _remember(self._done, label)
                self._waiting.pop(label, None)
                self.answered += 1
                self.last_answered = self._loop.time()

    def _label(self, payload: bytes) -> Label | None:
        if len(payload) < _HEAD.size or payload[:4] != _CDR:
            return None
        label = Label(*_HEAD.unpack_from(payload)[1:])
        return label if label.exchange == self.number else None


def _remember(labels: OrderedDict[Label, None], label: Label) -> None:
    labels[label] = None
    while len(labels) > _REMEMBERED:
        labels.popitem(last=False)
