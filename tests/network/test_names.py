"""Host names whose name server does not answer, and interfaces in addresses."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from tests.network.bridging import Program, Sessions
from tests.support.wording import says

from rsb_bridge.model.codes import EventCode
from rsb_bridge.transport.listening import LookUpProblem
from rsb_bridge.transport.zenoh.network import NetworkProblem

if TYPE_CHECKING:
    from pathlib import Path

    from tests.network.hosts import Host

_OVER_ZENOH = """
import asyncio
from pathlib import Path
from rsb_bridge.model.session import ZenohSettings
from rsb_bridge.transport.zenoh.network import Network

def place(zone):
    return (f"tcp/[fe80::1%{zone}]:7447",)

async def meet():
    listening = Network(ZenohSettings(listen=place("br-lan")), Path())
    calling = Network(ZenohSettings(connect=place("br-lan")), Path())
    await listening.open()
    await calling.open()
    assert calling.connected
    calling.close()
    listening.close()
    try:
        await Network(ZenohSettings(connect=place("wlan7")), Path()).open()
    except OSError as error:
        print(error)

asyncio.run(meet())
"""


def test_a_silent_name_server_is_named_and_holds_up_no_stop(robot: Host, tmp_path: Path) -> None:
    servers = tmp_path / "resolv.conf"
    servers.write_text("nameserver 127.0.0.2\n")
    robot.run("mount", "--bind", str(servers), "/etc/resolv.conf")
    robot.wall("udp dport 53 drop")
    client = Program(robot, Sessions(tmp_path, "pc.example", domains=(80, 81)).client)
    client.happens(EventCode.LINK_UNREACHABLE, LookUpProblem.NO_NAME_SERVER(seconds=5))
    client.happens(EventCode.LINK_CONNECTING)
    client.close()


def test_an_endpoint_of_zenoh_names_its_interface(robot: Host) -> None:
    """An interface that is not there is named, too."""
    pytest.importorskip("zenoh")
    robot.run("ip", "link", "add", "br-lan", "type", "bridge")
    robot.run("ip", "link", "set", "br-lan", "up")
    robot.address("br-lan", "fe80::1/64")
    said = robot.run(sys.executable, "-c", _OVER_ZENOH)
    assert says(said.strip(), NetworkProblem.NO_INTERFACE, endpoint="tcp/[fe80::1%wlan7]:7447", name="wlan7"), said
