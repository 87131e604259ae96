"""The ends of `bench.robot`: a robot's nodes, and the nodes that hear them.

- ``talk DOMAIN TOPIC:HZ:BYTES:RELIABILITY...``: ``match`` answers with the fewest subscribers of a topic; ``go
  SECONDS`` publishes, and answers with when it published each one.
- ``listen DOMAIN TOPIC:HZ:BYTES:RELIABILITY...``: ``report`` answers with when each message was made and heard.
- ``forward DOMAIN HOST:PORT TOPIC...`` and ``publish DOMAIN HOST:PORT TOPIC...``: the two ends of a bare bridge, with a
  TCP connection for each topic, without a cipher and without limits.
- ``serve DOMAIN CALL...``: the robot's services, an action whose goals last `GOAL_LASTS`, and its node's parameters.
- ``call DOMAIN CALL:HZ:BYTES:...``: calls them. ``match`` answers with how many servers are seen, ``go SECONDS`` with
  when each call was made, and ``report`` with when it was made and answered.

Times are ns of the monotonic clock, which all network namespaces of a machine share.
"""

from __future__ import annotations

import heapq
import json
import socket
import struct
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any, BinaryIO

from bench.relay import node_in
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

from rsb_bridge.cdr.known_types import made_at, stamped_string
from rsb_extras.bench.measured_stream import drain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.action.server import ServerGoalHandle
    from rclpy.node import Node

_LENGTH = struct.Struct("<I")
_DEPTH = {"reliable": 10, "best_effort": 5}
GOAL_LASTS = 2.0
"""s from a goal's acceptance to its result; feedback comes every `_FEEDBACK` s meanwhile."""
_FEEDBACK = 0.2
PARAMETERS, NODE = "/bench_robot/get_parameters", "bench_robot"
GOAL, RESULT = "goal of ", "result of "
"""What is measured of an action: until its goal is accepted, and until its result comes, less the s that it lasts."""


def _qos(reliability: str, depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy[reliability.upper()])


def _say(**answer: object) -> None:
    print(json.dumps(answer), flush=True)


def talk(domain: int, topics: list[list[str]]) -> None:
    node = node_in(domain)
    publishers = {
        name: (node.create_publisher(String, name, _qos(reliability, _DEPTH[reliability])), float(rate), int(size))
        for name, rate, size, reliability in topics
    }
    for line in sys.stdin:
        command, *words = line.split()
        if command == "match":
            _say(matched=min(publisher.get_subscription_count() for publisher, _, _ in publishers.values()))
            continue
        made: dict[str, list[int]] = {name: [] for name in publishers}
        for name in _due({name: rate for name, (_, rate, _) in publishers.items()}, float(words[0])):
            publisher, _, size = publishers[name]
            message = stamped_string(size)
            made[name].append(made_at(message))
            publisher.handle.publish_raw(message)
        _say(**made)


def _due(rates: dict[str, float], seconds: float) -> Iterator[str]:
    """Yield each name at its rate (Hz)."""
    began = time.monotonic_ns()
    ends = began + int(seconds * 1e9)
    # Topics of one rate do not publish together, as nodes of a robot do not.
    due = [(began + index * 1_700_000, name) for index, name in enumerate(rates)]
    while due[0][0] < ends:
        at, name = heapq.heappop(due)
        time.sleep(max(0, at - time.monotonic_ns()) / 1e9)
        yield name
        heapq.heappush(due, (at + int(1e9 / rates[name]), name))


def listen(domain: int, topics: list[list[str]]) -> None:
    node = node_in(domain)
    heard: dict[str, list[tuple[int, int]]] = {name: [] for name, *_ in topics}

    def take(arrivals: list[tuple[int, int]], payload: bytes) -> None:
        arrivals.append((made_at(payload), time.monotonic_ns()))

    for name, _, _, reliability in topics:
        subscription = node.create_subscription(String, name, lambda _: None, _qos(reliability, 100), raw=True)
        taking = partial(drain, node.context, [subscription.handle], partial(take, heard[name]))
        threading.Thread(target=taking, daemon=True).start()
    _say(ready=True)
    for _ in sys.stdin:
        _say(**heard)


def forward(domain: int, topics: list[list[str]]) -> None:
    node, at = node_in(domain), topics.pop(0)
    for name, _, _, reliability in topics:
        connection = socket.create_connection((at[0], int(at[1])))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(_LENGTH.pack(len(name)) + name.encode())
        subscription = node.create_subscription(
            String, name, lambda _: None, _qos(reliability, _DEPTH[reliability]), raw=True
        )
        taking = partial(drain, node.context, [subscription.handle], partial(_write, connection))
        threading.Thread(target=taking, daemon=True).start()
    sys.stdin.read()


def _write(connection: socket.socket, payload: bytes) -> None:
    connection.sendall(_LENGTH.pack(len(payload)) + payload)


