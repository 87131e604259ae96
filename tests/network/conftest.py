"""Hosts and bridges that end with their test; skipped in words where the machine lets us make no hosts."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import pytest
from tests.network.hosts import Cable, Host, NoHostError
from tests.support.calls import CallNode

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from tests.network.bridging import Bridge

_TOOLS = {"ip": "iproute2", "tc": "iproute2", "nft": "nftables"}
_DOMAINS = (80, 81)


class Network:
    """Makes hosts, cables and bridges."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._hosts: list[Host] = []
        self._bridges: list[Bridge] = []
        self._nodes: list[CallNode] = []

    def host(self, name: str) -> Host:
        """A machine without a network."""
        self._hosts.append(host := Host(name))
        return host

    def router(self, name: str = "router") -> Host:
        host = self.host(name)
        host.run("sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward")
        return host

    def bridge(
        self,
        robot: Host,
        pc: Host,
        address: str,
        *topics: dict[str, Any],
        services: tuple[dict[str, Any], ...] = (),
        both: Mapping[str, Any] | None = None,
        zenoh: bool = False,
    ) -> Bridge:
        """A client on the robot and a server on the PC, which it reaches by `address`; linked.

        Args:
            both: further keys of both session files.
            zenoh: whether they link over Zenoh.
        """
        from tests.network.bridging import Sessions

        sessions = Sessions(self._folder, address, *topics, services=services, domains=_DOMAINS, both=both, zenoh=zenoh)
        bridge = sessions.run(robot, pc)
        self._bridges.append(bridge)
        bridge.client.happens(EventCode.LINK_UP)
        return bridge

    def callers_and_servers(self, robot: Host, pc: Host) -> tuple[CallNode, CallNode]:
        """Start a calling node in the client's domain, and an answering one in the server's."""
        self._nodes += (CallNode(domain, host.start) for domain, host in zip(_DOMAINS, (robot, pc), strict=True))
        return self._nodes[-2], self._nodes[-1]

    def close(self) -> None:
        """End everything."""
        try:
            for node in self._nodes:
                node.close()
            for bridge in self._bridges:
                bridge.close()
        finally:
            for host in self._hosts:
                host.close()


@pytest.fixture(scope="session")
def _hosts_can_be_made() -> None:
    for tool, package in _TOOLS.items():
        if shutil.which(tool) is None:
            pytest.skip(f"bad networks need {tool} (apt install {package})")
    try:
        Host("probe").close()
    except NoHostError as error:
        pytest.skip(f"bad networks need network namespaces, which this machine refuses (are you root?): {error}")


@pytest.fixture
def network(_hosts_can_be_made: None, tmp_path: Path) -> Iterator[Network]:
    made = Network(tmp_path)
    yield made
    made.close()


@pytest.fixture
def robot(network: Network) -> Host:
    """The client's machine."""
    return network.host("robot")


@pytest.fixture
def pc(network: Network) -> Host:
    """The server's machine."""
    return network.host("pc")


@pytest.fixture
def cable(robot: Host, pc: Host) -> Cable:
    """Between the two, with addresses: the robot's end in .2, the PC's in .1."""
    cable = Cable(robot, pc)
    cable.address(("10.99.1.2/24", "10.99.1.1/24"), ("fd99::2/64", "fd99::1/64"))
    return cable
