"""Nodes that a topic drives are asked whether they stop by themselves, and told nothing."""

from __future__ import annotations

import os
import subprocess
import sys

from geometry_msgs.msg import Twist
from tests.support.locks import domains_of
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_bridge.ros.base_timeouts import base_timeouts


def test_a_base_tells_its_timeouts() -> None:
    domain = domains_of("nodes")
    base = Spun(domain, "base")
    arm = Spun(domain, "arm", start_parameter_services=False)
    try:
        for node in (base.node, arm.node):
            node.create_subscription(Twist, "/cmd_vel", lambda _: None, 1)
        base.node.declare_parameter("cmd_vel_timeout", 0.5)
        base.node.declare_parameter("log.timeout", 9.0)
        base.node.declare_parameter("watchdog_enabled", False)
        expected = {"/base": {"cmd_vel_timeout": 0.5, "watchdog_enabled": False}, "/arm": None}
        eventually(lambda: base_timeouts(domain, ["/cmd_vel"]) == {"/cmd_vel": expected})
    finally:
        base.close()
        arm.close()


def test_answers_without_home() -> None:
    """In a process of its own, as the doctor asks: ROS would have no folder for its log."""
    environ = {name: value for name, value in os.environ.items() if name not in ("HOME", "ROS_HOME", "ROS_LOG_DIR")}
    command = (sys.executable, "-m", "rsb_bridge.ros.base_timeouts", str(domains_of("nodes")), "/nobodys")
    asked = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=180, check=False)
    # The last line, as the doctor reads it: DDS prints its own troubles before it.
    assert (asked.returncode, asked.stdout.splitlines()[-1:]) == (0, ['{"/nobodys": {}}']), asked.stderr
