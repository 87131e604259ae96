"""Links and routes run over every transport that fulfils its protocol."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rsb_bridge
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


def test_addresses_read_as_their_transport_writes_them() -> None:
    assert Tcp().format_address(("10.0.0.1", 5)) == "10.0.0.1:5"
    assert Udp().format_address(("fe80::1", 5, 0, 2)) == "[fe80::1]:5"
    assert Rfcomm().format_address(("5C:F3:70:9A:1B:2E", 5)) == "5C:F3:70:9A:1B:2E channel 5"
