"""domain_bridge and rosbridge of a sourced ROS installation, for comparison (`.github/workflows/peers.yml`).

- ``python -m bench.installed_bridges domain_bridge CONFIG`` becomes the first: one process in both domains.
- ``rosbridge NEAR PORT`` becomes the second: a websocket at a port of this machine, for clients that are no ROS nodes.
- ``client FAR PORT TOPIC`` is such a client, which publishes what it gets in another domain. It says when it listens.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bench.relay import node_in
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from rsb_extras.bench.measured_stream import DEPTH
from rsb_extras.demo.demo_session import free_port
from rsb_extras.demo.processes import Process, listening

if TYPE_CHECKING:
    from collections.abc import Iterator

DOMAIN_BRIDGE, ROSBRIDGE = "domain-bridge", "rosbridge"
_PROGRAMS = {
    DOMAIN_BRIDGE: ("domain_bridge/domain_bridge", "domain-bridge"),
    ROSBRIDGE: ("rosbridge_server/rosbridge_websocket", "rosbridge-server"),
}
"""Below an installation's ``lib``; and the package's name without its distribution."""
_TYPE = "std_msgs/msg/String"


def program(name: str) -> str:
    """Return the path of a bridge, or end this process with a sentence if it is not installed."""
    file, package = _PROGRAMS[name]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (path := Path(prefix, "lib", file)).exists():
            return str(path)
    raise SystemExit(f"{name} is not installed: source a ROS that has it (apt install ros-jazzy-{package})")


@contextmanager
def between(name: str, near: int, far: int, topic: str) -> Iterator[list[Process]]:
    """Start a bridge between two domains; yield its processes, in the order in which messages pass."""
    program(name)
    with ExitStack() as started:
        if name == DOMAIN_BRIDGE:
            config = Path(started.enter_context(tempfile.TemporaryDirectory(prefix="rsb-bench-")), "bridge.yaml")
            topics = f"topics:\n  {topic}: {{type: {_TYPE}}}\n"
            config.write_text(f"name: bench\nfrom_domain: {near}\nto_domain: {far}\n{topics}")
            yield [started.enter_context(_process("domain_bridge", config))]
            return
        port = free_port()
        server = started.enter_context(_process("rosbridge", near, port))
        listening(server, port)
        client = started.enter_context(_process("client", far, port, topic))
        client.line()
        yield [server, client]


def _process(*arguments: object) -> Process:
    return Process("-m", "bench.installed_bridges", *map(str, arguments))


def domain_bridge(config: str) -> None:
    path = program(DOMAIN_BRIDGE)
    os.execv(path, [path, config])


def rosbridge(near: str, port: str) -> None:
    path = program(ROSBRIDGE)
    os.environ["ROS_DOMAIN_ID"] = near
    os.execv(path, [path, "--port", port, "--address", "127.0.0.1"])


def client(far: str, port: str, topic: str) -> None:
    from tornado.websocket import websocket_connect  # noqa: PLC0415 -- it comes with rosbridge

    publisher = node_in(int(far)).create_publisher(String, topic, QoSProfile(depth=DEPTH))

    async def republish() -> None:
        socket = await websocket_connect(f"ws://127.0.0.1:{port}")
        subscribes = {"op": "subscribe", "topic": topic, "type": _TYPE, "queue_length": DEPTH}
        await socket.write_message(json.dumps(subscribes))
        print("listens", flush=True)
        while (message := await socket.read_message()) is not None:
            publisher.publish(String(data=json.loads(message)["msg"]["data"]))

    asyncio.run(republish())


if __name__ == "__main__":
    {each.__name__: each for each in (domain_bridge, rosbridge, client)}[sys.argv[1]](*sys.argv[2:])