def publish(domain: int, topics: list[list[str]]) -> None:
    node, at = node_in(domain), topics.pop(0)
    reliabilities = {name: reliability for name, _, _, reliability in topics}
    listener = socket.create_server((at[0], int(at[1])))
    _say(ready=True)
    for _ in topics:
        connection = listener.accept()[0].makefile("rb")
        threading.Thread(target=_publish, args=(node, connection, reliabilities), daemon=True).start()
    sys.stdin.read()


def _publish(node: Node, connection: BinaryIO, reliabilities: dict[str, str]) -> None:
    name = _next(connection).decode()
    reliability = reliabilities[name]
    publisher = node.create_publisher(String, name, _qos(reliability, _DEPTH[reliability]))
    while payload := _next(connection):
        publisher.handle.publish_raw(payload)


def _next(connection: BinaryIO) -> bytes:
    header = connection.read(_LENGTH.size)
    return connection.read(*_LENGTH.unpack(header)) if header else b""


def serve(domain: int, calls: list[list[str]]) -> None:
    node = node_in(domain, NODE, start_parameter_services=True)
    node.declare_parameter("speed", 0.5)
    for name, _, size, kind in calls:
        if kind == "service":
            node.create_service(Trigger, name, partial(_answer, "x" * int(size)))
        elif kind == "action":
            ActionServer(node, Fibonacci, name, _execute)
    _spin(node)
    _say(ready=True)
    sys.stdin.read()


def _answer(text: str, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
    response.message = text
    return response


def _execute(goal: ServerGoalHandle) -> Fibonacci.Result:
    ends = time.monotonic() + GOAL_LASTS
    while (left := ends - time.monotonic()) > 0:
        goal.publish_feedback(Fibonacci.Feedback(sequence=[0, 1]))
        time.sleep(min(left, _FEEDBACK))
    goal.succeed()
    return Fibonacci.Result()


def call(domain: int, calls: list[list[str]]) -> None:
    caller = _Caller(node_in(domain), calls)
    for line in sys.stdin:
        command, *words = line.split()
        if command == "match":
            _say(matched=caller.matched())
        elif command == "go":
            for name in _due({name: float(rate) for name, rate, *_ in calls}, float(words[0])):
                caller.ask[name]()
            _say(**caller.made)
        else:
            _say(**caller.answered)


class _Caller:
    """The callers of a robot's services, of its action and of its parameters.

    Attributes:
        ask: calls each once.
        made: when (ns) each was called.
        answered: when (ns) each that was answered was called and answered.
    """

    def __init__(self, node: Node, calls: list[list[str]]) -> None:
        self.ask: dict[str, Callable[[], None]] = {}
        self.made: dict[str, list[int]] = {}
        self.answered: dict[str, list[tuple[int, int]]] = {}
        self._clients: list[Any] = []
        for name, _, _, kind in calls:
            if kind == "action":
                client = ActionClient(node, Fibonacci, name)
                self.ask[name] = partial(self._send_goal, client, name)
                shown = [GOAL + name, RESULT + name]
            else:
                is_service = kind == "service"
                client = node.create_client(Trigger if is_service else GetParameters, name)
                request = Trigger.Request() if is_service else GetParameters.Request(names=["speed"])
                self.ask[name] = partial(self._call, client, name, request)
                shown = [name]
            self._clients.append(client)
            self.made |= {each: [] for each in shown}
            self.answered |= {each: [] for each in shown}
        _spin(node)

    def matched(self) -> int:
        """Return whether all servers are seen."""
        return all(
            client.server_is_ready() if isinstance(client, ActionClient) else client.service_is_ready()
            for client in self._clients
        )

    def _call(self, client: Any, name: str, request: object) -> None:
        made = self._make(name)
        client.call_async(request).add_done_callback(lambda _: self._answered(name, made))

    def _send_goal(self, client: ActionClient, name: str) -> None:
        made, ends = self._make(GOAL + name), self._make(RESULT + name, GOAL_LASTS)

        def accepted(future: Any) -> None:
            self._answered(GOAL + name, made)
            future.result().get_result_async().add_done_callback(lambda _: self._answered(RESULT + name, ends))

        client.send_goal_async(Fibonacci.Goal(order=1)).add_done_callback(accepted)

    def _make(self, name: str, later: float = 0.0) -> int:
        made = time.monotonic_ns() + int(later * 1e9)
        self.made[name].append(made)
        return made

    def _answered(self, name: str, made: int) -> None:
        self.answered[name].append((made, time.monotonic_ns()))


def _spin(node: Node) -> None:
    executor = MultiThreadedExecutor(context=node.context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()


if __name__ == "__main__":
    part = {each.__name__: each for each in (talk, listen, forward, publish, serve, call)}[sys.argv[1]]
    part(int(sys.argv[2]), [each.split(":") for each in sys.argv[3:]])
