"""Services of a world: callers at the near end, and a server at the far end.

Each request carries its flow, its caller and its number; the answer repeats them.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.simulation.flow import CDR, CallFlow, bound
from tests.simulation.ros import hash_of
from tests.simulation.services import Client, Server

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import Request, Response

_HEAD = struct.Struct("<4sIII")
_ANSWERED = b"answered"
_NEVER = 0.1
"""The share of calls that a slow server leaves unanswered."""


class Label(NamedTuple):
    """The numbers that a request carries.

    Attributes:
        caller: the number of the client that asked, among all that the service has had.
    """

    service: int
    caller: int
    number: int


class ServiceFlow(CallFlow[Server]):
    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.near_services, self.far_services = [self.near_name], [self.far_name]
        self.asked = 0
        self.last_answered = 0.0
        self._type_name = f"service{self.number}_msgs/srv/Ask"
        self._callers = 0
        self._client: Client | None = None
        self._waiting: OrderedDict[Label, tuple[float, list[Server]]] = OrderedDict()  # when, and which servers took it
        self._done: OrderedDict[Label, None] = OrderedDict()
        self._served: OrderedDict[Label, None] = OrderedDict()

    def __str__(self) -> str:
        return f"{self.robot}'s calls of {self.near_name}"

    # --- the nodes at its ends

    def _new_server(self) -> Server:
        type_hash, node = hash_of(self._type_name), f"/server{self.number}"
        return Server(self.far.services, node, self.far_name, self._type_name, type_hash, self._serve)

    def call(self) -> None:
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
        self._later(self._random.uniform(0.0, self.period), self._beat, caller)

    def _beat(self, caller: int) -> None:
        if caller != self._callers:
            return
        for _ in range(self._random.choice((1, 1, 1, 5))):
            self._ask(caller)
        self._soon_again(self._beat, caller)

    def _ask(self, caller: int) -> None:
        client = self._client
        assert client is not None
        if not client.ready:
            return  # like a client that waits for the service
        label = Label(self.number, caller, client.called + 1)
        self.asked += 1
        self._waiting[label] = self._loop.time(), [each for each in client.matched if not each.closed]
        bound(self._waiting)
        client.call(_HEAD.pack(CDR, *label) + bytes(self._random.randrange(2000)))

    @property
    def overdue(self) -> float:
        """Seconds that the oldest call since the last change has waited, or 0 if no such call waits."""
        taken = [at for at, servers in self._waiting.values() if not all(each.closed for each in servers)]
        since = min((at for at in taken if at > self.changed), default=None)
        return 0.0 if since is None else self._loop.time() - since

    def forgive(self) -> None:
        """Expect no answers to the waiting calls: the bridge has given them up, with a reason."""
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
            self._later(delay, server.answer, request.caller, answer)

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
        if len(payload) < _HEAD.size or payload[:4] != CDR:
            return None
        label = Label(*_HEAD.unpack_from(payload)[1:])
        return label if label.service == self.number else None


def _remember(labels: OrderedDict[Label, None], label: Label) -> None:
    labels[label] = None
    bound(labels)
