"""A program with nodes in a domain, a managed one among them, in a process of its own."""

from __future__ import annotations

import subprocess
import sys

LIDAR, CAMERA = "/front/lidar", "/front/camera"
_PROGRAM = """
import sys, threading, rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import QoSProfile, DurabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init(args=[], domain_id=int(sys.argv[1]))
executor = SingleThreadedExecutor()
lidar = Node("lidar", namespace="/front", start_parameter_services=False)
scan = lidar.create_publisher(String, "/scan", 10)
lidar.create_subscription(String, "/speed", print, 10)
lidar.create_service(Trigger, "/front/reset", lambda _, answer: Trigger.Response(success=True, message="well"))
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
plan = lidar.create_publisher(String, "/plan", latched)
plan.publish(String(data="the plan"))
camera = LifecycleNode("camera", namespace="/front")
camera.declare_parameter("exposure", 20)
for each in (lidar, camera):
    executor.add_node(each)
threading.Thread(target=executor.spin, daemon=True).start()
print("ready", flush=True)
for line in sys.stdin:
    if line == "end\\n":
        executor.remove_node(lidar)
        lidar.destroy_node()
    else:
        scan.publish(String(data=line.strip()))
    print("done", flush=True)
"""


class FarProgram:
    """The process. Its lidar publishes /scan and a latched /plan, hears /speed and serves /front/reset."""

    def __init__(self, domain_id: int) -> None:
        self._process = subprocess.Popen(
            (sys.executable, "-c", _PROGRAM, str(domain_id)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._hear("ready")

    def scan(self, words: str) -> None:
        """Have the lidar publish."""
        self._say(words)

    def end_lidar(self) -> None:
        """Destroy the lidar's node; the camera goes on."""
        self._say("end")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()

    def _say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        self._hear("done")

    def _hear(self, word: str) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"{word}\n"
