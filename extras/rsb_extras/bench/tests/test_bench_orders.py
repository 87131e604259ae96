"""Orders to measure, as consoles send them."""

from __future__ import annotations

from typing import get_args

import msgspec
import pytest
from tests.control.conftest import reachable
from tests.control.protocol_helpers import fed
from tests.support.operators import BOB, Reachable, Stranger

from rsb_bridge.control.protocol import CommandFailed, CommandRequest, encode
from rsb_bridge.model.session import Session
from rsb_bridge.model.transports import Protocol
from rsb_extras.bench.benchmark import Bench, BenchmarkStep
from rsb_extras.bench.suite import ways_of

__all__ = ["reachable"]

REQUEST = CommandRequest(1, Bench(BenchmarkStep(link="robot1", size=100)))


@pytest.mark.parametrize("at_once", [1, 7, 1000])
def test_an_order_comes_through_whole(at_once: int) -> None:
    assert fed(encode(REQUEST), to_bridge=True, at_once=at_once) == [REQUEST]


@pytest.mark.parametrize("read_only", [True, False])
def test_who_may_look_only_measures_nothing(reachable: Reachable, read_only: bool) -> None:
    with Stranger(reachable.port, "bob", BOB) as bob:
        bob.attach(read_only=read_only)
        bob.say(REQUEST)
        assert isinstance(bob.answer(), CommandFailed)
    assert reachable.engine.commands == []


@pytest.mark.parametrize("name", get_args(Protocol))
def test_each_transport_can_be_measured(name: str) -> None:
    assert msgspec.convert({"transport": name}, BenchmarkStep).transport == name


@pytest.mark.parametrize(
    ("server_ip", "transports"), [("10.0.0.1", ["tcp", "udp"]), ("5C:F3:70:9A:1B:2E", ["bluetooth"])]
)
def test_a_links_own_transports_are_measured_by_default(server_ip: str, transports: list[str]) -> None:
    session = Session(name="robot1", role="client", server_ip=server_ip)
    assert [way.transport for way in ways_of(session, (), ("transmit",))] == transports
