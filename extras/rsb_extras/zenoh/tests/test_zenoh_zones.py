"""Interfaces in the endpoints of a Zenoh network."""

from __future__ import annotations

import sys
from contextlib import closing

import pytest
from tests.network.hosts import Host
from tests.support.long import long
from tests.support.wording import says

from rsb_extras.zenoh.network import NetworkProblem

_OVER_ZENOH = """
import asyncio
from pathlib import Path
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.network import Network

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


@pytest.mark.usefixtures("_hosts_can_be_made")
@pytest.mark.parametrize("name", long("wlan7"))
def test_an_endpoint_names_its_interface(name: str) -> None:
    """An interface that is not there is named, too."""
    pytest.importorskip("zenoh")
    with closing(Host("robot")) as robot:
        robot.run("ip", "link", "add", "br-lan", "type", "bridge")
        robot.run("ip", "link", "set", "br-lan", "up")
        robot.address("br-lan", "fe80::1/64")
        said = robot.run(sys.executable, "-c", _OVER_ZENOH)
    assert says(said.strip(), NetworkProblem.NO_INTERFACE, endpoint=f"tcp/[fe80::1%{name}]:7447", name=name), said
