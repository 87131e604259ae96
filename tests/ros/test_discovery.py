"""Discovery servers as the environment lists them, and the question whether they answer."""

from __future__ import annotations

import socket
from contextlib import closing

import pytest
from tests.support.discovery_server import discovery_server
from tests.support.ports import free_port
from tests.support.wording import says

from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.discovery import (
    Discovery,
    DiscoveryServer,
    DiscoveryText,
    discovery_servers,
    whole_graph,
)


@pytest.mark.parametrize(
    ("entries", "servers"),
    [
        ("", []),
        ("10.0.0.1", [(0, "UDP", "", "10.0.0.1", 11811)]),
        ("10.0.0.1:11888;robot:1", [(0, "UDP", "", "10.0.0.1", 11888), (1, "UDP", "", "robot", 1)]),
        (";;10.0.0.1:1; ", [(2, "UDP", "", "10.0.0.1", 1)]),
        ("[fd00::1]:5", [(0, "UDP", "", "fd00::1", 5)]),
        ("UDPv6:[robot]:5", [(0, "UDP", "6", "robot", 5)]),
        ("TCPv4:[10.0.0.1]", [(0, "TCP", "4", "10.0.0.1", 42100)]),
    ],
)
def test_listed_servers(entries: str, servers: list[tuple[object, ...]]) -> None:
    assert discovery_servers({"ROS_DISCOVERY_SERVER": entries}) == (tuple(servers), "")


@pytest.mark.parametrize("entries", ["10.0.0.1:", "10.0.0.1:99999", "[fd00::1"])
def test_unreadable_list_is_a_problem(entries: str) -> None:
    discovery = Discovery({"ROS_DISCOVERY_SERVER": entries})
    assert (discovery.servers, discovery.is_broken) == ((), True)
    assert says(discovery.found, DiscoveryText.UNREADABLE, entry=entries)


def test_other_middlewares_have_no_servers() -> None:
    discovery = Discovery({"ROS_DISCOVERY_SERVER": "10.0.0.1", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    assert (discovery.servers, discovery.found, [*discovery.notes()]) == ((), "", [])


def test_real_server_answers() -> None:
    port = free_port()
    with discovery_server(port):
        assert _server(port).problem() == ""
        discovery = Discovery({"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port}"})
        assert discovery.look()
        assert not discovery.look()
        assert (discovery.is_broken, discovery.found) == (False, DiscoveryText.ANSWERS(server=_server(port)))


def test_server_of_another_id_is_named() -> None:
    """A client of Fast DDS 2 does not know it, and is deaf."""
    port = free_port()
    with discovery_server(port, number=3):
        assert says(_server(port).problem(), DiscoveryText.OTHER_NUMBER, number=3, place=0)
        assert _server(port, place=3).problem() == ""


def test_servers_that_do_not_answer() -> None:
    refused, silent = free_port(), free_port()
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as taken:
        taken.bind(("127.0.0.1", silent))
        for port in (refused, silent):
            assert says(_server(port).problem(), DiscoveryText.SILENT, server=_server(port))
    over_tcp = _server(refused)._replace(transport="TCP")
    assert says(over_tcp.problem(), DiscoveryText.SILENT)


def test_one_server_of_two_is_enough() -> None:
    port, other = free_port(), free_port()
    with discovery_server(port):
        discovery = Discovery({"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port};127.0.0.1:{other}"})
        discovery.look()
    assert not discovery.is_broken
    assert says(discovery.found, DiscoveryText.ANSWERS)
    assert says(discovery.found, DiscoveryText.SILENT, server=_server(other))


@pytest.mark.parametrize("before", [{}, {"ROS_SUPER_CLIENT": "False"}])
def test_participant_is_a_super_client(before: dict[str, str]) -> None:
    """Setup files of robots export it as false where there is no terminal."""
    environment = dict(before)
    with whole_graph(environment):
        assert environment == {"ROS_SUPER_CLIENT": "TRUE"}
    assert environment == before


def test_range_that_is_off_hides_all() -> None:
    discovery = Discovery({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off", "ROS_DISCOVERY_SERVER": "127.0.0.1"})
    assert says(discovery.found, DiscoveryText.OFF)
    assert [level for level, _ in discovery.notes()] == [Level.INFO, Level.WARNING]
    assert not Discovery({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_LOCALHOST_ONLY": "1"}).is_broken


def _server(port: int, place: int = 0) -> DiscoveryServer:
    return DiscoveryServer(place, "UDP", "", "127.0.0.1", port)
