"""Stock rclpy nodes that publish, listen, call and answer, each in a process of its own, and note when.

`python -m tests.network.traffic talk|listen DOMAIN CALLS NAME:KIND:HZ...` takes a JSON object a line and answers each
with one; `Traffic` is its other end. A message is its number, which counts up from 1, and the time at which it was
published. Times are ns of the monotonic clock, which all network namespaces of a machine share.
"""

from __future__ import annotations

import heapq
import os
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.support.asked import Asked, answers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.network.hosts import Host

SERVICE = "/ask"
CALL_EVERY, ANSWER_TAKES = 0.5, 0.3
"""s; the server answers one call after the other."""
WRONG = -1
"""In place of the time of an answer that is another call's."""
_LOOKS_EVERY = 0.05
"""s between looks at who publishes and serves. Who comes and goes in between is not seen."""


class Flow(NamedTuple):
    """A topic with a publisher on one side and a subscription on the other.

    Attributes:
        kind: ``reliable``, ``kept`` or ``latched`` (depth 10), ``deep`` (depth 1000), ``whole`` (all) or ``best``.
        rate: Hz, or 0 if it is published on request only.
        to_robot: whether the PC publishes it, for the robot.
    """

    name: str
    kind: str
    rate: float = 0.0
    to_robot: bool = False

    def __str__(self) -> str:
        return f"{self.name}:{self.kind}:{self.rate:g}"


class Traffic(Asked):
    """A process on a host, told what to do; without a peer's address it finds nodes of its own machine only."""

    def __init__(self, host: Host, part: str, domain_id: int, flows: Sequence[Flow], *, calls: bool, peer: str) -> None:
        finds = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": peer}
        variables = {**os.environ, **(finds if peer else {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})}
        words = [part, str(domain_id), str(int(calls)), *map(str, flows)]
        command = (sys.executable, "-m", "tests.network.traffic", *words)
        super().__init__(host.start(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=variables))

    def tell(self, do: str) -> Any:
        return self.ask(do=do)


# --- the processes


def _node(domain_id: int, name: str) -> Any:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
    return Node(name, context=context, enable_rosout=False, start_parameter_services=False)


def _spin(node: Any) -> None:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()


def _qos(kind: str, *, listens: bool) -> Any:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    if kind == "whole":
        return QoSProfile(history=HistoryPolicy.KEEP_ALL)
    qos = QoSProfile(depth={"deep": 1000, "best": 5}.get(kind, 10))
    if kind == "best":
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    if kind == "latched":
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        qos.depth = 100 if listens else qos.depth  # so that it sees all that comes again
    return qos


class _Talker:
    def __init__(self, domain_id: int, flows: Sequence[Flow], *, calls: bool) -> None:
        from std_msgs.msg import String

        self._kind = String
        node = _node(domain_id, "talker")
        self._publishers = {
            each.name: node.create_publisher(String, each.name, _qos(each.kind, listens=False)) for each in flows
        }
        self._made: dict[str, list[int]] = {each.name: [] for each in flows}
        self._latched = [each.name for each in flows if each.kind == "latched"]
        self._intervals = {each.name: int(1e9 / each.rate) for each in flows if each.rate}
        self._client: Any = None
        self._calls: list[list[int]] = []
        self._is_offered = False
        self._offers: list[tuple[int, bool]] = []
        if calls:
            from test_msgs.srv import BasicTypes

            self._request = BasicTypes.Request
            self._client = node.create_client(BasicTypes, SERVICE)
            self._intervals[SERVICE] = int(CALL_EVERY * 1e9)
            _spin(node)
        self._due: list[tuple[int, str]] = []

    def act(self, request: dict[str, Any]) -> object:
        match request["do"]:
            case "matched":
                return min(each.get_subscription_count() for each in self._publishers.values())
            case "served":
                return self._client is None or self._client.service_is_ready()
            case "go":
                # Topics of one rate do not publish together, as nodes of a robot do not.
                now = time.monotonic_ns()
                self._due = [(now + index * 1_700_000, name) for index, name in enumerate(self._intervals)]
            case "change":
                for name in self._latched:
                    self._publish(name)
            case "call":
                self._call()
            case "hush":
                self._due = []
            case "made":
                return self._made
            case "calls":
                return self._calls
            case "offers":
                return self._offers
        return None

    def run(self) -> None:
        while answers(self.act, self._pause()):
            if self._client is not None and self._client.service_is_ready() != self._is_offered:
                self._is_offered = not self._is_offered
                self._offers.append((time.monotonic_ns(), self._is_offered))
            while self._due and self._due[0][0] <= time.monotonic_ns():
                at, name = self._due[0]
                heapq.heapreplace(self._due, (at + self._intervals[name], name))
                if name == SERVICE:
                    self._call()
                else:
                    self._publish(name)

    def _pause(self) -> float:
        return min(_LOOKS_EVERY, max(0, self._due[0][0] - time.monotonic_ns()) / 1e9) if self._due else _LOOKS_EVERY

    def _publish(self, name: str) -> None:
        made = self._made[name]
        made.append(time.monotonic_ns())
        self._publishers[name].publish(self._kind(data=f"{len(made)} {made[-1]}"))

    def _call(self) -> None:
        call = [time.monotonic_ns(), 0]
        self._calls.append(call)
        number = len(self._calls)

        def answered(future: Any) -> None:
            call[1] = time.monotonic_ns() if future.result().int64_value == number else WRONG

        self._client.call_async(self._request(int64_value=number)).add_done_callback(answered)


