"""Typed clients and servers in a process of their own, which know whose answer an answer is.

`python -m tests.support.calls DOMAIN` takes a JSON object a line and answers each with one, as `CallNode` says.
The service is nav_msgs/srv/LoadMap: a request is a text that names its caller, its number and the size of the response;
the response names the server and repeats the request's name, and its bytes follow from that.
"""

from __future__ import annotations

import array
import contextlib
import heapq
import itertools
import json
import os
import queue
import random
import select
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

from tests.support.asked import Asked
from tests.support.forker import Forked
from tests.support.waiting import eventually

from rsb_bridge.model.text import keep_output_clean

TYPE = "nav_msgs/srv/LoadMap"
DEEP = 5000
"""Of 1,000 requests at once rclpy's own depth of 10 loses most in DDS, bridge or not."""


class Outcome(NamedTuple):
    """The outcomes of calls.

    Attributes:
        wanted: calls that were to be made.
        asked: of these, those made so far.
        wrong: answers that were not, in words; some of them.
        rate: answers a second, from the first call to the last answer.
        p50: s until an answer.
        p99: s.
        servers: process ids of those who answered.
    """

    wanted: int
    asked: int
    answered: int
    wrong: list[str]
    rate: float
    p50: float
    p99: float
    servers: list[int]

    @property
    def right(self) -> bool:
        """Every call has its own answer."""
        return self.answered == self.wanted and not self.wrong


class Served(NamedTuple):
    """The requests that a server has received.

    Attributes:
        again: how many of these it had received before.
        broken: how many of these were damaged.
    """

    requests: int
    again: int
    broken: int
    waiting: int


class CallNode(Asked):
    """The process, told what to do."""

    def __init__(self, domain_id: int, start: Callable[..., subprocess.Popen[str]] | None = None) -> None:
        """Begin it, on another machine where `start` starts programs there (`tests.network.hosts.Host.start`)."""
        command = ("tests.support.calls", str(domain_id))
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        super().__init__(start(sys.executable, "-m", *command, **pipes) if start else Forked(*command, **pipes))

    @property
    def pid(self) -> int:
        pid: int = self._process.pid
        return pid

    def serve(
        self,
        *services: str,
        node: str = "server",
        delay: tuple[float, float] | None = (0.0, 0.0),
        gather: int = 1,
        depth: int = DEEP,
        busy: float = 0.0,
    ) -> None:
        """Answer calls.

        Args:
            delay: s before an answer, at least and at most, or None to give no answer.
            gather: answer none before there are so many calls, and then in random order.
            busy: s that each call keeps the node busy; it takes the next one only then.
        """
        for service in services:
            self.ask(do="serve", service=service, node=node, delay=delay, gather=gather, depth=depth, busy=busy)

    def unserve(self, *services: str) -> None:
        """Serve these no more."""
        for service in services:
            self.ask(do="unserve", service=service)

    def served(self, service: str) -> Served:
        """Return the requests that a server has received so far."""
        return Served(*self.ask(do="served", service=service))

    def ready(self, *services: str) -> bool:
        """Whether all have a server, as a client sees it."""
        ready: bool = self.ask(do="ready", service=services)
        return ready

    def waits_for(self, *services: str, within: float = 180.0) -> float:
        """Wait for all services, like rclpy's wait_for_service. Return the seconds that it took."""
        began = time.monotonic()
        eventually(lambda: self.ready(*services), within, f"servers of {services}")
        return time.monotonic() - began

    def waits_for_none(self, service: str, within: float = 180.0) -> float:
        """Until it has no server; s that it took."""
        began = time.monotonic()
        eventually(lambda: not self.ready(service), within, f"no server of {service}")
        return time.monotonic() - began

    def client(self, service: str, *, depth: int, busy: float) -> None:
        """Make a client that keeps so many answers, and is busy for so long (s) with each."""
        self.ask(do="client", service=service, depth=depth, busy=busy)

    def begin(
        self, service: str, count: int = 1, *, at_once: int = 1, size: int = 0, response: int = 0, rate: float = 0.0
    ) -> None:
        """Make calls, and go on with something else.

        Args:
            at_once: how many may be without an answer at a time.
            size: bytes of a request beyond its name.
            response: bytes of a response beyond its name.
            rate: Hz, or 0 for as many as `at_once` allows.
        """
        how = {"at_once": at_once, "size": size, "response": response, "rate": rate}
        self.ask(do="call", service=service, count=count, **how)

    def outcome(self, service: str) -> Outcome:
        """Return the outcomes of the last calls so far."""
        return Outcome(*self.ask(do="outcome", service=service))

    def give_up(self, service: str) -> Outcome:
        """Forget its client, with all calls that have no answer yet. Return their outcomes."""
        return Outcome(*self.ask(do="give up", service=service))

    def settled(self, service: str, quiet: float = 60.0) -> Outcome:
        """Wait until all calls are answered, or none has been for so long (s)."""
        last, since = self.outcome(service), time.monotonic()
        while last.answered + len(last.wrong) < last.wanted and time.monotonic() - since < quiet:
            new = eventually(lambda: self.outcome(service))
            if new.answered != last.answered or new.asked != last.asked:
                since = time.monotonic()
            last = new
            select.select([], [], [], 0.01)
        return last

    def call(self, service: str, count: int = 1, *, quiet: float = 60.0, **how: Any) -> Outcome:
        """Make calls, and wait for them (`begin`, `settled`)."""
        self.begin(service, count, **how)
        return self.settled(service, quiet)

    def clear(self) -> None:
        """Forget all servers and clients."""
        self.ask(do="clear", service="")

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()

    def close(self) -> None:
        if self._process.returncode is None:
            self._process.communicate(timeout=180)


