"""Host names whose name server does not answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.network.bridging import Program, Sessions

from rsb_bridge.model.codes import EventCode
from rsb_bridge.transport.listening import LookUpProblem

if TYPE_CHECKING:
    from pathlib import Path

    from tests.network.hosts import Host


def test_silent_name_server_delays_no_stop(robot: Host, tmp_path: Path) -> None:
    servers = tmp_path / "resolv.conf"
    servers.write_text("nameserver 127.0.0.2\n")
    robot.run("mount", "--bind", str(servers), "/etc/resolv.conf")
    robot.wall("udp dport 53 drop")
    client = Program(robot, Sessions(tmp_path, "pc.example", domains=(80, 81)).client)
    client.happens(EventCode.LINK_UNREACHABLE, LookUpProblem.NO_NAME_SERVER(seconds=5))
    client.happens(EventCode.LINK_CONNECTING)
    client.close()
