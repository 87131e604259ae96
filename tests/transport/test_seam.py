"""Links and routes run over every transport that fulfils its protocol."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import get_args

import pytest
from tests.support import constants

import rsb_bridge
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.config.validation import validate
from rsb_bridge.model import transports
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.transport_traits import TransportTraits
from rsb_bridge.transport.registry import default_transports
from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.udp import Udp

_ROOT = Path(rsb_bridge.__file__).parent
_ABOVE = [file for layer in ("engine", "link", "route", "channel") for file in (_ROOT / layer).rglob("*.py")]


def test_no_layer_above_asks_which_transport_it_has() -> None:
    """They ask for its properties, so that a new transport changes none of them."""
    assert _ABOVE
    for file in _ABOVE:
        nodes = [*ast.walk(ast.parse(file.read_text()))]
        named = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
        assert not {"tcp", "udp", "bluetooth"} & named, file
        imported = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
        assert not {f"rsb_bridge.transport.{name}" for name in ("tcp", "udp", "rfcomm")} & imported, file


@pytest.mark.parametrize(
    ("server_ip", "name"),
    [("192.168.1.10", "tcp"), ("fe80::1", "tcp"), ("robot.local", "tcp"), ("5C:F3:70:9A:1B:2E", "bluetooth")],
)
def test_the_servers_address_says_what_carries_the_link(server_ip: str, name: str) -> None:
    assert default_transports().of_link(server_ip).name == name


def test_facts_of_transport_are_all_that_session_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its addresses and the topics that may cross it follow from one declaration."""

    class Serial(TransportTraits):
        name = "serial"
        medium = "RS-485"
        ip_ports = False

        @staticmethod
        def carries_links_to(host: str) -> bool:
            return host.startswith("/dev/")

    by_name = constants.TRANSPORTS_BY_NAME
    by_name.set(monkeypatch, {"serial": Serial, **by_name.value})
    topics = (Topic("/scan", "transmit"), Topic("/map", "transmit", protocol="tcp"))
    session = Session(name="robot1", role="client", server_ip="/dev/ttyS0", server_port=5000, topics=topics)
    (problem,) = (each for each in validate(session) if each.location != "key_file")
    assert problem.location == "topics[1].protocol"
    assert problem.message == TopicMistake.NOT_CROSSING(
        protocol="tcp", needed="IP", chosen_by="server_ip is a host", medium="RS-485", crossing="serial"
    )
    assert session.crossing == ("serial",)


@pytest.mark.parametrize("name", get_args(transports.Protocol))
def test_each_name_has_facts(name: str) -> None:
    assert transports.named(name).name == name


def test_addresses_read_as_their_transport_writes_them() -> None:
    assert Tcp().format_address(("10.0.0.1", 5)) == "10.0.0.1:5"
    assert Udp().format_address(("fe80::1", 5, 0, 2)) == "[fe80::1]:5"
    assert Rfcomm().format_address(("5C:F3:70:9A:1B:2E", 5)) == "5C:F3:70:9A:1B:2E channel 5"
