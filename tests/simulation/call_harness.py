"""One service between two domains of a world without faults, with its servers and clients."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
from tests.simulation.beds import Bed, until
from tests.simulation.conditions import STILL
from tests.simulation.ros import hash_of
from tests.simulation.services import Client, Server
from tests.simulation.world import World

from rsb_bridge.model.session import Topic
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.provider import Provider

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.simulation.engine_host import EngineHost
    from tests.simulation.ros import Domain

    from rsb_bridge.model.calls import CallsSnapshot
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.ros.ros_interface import Request, Response
    from rsb_bridge.route.half import Half

TYPE = "std_srvs/srv/SetBool"
SETTLED = 3.0
"""s within which a change reaches everybody: discovery, a poll of the graph, a report to the other side."""


class ScriptedServer:
    """A server that repeats each request in its answer, at once or on `answer`."""

    def __init__(self, domain: Domain, service: str, node: str, type_name: str, type_hash: str, *, waits: bool) -> None:
        self.asked: list[bytes] = []
        self.node = node
        self._waiting: list[Request] = []
        self._waits = waits
        self.endpoint = Server(domain.services, node, service, type_name, type_hash, self._take)

    def _take(self, batch: Sequence[Request]) -> None:
        for request in batch:
            self.asked.append(request.payload)
            self._waiting.append(request)
        if not self._waits:
            self.answer()

    def answer(self, order: Callable[[list[Request]], object] = lambda _: None) -> None:
        waiting, self._waiting = self._waiting, []
        order(waiting)
        for request in waiting:
            self.endpoint.answer(request.caller, answer_to(request.payload, self.node))

    def answer_one(self) -> None:
        """Answer the request that came first."""
        request = self._waiting.pop(0)
        self.endpoint.answer(request.caller, answer_to(request.payload, self.node))

    def die(self) -> None:
        """Kill its process: it stays visible for a while, and answers nothing."""
        self.endpoint.close(killed=True)


class ScriptedClient:
    def __init__(self, domain: Domain, service: str, node: str, type_name: str, type_hash: str) -> None:
        self.node = node
        self.requests: dict[int, bytes] = {}
        self.answers: dict[int, bytes] = {}
        self.endpoint = Client(domain.services, node, service, type_name, type_hash, self._take)

    def ask(self, content: bytes = b"") -> int:
        request = b"\0\1\0\0" + f"{self.node} {len(self.requests)} ".encode() + content
        number = self.endpoint.call(request)
        self.requests[number] = request
        return number

    def _take(self, batch: Sequence[Response]) -> None:
        for response in batch:
            assert response.number not in self.answers, "answered twice"
            self.answers[response.number] = response.payload

    @property
    def right(self) -> int:
        """The number of answers, after checking that each belongs to its request."""
        for number, answer in self.answers.items():
            assert answer.startswith(answer_to(self.requests[number], ""))
        return len(self.answers)


def answer_to(request: bytes, node: str) -> bytes:
    return b"\0\1\0\0you asked " + request + b", says " + node.encode()


class CallHarness(Bed):
    """The service of a robot's session."""

    def __init__(
        self, seed: int = 1, provider: str = "server", kind: str = "service", outlive: float = 0.0, **spec: Any
    ) -> None:
        self.world = World(seed, replace(STILL, topics=(0,), outlive=outlive))
        (self.robot,) = self.world.robots
        self.spec = Topic("/set", "transmit" if provider == "server" else "receive", kind=kind, **spec)  # type: ignore[arg-type]
        host = self.robot.host
        host.session = msgspec.structs.replace(host.session, topics=(self.spec,))
        on_server = f"/{self.robot.name}/set"
        client, server = (host, "/set"), (self.world.server, on_server)
        (self.near, self.near_name), (self.far, self.far_name) = (
            (client, server) if provider == "server" else (server, client)
        )

    def server(
        self,
        node: str = "/server",
        *,
        far: bool = True,
        waits: bool = False,
        suffix: str = "",
        type_name: str = TYPE,
        type_hash: str | None = None,
    ) -> ScriptedServer:
        host, name = (self.far, self.far_name) if far else (self.near, self.near_name)
        return ScriptedServer(
            host.domain,
            name + suffix,
            node,
            type_name,
            hash_of(type_name) if type_hash is None else type_hash,
            waits=waits,
        )

    def client(
        self, node: str = "/client", *, suffix: str = "", type_name: str = TYPE, type_hash: str | None = None
    ) -> ScriptedClient:
        return ScriptedClient(
            self.near.domain,
            self.near_name + suffix,
            node,
            type_name,
            hash_of(type_name) if type_hash is None else type_hash,
        )

    def halves(self) -> tuple[Caller, Provider]:
        """The callers' half of the route, and the providing one."""
        near, far = _half(self.near), _half(self.far)
        assert isinstance(near, Caller)
        assert isinstance(far, Provider)
        return near, far

    def shown(self) -> tuple[RouteSnapshot, RouteSnapshot]:
        near, far = self.halves()
        return near.route.snapshot(), far.route.snapshot()

    def counted(self) -> tuple[CallsSnapshot, CallsSnapshot]:
        """Return both sides' counts, the callers' first, after checking that each adds up."""
        near, far = (shown.calls for shown in self.shown())
        assert near is not None
        assert far is not None
        for calls in (near, far):
            parts = calls.answered + calls.expired + sum(calls.refused.values()) + calls.lost + calls.in_flight
            assert calls.asked == parts
            assert calls.in_flight >= 0
        return near, far

    @property
    def offered(self) -> bool:
        return any(each.node.startswith("/_rsb_") for each in self.near.domain.services.servers[self.near_name])

    async def ready(self, client: ScriptedClient) -> None:
        await until(lambda: client.endpoint.ready, 30.0)


def _half(host: EngineHost) -> Half:
    assert host.run is not None
    (route,) = [each for link in host.run.links() for each in link.routes.values() if each.proposal.kind != "topic"]
    return route.half