class _Listener:
    def __init__(self, domain_id: int, flows: Sequence[Flow], *, calls: bool) -> None:
        from std_msgs.msg import String

        self._node = _node(domain_id, "listener")
        self._heard: dict[str, list[tuple[int, int, int]]] = {each.name: [] for each in flows}
        self._publishers: dict[str, set[bytes]] = {each.name: set() for each in flows}
        self._events: dict[str, list[tuple[int, int, int]]] = {each.name: [] for each in flows}
        self._subscriptions = [
            self._node.create_subscription(String, each.name, self._hears(each.name), _qos(each.kind, listens=True))
            for each in flows
        ]
        self._carried_out: list[int] = []
        _spin(self._node)
        if calls:
            from test_msgs.srv import BasicTypes

            server = _node(domain_id, "server")  # with an executor of its own: it keeps its thread busy
            server.create_service(BasicTypes, SERVICE, self._answer)
            _spin(server)

    def _hears(self, name: str) -> Callable[[Any], None]:
        heard = self._heard[name]

        def hear(message: Any) -> None:
            number, made = message.data.split()
            heard.append((int(number), int(made), time.monotonic_ns()))

        return hear

    def _answer(self, request: Any, response: Any) -> Any:
        self._carried_out.append(request.int64_value)
        time.sleep(ANSWER_TAKES)
        response.int64_value = request.int64_value
        return response

    def act(self, request: dict[str, Any]) -> object:
        match request["do"]:
            case "matched":
                return min(len(each) for each in self._publishers.values())
            case "newest":
                return {name: heard[-1][1] if heard else 0 for name, heard in self._heard.items()}
            case "heard":
                return self._heard
            case "events":
                return self._events
            case "carried out":
                return self._carried_out
        return None

    def run(self) -> None:
        while answers(self.act, _LOOKS_EVERY):
            for name, before in self._publishers.items():
                found = {bytes(each.endpoint_gid) for each in self._node.get_publishers_info_by_topic(name)}
                if found != before:
                    self._events[name].append((time.monotonic_ns(), len(found - before), len(before - found)))
                    self._publishers[name] = found


def _main(part: str, domain_id: str, calls: str, *flows: str) -> None:
    from rsb_bridge.model.text import keep_output_clean

    keep_output_clean()
    known = [Flow(name, kind, float(rate)) for name, kind, rate in (each.split(":") for each in flows)]
    process = _Talker if part == "talk" else _Listener
    process(int(domain_id), known, calls=calls == "1").run()
    os._exit(0)  # threads still spin


if __name__ == "__main__":
    _main(*sys.argv[1:])
