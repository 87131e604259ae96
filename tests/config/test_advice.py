"""What `check` warns of, since running the session would warn of it or refuse it."""

import socket
from typing import Any

import pytest

from rsb_bridge.config.advice import advise
from rsb_bridge.config.validation import validate
from rsb_bridge.model.limits import KEPT_DEPTH, LATCHED_DEPTH, PORTS_PER_CLIENT, ROUTES_PER_LINK
from rsb_bridge.model.session import Client, Session, Topic

CLIENT: dict[str, Any] = {"name": "a", "role": "client", "server_ip": "10.0.0.1", "server_port": 49152, "key_file": "k"}
SERVER: dict[str, Any] = {**CLIENT, "role": "server"}
MAC = "5C:F3:70:9A:1B:2E"


def topics(*some: Topic, **session: Any) -> dict[str, Any]:
    return {**CLIENT, "topics": some, **session}


def many(count: int, port: int | None = None) -> list[Topic]:
    return [Topic(f"/t{at}", "transmit", port=port and port + at) for at in range(count)]


@pytest.mark.parametrize(
    ("session", "variable", "location", "message"),
    [
        ({**CLIENT, "use_encryption": False}, None, "use_encryption", "everything crosses in the clear"),
        ({**CLIENT, "check_messages": False}, None, "check_messages", ""),
        ({**CLIENT, "domain_id": 150}, None, "domain_id", "150 can collide with other programs' ports"),
        (CLIENT, "150", "domain_id", "domain 150 can collide"),
        (CLIENT, "300", "domain_id", "ROS_DOMAIN_ID is '300'"),
        ({**SERVER, "server_port": 80}, None, "server_port", "ports below 1024 need root"),
        ({**SERVER, "server_port": 7649, "domain_id": 0}, None, "server_port", "ROS domain 0 (7400 to 7649)"),
        ({**SERVER, "ports": (12001, 7650)}, "1", "ports[1]", "7650 belongs to ROS domain 1 (7650 to 7899)"),
        ({**SERVER, "server_port": 9900, "domain_id": 0}, None, "server_port", "domain 10"),
        (topics(Topic("/a", "transmit", port=7660)), None, "topics[0].port", "domain 1's"),
        ({**CLIENT, "metrics": "0.0.0.0:9464"}, None, "metrics", "no password protects them"),
        (topics(Topic("/shutdown", "transmit")), None, "topics[0]", "it closes the bridge, too"),
        (topics(Topic("/a", "transmit", port=80)), None, "topics[0].port", "refuses ports below 1024"),
        (
            {**SERVER, "clients": (Client("r", deny=("/cmd*",), topics=(Topic("/cmd_vel", "receive"),)),)},
            None, "clients[0].topics[0]", "the server denies /cmd_vel to r (allow and deny), but it crosses",
        ),
        (topics(*many(ROUTES_PER_LINK + 1)), None, "topics", f"a server takes {ROUTES_PER_LINK} topics"),
        (topics(*many(PORTS_PER_CLIENT + 1, 5000)), None, "topics", f"a server binds {PORTS_PER_CLIENT} for a client"),
        (
            topics(Topic("/a", "transmit", qos={"profile": "latched", "depth": LATCHED_DEPTH + 1})),
            None, "topics[0].qos", f"the receiving side keeps {LATCHED_DEPTH} messages for late joiners",
        ),
        (
            topics(Topic("/a", "transmit", qos=KEPT_DEPTH + 1)),
            None, "topics[0].qos", f"keeps {KEPT_DEPTH} messages in its publisher",
        ),
    ],
)  # fmt: skip
def test_it_is_said_with_its_location(
    session: dict[str, Any], variable: str | None, location: str, message: str
) -> None:
    assert validate(Session(**session)) == [], "it is no mistake"
    (problem,) = advise(Session(**session), variable)
    assert problem.location == location
    assert message in problem.message


@pytest.mark.parametrize(
    "session",
    [
        CLIENT,
        {**SERVER, "server_port": 1024},
        topics(*many(ROUTES_PER_LINK)),
        topics(*many(PORTS_PER_CLIENT, 5000)),
        topics(Topic("/a", "transmit", qos={"profile": "latched", "depth": LATCHED_DEPTH})),
        topics(Topic("/a", "transmit", qos={"history": "keep_all", "depth": 20_000})),
    ],
)
def test_what_is_right_needs_no_advice(session: dict[str, Any]) -> None:
    assert list(advise(Session(**session), "7")) == []


@pytest.mark.parametrize("changes", [{"server_ip": MAC, "server_port": 3}, {"bluetooth_address": MAC}])
def test_a_python_without_bluetooth_is_named(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "AF_BLUETOOTH", 31, raising=False)
    session = Session(**{**CLIENT, **changes, "topics": (Topic("/a", "receive", protocol="bluetooth", port=4),)})
    assert list(advise(session, None)) == []
    monkeypatch.delattr(socket, "AF_BLUETOOTH")
    (problem,) = advise(session, None)
    assert "this Python has no Bluetooth sockets" in problem.message
