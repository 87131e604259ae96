"""Warnings of `check`, where running the session would warn or refuse."""

import socket
from pathlib import Path
from typing import Any

import pytest
from tests.support import replaced, surroundings
from tests.support.wording import says

from rsb_bridge.config.advice import Advice, advise
from rsb_bridge.config.validation import SessionMistake, validate
from rsb_bridge.model.limits import KEPT_DEPTH, LATCHED_DEPTH, PORTS_PER_CLIENT, ROUTES_PER_LINK
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.wording import Wording

CLIENT: dict[str, Any] = {"name": "a", "role": "client", "server_ip": "10.0.0.1", "server_port": 49152, "key_file": "k"}
SERVER: dict[str, Any] = {**CLIENT, "role": "server"}
LATCHED = {"profile": "latched", "depth": LATCHED_DEPTH + 1}
INTERFACES = ", ".join(name for _, name in socket.if_nameindex())
NO_ZONE = f"fe80::1%{1 + max(index for index, _ in socket.if_nameindex())}"
MAC = "5C:F3:70:9A:1B:2E"


def topics(*some: Topic, **session: Any) -> dict[str, Any]:
    return {**CLIENT, "topics": some, **session}


def one(**fields: Any) -> dict[str, Any]:
    return topics(Topic("/a", "transmit", **fields))


def beat(*rates: float) -> dict[str, Any]:
    return topics(*(Topic(f"/t{at}", "transmit", max_rate=rate, beat="front") for at, rate in enumerate(rates)))


def many(count: int, port: int | None = None) -> list[Topic]:
    return [Topic(f"/t{at}", "transmit", port=port and port + at) for at in range(count)]


@pytest.mark.parametrize(
    ("session", "variable", "location", "code", "parameters"),
    [
        ({**CLIENT, "use_encryption": False}, None, "use_encryption", Advice.NO_ENCRYPTION, {}),
        ({**CLIENT, "check_messages": False}, None, "check_messages", Advice.NO_CHECKS, {}),
        ({**CLIENT, "domain_id": 150}, None, "domain_id", Advice.DOMAIN_COLLIDES, {"domain": 150}),
        (CLIENT, "150", "domain_id", Advice.DOMAIN_COLLIDES, {"domain": 150}),
        (CLIENT, "300", "domain_id", SessionMistake.DOMAIN_VARIABLE_INVALID, {"value": "'300'"}),
        ({**SERVER, "server_port": 80}, None, "server_port", Advice.LOW_PORT, {"limit": 1024}),
        ({**SERVER, "server_port": 7649, "domain_id": 0}, None, "server_port", Advice.PORT_OF_DOMAIN, {"domain": 0}),
        ({**SERVER, "ports": (12001, 7650)}, "1", "ports[1]", Advice.PORT_OF_DOMAIN, {"ports": "7650 to 7899"}),
        ({**SERVER, "server_port": 9900}, "0", "server_port", Advice.PORT_OF_DISCOVERY, {"domain": 10}),
        (one(port=7660), None, "topics[0].port", Advice.TOPIC_PORT_OF_DISCOVERY, {"domain": 1}),
        ({**CLIENT, "server_ip": "fe80::1%nope"}, None, "server_ip", Advice.NO_INTERFACE, {"zone": "nope"}),
        ({**SERVER, "server_ip": NO_ZONE}, None, "server_ip", Advice.NO_INTERFACE, {"interfaces": INTERFACES}),
        (topics(Topic("/shutdown", "transmit")), None, "topics[0]", Advice.SHUTDOWN_TOPIC, {}),
        (one(port=80), None, "topics[0].port", Advice.TOPIC_PORT_LOW, {"limit": 1024}),
        (topics(*many(ROUTES_PER_LINK + 1)), None, "topics", Advice.TOO_MANY_TOPICS, {"limit": ROUTES_PER_LINK}),
        (topics(*many(PORTS_PER_CLIENT + 1, 5000)), None, "topics", Advice.TOO_MANY_PORTS, {"limit": PORTS_PER_CLIENT}),
        (one(qos=LATCHED), None, "topics[0].qos", Advice.DEPTH_OF_LATCHED, {"limit": LATCHED_DEPTH}),
        (one(qos=KEPT_DEPTH + 1), None, "topics[0].qos", Advice.DEPTH, {"limit": KEPT_DEPTH}),
        (one(lazy=True, qos="latched"), None, "topics[0].lazy", Advice.NEVER_RESTS, {"why": "is latched"}),
        (one(lazy=True, keep=5.0), None, "topics[0].lazy", Advice.NEVER_RESTS, {"why": "keeps its messages"}),
        (one(lazy=True, arm=True), None, "topics[0].lazy", Advice.NEVER_RESTS, {"why": "has to be armed"}),
        (beat(10.0, 5.0), None, "topics[1].max_rate", Advice.BEAT_RATES, {"other": "/t0"}),
    ],
)
def test_advice_has_its_location(
    session: dict[str, Any], variable: str | None, location: str, code: Wording, parameters: dict[str, Any]
) -> None:
    assert validate(Session(**session)) == [], "it is no mistake"
    (problem,) = advise(Session(**session), variable)
    assert problem.location == location
    assert says(problem.message, code, **parameters)


@pytest.mark.parametrize(
    "session",
    [
        CLIENT,
        {**SERVER, "server_port": 1024},
        {**CLIENT, "server_ip": "fe80::1%lo"},
        {**CLIENT, "server_ip": "fe80::1%1"},
        topics(*many(ROUTES_PER_LINK)),
        topics(*many(PORTS_PER_CLIENT, 5000)),
        one(qos={"profile": "latched", "depth": LATCHED_DEPTH}),
        one(qos={"history": "keep_all", "depth": 20_000}),
        one(lazy=True),
        beat(10.0, 10.0),
    ],
)
def test_what_is_right_needs_no_advice(session: dict[str, Any]) -> None:
    assert list(advise(Session(**session), "7")) == []


@pytest.mark.parametrize("changes", [{"server_ip": MAC, "server_port": 3}, {"bluetooth_address": MAC}])
def test_a_python_without_bluetooth_is_named(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    surroundings.offer_bluetooth(monkeypatch)
    session = Session(**{**CLIENT, **changes, "topics": (Topic("/a", "receive", protocol="bluetooth", port=4),)})
    assert list(advise(session, None)) == []
    monkeypatch.delattr(socket, "AF_BLUETOOTH")
    (problem,) = advise(session, None)
    assert says(problem.message, Advice.NO_BLUETOOTH)


def test_another_middleware() -> None:
    session = Session(name="robot1", role="server", server_ip="127.0.0.1", server_port=7060, domain_id=1)
    assert list(advise(session, None, "rmw_fastrtps_cpp")) == list(advise(session, None))
    (problem,) = set(map(str, advise(session, None, "rmw_zenoh_cpp"))) - set(map(str, advise(session, None)))
    assert "rmw_zenoh_cpp" in problem


@pytest.mark.parametrize("port", [1999, 2000])
def test_machine_that_reserves_more_ports(port: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (first := tmp_path / "first").write_text("2000\n")
    replaced.UNPRIVILEGED_PORTS.set(monkeypatch, first)
    found = [str(each) for each in advise(Session(**{**SERVER, "server_port": port}), None)]
    assert [Advice.LOW_PORT(limit=2000) in each for each in found] == [True] * (port < 2000)
