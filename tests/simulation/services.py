"""Services of a ROS domain without ROS: servers and clients, as far as a bridge can tell them from DDS's.

- They find each other a moment after they are made, and until then calls do not reach.
- A call reaches every server of the service; a response reaches the client that asked, and no other.
- Requests and responses are taken in batches, a moment after they came, on the loop instead of a thread.
- What a process had that was killed is seen for up to 40 s more, and answers nothing.
"""

from __future__ import annotations

import contextvars
import math
from collections import defaultdict, deque
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Request, Response, RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.simulation.ros import Domain

    from rsb_bridge.ros.ros_interface import OnFailure

SEEN = Qos(depth=0)
"""What others see of a server's or a client's policies."""
_DISCOVERY = (0.001, 0.05)
_WAITS = 0.1
"""s that a server waits until it knows the client that it answers: rmw_fastrtps does."""
_BATCH = 64
_APART = 0.002
"""s between the turns of what is not express, so that a turn brings something of several topics."""
_OF_NOBODY = contextvars.Context()
_GID = 16

T = TypeVar("T")


class Services:
    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        self.servers: defaultdict[str, list[Server]] = defaultdict(list)
        self.clients: defaultdict[str, list[Client]] = defaultdict(list)
        self._by_gid: dict[bytes, Client] = {}

    def names(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        ends: list[Server | Client] = [end for servers in self.servers.values() for end in servers]
        ends += [end for clients in self.clients.values() for end in clients]
        for end in ends:
            found.setdefault(end.name, set()).add(end.type_name)
        return found

    def add(self, end: Server | Client) -> None:
        if isinstance(end, Server):
            self.servers[end.name].append(end)
            pairs = [(client, end) for client in self.clients[end.name]]
        else:
            self.clients[end.name].append(end)
            self._by_gid[end.gid] = end
            pairs = [(end, server) for server in self.servers[end.name]]
        self.domain.changed()
        for client, server in pairs:
            if client.type_name == server.type_name:
                delay = self.domain.random.uniform(*_DISCOVERY)
                self.domain.loop.call_later(delay, self._match, client, server, context=_OF_NOBODY)

    def _match(self, client: Client, server: Server) -> None:
        if not client.closed and not server.closed:
            client.matched[server] = None

    def remove(self, end: Server | Client) -> None:
        if isinstance(end, Client):
            if self._by_gid.pop(end.gid, None) is None:
                return
            self.clients[end.name].remove(end)
        else:
            if end not in self.servers[end.name]:
                return
            self.servers[end.name].remove(end)
            for client in self.clients[end.name]:
                client.matched.pop(end, None)
        self.domain.changed()

    def respond(self, server: Server, caller: bytes, payload: bytes, *, again: bool = True) -> None:
        """A response goes to the client that asked, if it is there and knows the server, or will in a moment."""
        client = self._by_gid.get(caller[:_GID])
        if client is None or client.closed:
            return
        if server in client.matched:
            number = int.from_bytes(caller[_GID:], "big")
            client.put(Response(payload, number, self.domain.wall_ns()))
        elif again and not server.closed:
            later = partial(self.respond, server, caller, payload, again=False)
            self.domain.loop.call_later(_WAITS, later, context=_OF_NOBODY)


class Taker(Generic[T]):
    """A subscription, or a node's end of a service, from which it takes in batches.

    Attributes:
        stalled: whether the taking thread is stopped; what arrives is kept as usual.
        in_turns: whether it takes when others do.
    """

    def __init__(
        self,
        domain: Domain,
        node: str,
        name: str,
        type_name: str,
        type_hash: str,
        sink: Callable[[Sequence[T]], None],
        on_failure: OnFailure | None = None,
    ) -> None:
        self.gid = domain.new_gid()
        self.node = node
        self.name = name
        self.type_name = type_name
        self.type_hash = type_hash
        self.seen_qos = SEEN
        self.closed = False
        self.stalled = self.in_turns = False
        self._domain = domain
        self._sink = sink
        self._on_failure = on_failure
        self._pending: deque[T] = deque()
        self._draining = False
        self._context = contextvars.copy_context()

    def put(self, each: T) -> None:
        self._pending.append(each)
        self._drain_soon()

    def _drain_soon(self) -> None:
        if not self._draining:
            self._draining = True
            domain = self._domain
            due = domain.loop.time() + domain.random.uniform(*domain.taking)
            if self.in_turns:
                due = (math.ceil(due / _APART) + 0.5) * _APART  # no round time, at which checks look at all
            domain.loop.call_at(due, self._drain, context=self._context)

    def _drain(self) -> None:
        self._draining = False
        if self.closed or self.stalled:
            return
        batch = [self._pending.popleft() for _ in range(min(_BATCH, len(self._pending)))]
        if self._pending:
            self._drain_soon()
        self._take(batch)

    def _take(self, batch: list[T]) -> None:
        self._sink(batch)

    def fail(self) -> None:
        """Let the next take fail: it is over."""
        if not self.closed:
            self.close()
            if self._on_failure is not None:
                self._context.run(self._on_failure, RosError(f"{self.name}: taking failed"))

    def close(self, *, killed: bool = False) -> None:
        """Free it; where its process is killed, others see it for a while."""
        if self.closed:
            return
        self.closed = True
        if killed:
            self._domain.forget_later(self)  # type: ignore[arg-type]
        else:
            self._domain.forget(self)  # type: ignore[arg-type]


class _End(Taker[T]):
    """The common part of servers and clients."""

    def __init__(self, services: Services, *what: Any) -> None:
        super().__init__(services.domain, *what)
        self._services = services
        self.matched: dict[Server, None] = {}  # of a client: the servers that its calls reach
        services.add(self)  # type: ignore[arg-type]


class Server(_End[Request]):
    """A server of any node's: `rsb_bridge.ros.ros_interface.ServiceServer`."""

    @property
    def seen(self) -> bool:
        return self in self._services.servers[self.name]

    def answer(self, caller: bytes, payload: bytes) -> None:
        if not self.closed:
            self._services.respond(self, caller, payload)


class Client(_End[Response]):
    """A client of any node's: `rsb_bridge.ros.ros_interface.ServiceClient`."""

    called = 0

    @property
    def ready(self) -> bool:
        return bool(self.matched)

    def call(self, payload: bytes) -> int:
        self.called += 1
        request = Request(payload, self.gid + self.called.to_bytes(8, "big"), self._domain.wall_ns())
        for server in self.matched:
            if not server.closed:
                server.put(request)
        return self.called
