"""A node in a process of its own, and what an engine shows of the other side's nodes."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from rsb_extras.nodes.node_book import NodeBook
from rsb_extras.nodes.node_data import Nodes, NodeState

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine

LIDAR = "/front/lidar_driver"
_NODE = """
import sys, time, rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init(args=[], domain_id=int(sys.argv[1]))
node = rclpy.create_node("lidar_driver", namespace="/front", start_parameter_services=False)
node.create_publisher(String, "/scan", 10)
node.create_subscription(String, "/speed", print, 10)
node.create_service(Trigger, "/front/reset", lambda _, answer: answer)
print("ready", flush=True)
while sys.stdin.readline():
    node.get_logger().info("all is well")
    node.get_logger().error("motor stalled\\n\\x1b[31mat once")
    print("logged", flush=True)
"""


class Lidar:
    """The process. It publishes /scan, and logs an error when it is told to."""

    def __init__(self, domain_id: int) -> None:
        self._process = subprocess.Popen(
            (sys.executable, "-c", _NODE, str(domain_id)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        self._hear("ready")

    def log(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        self._hear("logged")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()

    def _hear(self, word: str) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"{word}\n"


class Looker:
    """Looks at the nodes of one side, as a console does."""

    def __init__(self, engine: Engine, link: str | None = "robot1") -> None:
        self._engine, self._link = engine, link
        self._at = (0, 0)
        self.book = NodeBook()
        self.taken = 0

    def look(self) -> NodeBook:
        found = self._engine.do(Nodes(self._link, *self._at)).result(60)
        self._at = found.book, found.number
        self.book.take(found, found.now)
        self.book.why_not = found.why_not
        self.taken += len(found.nodes) + len(found.processes) + len(found.gone)
        return self.book

    def lidar(self) -> NodeState | None:
        return self.look().nodes.get(LIDAR)