# --- the node's own process


def _text(name: str, size: int) -> str:
    """A request's: its name, and filler that follows from it."""
    return name.ljust(size, chr(ord("a") + zlib.crc32(name.encode()) % 26)) if size else name


def _bytes(name: str, size: int) -> array.array[int]:
    """Return the bytes of the response to a request."""
    return array.array("b", (zlib.crc32(name.encode()).to_bytes(4, "little") * (size // 4 + 1))[:size])


class _Server:
    """A service, taken from by `_Loop`."""

    def __init__(
        self, node: Any, service: str, delay: tuple[float, float] | None, gather: int, depth: int, busy: float
    ) -> None:
        from nav_msgs.srv import LoadMap
        from rclpy.qos import QoSProfile

        qos = QoSProfile(depth=depth)
        self._service = node.create_service(LoadMap, service, lambda _, response: response, qos_profile=qos)
        self._node = node
        self.handle = self._service.handle
        self._kind = LoadMap
        self._delay, self._gather, self._busy = delay, gather, busy
        self._taken: set[str] = set()
        self._requests = self._again = self._broken = 0
        self._gathered: list[tuple[Any, Any]] = []
        self._due: list[tuple[float, int, Any, Any]] = []
        self._order = itertools.count()

    def served(self) -> Served:
        return Served(self._requests, self._again, self._broken, len(self._gathered) + len(self._due))

    def work(self) -> float:
        """Take requests and give answers that are due. Return when the next one is due."""
        with self.handle:
            while True:
                request, header = self.handle.service_take_request(self._kind.Request)
                if request is None:
                    break
                self._take(request.map_url, header)
                if self._busy:
                    time.sleep(self._busy)
                    break
            now = time.monotonic()
            while self._due and self._due[0][0] <= now:
                _, _, response, header = heapq.heappop(self._due)
                self._service.send_response(response, header)
        return self._due[0][0] if self._due else float("inf")

    def close(self) -> None:
        """Serve no more."""
        self._node.destroy_service(self._service)

    def _take(self, text: str, header: Any) -> None:
        self._requests += 1
        name, size = text.split(" ", 2)[:2], len(text)
        if len(name) < 2 or not name[1].isdecimal():  # not by a `_Client`
            self._broken += 1
            return
        key, response_size = name[0], int(name[1])
        self._again += key in self._taken
        self._taken.add(key)
        whole = f"{key} {response_size} "
        self._broken += text != _text(whole, size if size > len(whole) else 0)
        response = self._kind.Response()
        response.map.header.frame_id = key
        response.map.header.stamp.sec = os.getpid()
        response.map.data = _bytes(key, response_size)
        self._gathered.append((response, header))
        if len(self._gathered) < self._gather or self._delay is None:
            return
        random.shuffle(self._gathered)
        now = time.monotonic()
        for answer, caller in self._gathered:
            heapq.heappush(self._due, (now + random.uniform(*self._delay), next(self._order), answer, caller))
        self._gathered.clear()


class _Calls:
    """The calls that were begun last on one client."""

    def __init__(self, caller: str, count: int, at_once: int, size: int, response: int, rate: float) -> None:
        self._caller, self._count, self._at_once, self._rate = caller, count, at_once, rate
        self._size, self._response = size, response
        self._asked = self._answered = 0
        self._wrong: list[str] = []
        self._began = self._last = time.monotonic()
        self._took: list[float] = []
        self._servers: set[int] = set()

    def next(self) -> tuple[str, str] | None:
        """The next call's name and text, where it is its turn."""
        under_way = self._asked - self._answered - len(self._wrong)
        if self._asked == self._count or under_way >= self._at_once or self.due > time.monotonic():
            return None
        self._asked += 1
        key = f"{self._caller}/{self._asked}"
        return key, _text(f"{key} {self._response} ", self._size)

    @property
    def due(self) -> float:
        """When the next call is to be made, for its rate."""
        if self._asked == self._count:
            return float("inf")
        return self._began + self._asked / self._rate if self._rate else 0.0

    def take(self, key: str, since: float, response: Any) -> None:
        self._last = time.monotonic()
        grid = response.map
        if grid.header.frame_id == key and grid.data == _bytes(key, self._response):
            self._answered += 1
            self._took.append(self._last - since)
            self._servers.add(grid.header.stamp.sec)
        else:
            self._wrong.append(f"{key} got the answer of {grid.header.frame_id}, {len(grid.data)} bytes")

    def outcome(self) -> Outcome:
        took = sorted(self._took) or [0.0]
        rate = self._answered / ((self._last - self._began) or 1.0)
        p50, p99 = took[len(took) // 2], took[len(took) * 99 // 100]
        return Outcome(self._count, self._asked, self._answered, self._wrong[:5], rate, p50, p99, sorted(self._servers))


class _Client:
    """A client, taken from by `_Loop`."""

    def __init__(self, node: Any, service: str, depth: int = DEEP, busy: float = 0.0) -> None:
        from nav_msgs.srv import LoadMap
        from rclpy.qos import QoSProfile

        self._node = node
        self._busy = busy
        self.client = node.create_client(LoadMap, service, qos_profile=QoSProfile(depth=depth))
        self.handle = self.client.handle
        self.calls = _Calls("", 0, 0, 0, 0, 0.0)
        self._kind = LoadMap
        self._waiting: dict[int, tuple[_Calls, str, float]] = {}

    def work(self) -> float:
        """Take answers, and make the calls whose turn it is; when the next call's turn is."""
        with self.handle:
            while True:
                header, response = self.handle.take_response(self._kind.Response)
                if header is None:
                    break
                calls, key, since = self._waiting.pop(header.request_id.sequence_number)
                calls.take(key, since, response)
                if self._busy:
                    time.sleep(self._busy)
                    break
            while (following := self.calls.next()) is not None:
                key, text = following
                request, since = self._kind.Request(map_url=text), time.monotonic()
                self._waiting[self.handle.send_request(request)] = self.calls, key, since
        return self.calls.due

    def close(self) -> None:
        self._node.destroy_client(self.client)


class _Loop:
    """Carries out commands, takes messages, and gives answers that are due, in turn."""

    def __init__(self, domain_id: int) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
        from rclpy.signals import SignalHandlerOptions

        self._rclpy = _rclpy
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        with self._context.handle:
            self._guard = _rclpy.GuardCondition(self._context.handle)
        self._told: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._nodes: dict[str, Any] = {}
        self._servers: dict[str, _Server] = {}
        self._clients: dict[str, _Client] = {}
        self._numbers = itertools.count()

    def listen(self) -> None:
        """Pass on lines of standard input, on a thread of its own."""
        for line in itertools.chain(sys.stdin, ("",)):
            self._told.put(line)
            with self._guard:
                self._guard.trigger_guard_condition()

    def run(self) -> None:
        """Until the input ends."""
        line = None
        while line != "":
            due = min([each.work() for each in self._entities()], default=float("inf"))
            self._wait(min(1.0, max(0.0, due - time.monotonic())))
            while not self._told.empty() and (line := self._told.get()):
                sys.stdout.write(json.dumps({"is": self._act(json.loads(line))}) + "\n")
                sys.stdout.flush()
        for node in self._nodes.values():
            node.destroy_node()
        self._context.shutdown()

    def _entities(self) -> list[_Server | _Client]:
        return [*self._servers.values(), *self._clients.values()]

    def _wait(self, seconds: float) -> None:
        """Wait for a message or a command."""
        with contextlib.ExitStack() as stack:
            for handle in (self._context.handle, self._guard, *(each.handle for each in self._entities())):
                stack.enter_context(handle)
            numbers = len(self._clients), len(self._servers)
            waits = self._rclpy.WaitSet(0, 1, 0, *numbers, 0, self._context.handle)
            stack.enter_context(waits)
            waits.clear_entities()
            waits.add_guard_condition(self._guard)
            for client in self._clients.values():
                waits.add_client(client.handle)
            for server in self._servers.values():
                waits.add_service(server.handle)
            waits.wait(int(seconds * 1e9))

    def _act(self, request: dict[str, Any]) -> object:
        do, service = request.pop("do"), request.pop("service")
        match do:
            case "serve":
                self._servers[service] = _Server(self._node(request.pop("node")), service, **request)
            case "client":
                self._clients[service] = _Client(self._node("client"), service, **request)
            case "unserve":
                self._servers.pop(service).close()
            case "served":
                return self._servers[service].served()
            case "ready":
                return all([self._client(each).client.service_is_ready() for each in service])  # noqa: C419 - makes all
            case "call":
                caller = f"{os.getpid()}.{next(self._numbers)}"
                self._client(service).calls = _Calls(caller, **request)
            case "outcome":
                return self._client(service).calls.outcome()
            case "clear":
                for each in self._entities():
                    each.close()
                self._servers.clear()
                self._clients.clear()
            case "give up":
                client = self._client(service)
                del self._clients[service]
                client.close()
                return client.calls.outcome()
        return None

    def _client(self, service: str) -> _Client:
        if service not in self._clients:
            self._clients[service] = _Client(self._node("caller"), service)
        return self._clients[service]

    def _node(self, name: str) -> Any:
        from rclpy.node import Node

        if name not in self._nodes:
            self._nodes[name] = Node(
                name, context=self._context, enable_rosout=False, use_global_arguments=False,
                start_parameter_services=False,
            )  # fmt: skip
        return self._nodes[name]


def _main(domain_id: int) -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    keep_output_clean()
    loop = _Loop(domain_id)
    threading.Thread(target=loop.listen, daemon=True).start()
    loop.run()


if __name__ == "__main__":
    _main(int(sys.argv[1]))
