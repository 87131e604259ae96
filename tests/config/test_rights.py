"""The effect of `allow` and `deny`, on a server and on a client."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.wording import says

from rsb_bridge.config.rights import (
    DeniedRemedy,
    DeniedText,
    GrantError,
    Place,
    Rights,
    Use,
    rights_of_client,
    rights_of_server,
    typed_grants,
)
from rsb_bridge.config.session_file import SessionError, dump, parse
from rsb_bridge.config.validation import validate
from rsb_bridge.model.benchmark import BenchmarkLimits
from rsb_bridge.model.purposes import BENCH, VIEW
from rsb_bridge.model.session import Client, Grant, Session, Topic

if TYPE_CHECKING:
    from rsb_bridge.model.wording import Wording

CLIENT: dict[str, Any] = {
    "name": "robot1", "role": "client", "server_ip": "10.0.0.1", "server_port": 7060, "key_file": "k"
}  # fmt: skip
ON_CLIENT = Place.ON_CLIENT(client="robot1")
DRIVE = Grant("/cmd_vel", may="publish", protocol="udp", max_rate=10.0)


def client_allows(use: Use, **session: Any) -> bool:
    return rights_of_server(Session(**{**CLIENT, **session})).refusal(use) is None


def server_allows(use: Use, **client: Any) -> bool:
    return rights_of_client(Client("robot1", **client), "pc").refusal(use) is None


@pytest.mark.parametrize(
    ("session", "use", "may"),
    [
        ({}, Use("/anything", "read", "tcp"), True),
        ({}, Use("/cmd_vel", "publish", "tcp"), False),
        ({"topics": (Topic("/cmd_vel", "receive"),)}, Use("/cmd_vel", "publish", "tcp"), True),
        ({"topics": (Topic("/cmd_vel", "transmit"),)}, Use("/cmd_vel", "publish", "tcp"), False),
        ({"topics": (Topic("/cmd_vel", "receive"),), "deny": ("/cmd_vel",)}, Use("/cmd_vel", "publish", "tcp"), False),
        ({"topics": (Topic("/goal", "receive"),), "allow": (DRIVE,)}, Use("/goal", "publish", "tcp"), True),
        ({"allow": (DRIVE,)}, Use("/cmd_vel", "publish", "udp"), True),
        ({"allow": (DRIVE,)}, Use("/cmd_vel", "publish", "tcp"), False),
        ({"allow": (DRIVE,)}, Use("/cmd_vel", "read", "udp"), False),
        ({"allow": (DRIVE,)}, Use("/scan", "read", "udp"), False),
        ({"allow": (DRIVE, "/*")}, Use("/cmd_vel", "publish", "tcp"), False),
        ({"allow": (DRIVE, "/*")}, Use("/cmd_vel", "read", "tcp"), True),
        ({"deny": (Grant("/camera/*", may="read"),)}, Use("/camera/raw", "read", "tcp"), False),
        ({"deny": (Grant("/*", protocol="bluetooth"),)}, Use("/camera/raw", "read", "tcp"), True),
    ],
)
def test_what_a_server_may_do_on_a_client(session: dict[str, Any], use: Use, may: bool) -> None:
    assert client_allows(use, **session) is may


@pytest.mark.parametrize(
    ("client", "use", "may"),
    [
        ({}, Use("/anything", "publish", "tcp"), True),
        ({"allow": ("/scan",)}, Use("/scan", "publish", "tcp"), True),
        ({"allow": ("/scan",)}, Use("/robot1/scan", "read", "tcp"), True),
        ({"allow": ("/scan",)}, Use("/robot2/scan", "read", "tcp"), False),
        ({"allow": ("/*",), "deny": (Grant("/clock", may="publish"),)}, Use("/clock", "publish", "tcp"), False),
        ({"allow": ("/*",), "deny": (Grant("/clock", may="publish"),)}, Use("/clock", "read", "tcp"), True),
        ({"allow": (Grant("/scan", protocol=("tcp", "udp")),)}, Use("/scan", "read", "bluetooth"), False),
        ({"allow": (Grant("/scan", protocol=("tcp", "udp")),)}, Use("/scan", "read", "udp"), True),
    ],
)
def test_what_a_client_may_do_on_a_server(client: dict[str, Any], use: Use, may: bool) -> None:
    assert server_allows(use, **client) is may


def test_of_several_rates_the_lowest_counts() -> None:
    grants = ("/*", Grant("/cmd_*", max_rate=20.0), Grant("/cmd_vel", may="publish", max_rate=10.0))
    rights = rights_of_server(Session(**CLIENT, allow=grants))
    assert rights.max_rate(Use("/cmd_vel", "publish", "tcp")) == 10.0
    assert rights.max_rate(Use("/cmd_vel", "read", "tcp")) == 20.0
    assert rights.max_rate(Use("/scan", "read", "tcp")) == 0.0


def test_a_peer_is_shown_what_it_may_read_or_publish() -> None:
    rights = rights_of_server(Session(**CLIENT, allow=(DRIVE,), deny=("/secret",)))
    assert rights.shows("/cmd_vel")
    assert not rights.shows("/scan")
    assert not rights_of_server(Session(**CLIENT, deny=("/secret",))).shows("/secret")


@pytest.mark.parametrize(
    ("rights", "use", "reason", "remedy", "parameters"),
    [
        (
            rights_of_server(Session(**CLIENT)),
            Use("/cmd_vel", "publish"),
            DeniedText.NOT_ALLOWED,
            DeniedRemedy.LIST,
            {"list": "topics", "place": ON_CLIENT, "direction": "direction: receive"},
        ),
        (
            rights_of_server(Session(**CLIENT, allow=("/a",))),
            Use("/cmd_vel", "publish"),
            DeniedText.NOT_ALLOWED,
            DeniedRemedy.LIST_OR_ALLOW,
            {"list": "topics", "place": ON_CLIENT, "entry": "{topics: /cmd_vel, may: publish}"},
        ),
        (
            rights_of_client(Client("robot1", allow=("/a",)), "pc"),
            Use("/b", "read"),
            DeniedText.NOT_ALLOWED,
            DeniedRemedy.ADD_ALLOW,
            {"entry": "{topics: /b, may: read}", "place": Place.ON_SERVER(client="robot1", server="pc")},
        ),
        (
            rights_of_server(Session(**CLIENT, deny=("/cmd*",))),
            Use("/cmd_vel", "publish"),
            DeniedText.DENIED,
            DeniedRemedy.CHANGE_DENY,
            {"place": ON_CLIENT, "entry": "/cmd*"},
        ),
        (
            rights_of_server(Session(**CLIENT, allow=(DRIVE,))),
            Use("/cmd_vel", "publish", "tcp"),
            DeniedText.OTHER_PROTOCOL,
            DeniedRemedy.CHANGE_ALLOW,
            {"place": ON_CLIENT},
        ),
    ],
)
def test_a_refusal_names_the_use_and_the_remedy(
    rights: Rights, use: Use, reason: Wording, remedy: Wording, parameters: dict[str, str]
) -> None:
    refusal = rights.refusal(use)
    assert refusal is not None
    assert says(refusal.reason, reason, peer=rights.peer, use=use)
    assert says(refusal.remedy, remedy, **parameters)


def test_grants_are_read_and_written() -> None:
    text = (
        "name: robot1\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 7060\nkey_file: k\n"
        "allow: [/camera/*, {topics: /cmd_vel, may: publish, protocol: udp, max_rate: 10}]\n"
        "deny:\n  - topics: /tf\n    may: read\n    protocol: [tcp, udp]\n"
    )
    session = parse(text, Path("robot1.yaml"))
    assert session.allow == ("/camera/*", DRIVE)
    assert session.deny == (Grant("/tf", may="read", protocol=("tcp", "udp")),)
    assert parse(dump(session), Path("again.yaml")) == session


@pytest.mark.parametrize(
    ("entry", "location"),
    [
        ("allow: [cmd_vel]", "allow[0]"),
        ("allow: [{topics: cmd_vel}]", "allow[0].topics"),
        ("allow: [{may: publish}]", "allow[0].topics"),
        ("allow: [{topics: /a, may: write}]", "allow[0].may"),
        ("allow: [{topics: /a, protocol: tpc}]", "allow[0].protocol"),
        ("allow: [{topics: /a, protocol: []}]", "allow[0].protocol"),
        ("allow: [{topics: /a, max_rate: 0}]", "allow[0].max_rate"),
        ("allow: [{topics: /a, rate: 1}]", "allow[0].rate"),
        ("allow: [3]", "allow[0]"),
        ("deny: [/cmd_vel/]", "deny[0]"),
        ("deny: [{topics: //cmd_vel}]", "deny[0].topics"),
        ("deny: [{topics: /a, max_rate: 5}]", "deny[0].max_rate"),
    ],
)
def test_a_mistake_has_its_place_and_line(entry: str, location: str) -> None:
    text = f"name: r\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 7060\nkey_file: k\n{entry}\n"
    with pytest.raises(SessionError) as raised:
        parse(text, Path("robot1.yaml"))
    assert {(problem.location, problem.line) for problem in raised.value.problems} == {(location, 6)}


def test_a_server_grants_under_its_clients() -> None:
    session = Session(name="pc", role="server", server_ip="0.0.0.0", server_port=7060, key_file="k", deny=("/tf",))
    assert [problem.location for problem in validate(session)] == ["deny"]


def test_what_is_typed_in_one_line() -> None:
    typed = "/camera/*, {topics: /cmd_vel, may: publish, protocol: udp, max_rate: 10} /tf"
    assert typed_grants(typed) == ("/camera/*", DRIVE, "/tf")
    assert typed_grants("") == ()
    for wrong in ("{topics: /a, may: write}", "{topics: /a", "{topics: *}"):
        with pytest.raises(GrantError):
            typed_grants(wrong)


@pytest.mark.parametrize(
    ("rights", "remedy"),
    [
        ({}, None),
        ({"allow": ("/scan",)}, None),
        ({"allow": (Grant("/scan", may="read"),)}, None),
        ({"allow": (Grant("/scan", may="publish"),)}, DeniedRemedy.ADD_LOOK),
        ({"allow": (Grant(services="/*"),)}, DeniedRemedy.ADD_LOOK),
        ({"deny": ("/scan", Grant("/*", may="publish"), Grant("*", protocol="udp"))}, None),
        ({"deny": ("/**",)}, DeniedRemedy.NARROW_DENY),
        ({"deny": (Grant("*", may="look"),), "allow": ("/scan",)}, DeniedRemedy.NARROW_DENY),
    ],
)
def test_a_view_needs_the_right_to_look_at_something(rights: dict[str, Any], remedy: Wording | None) -> None:
    refusal = rights_of_client(Client("robot1", **rights), "pc").purpose_refusal(VIEW, sends=False)
    if remedy is None:
        assert refusal is None
    else:
        assert refusal is not None
        assert says(refusal.remedy, remedy)
        assert "look" in str(refusal)


def test_nobody_sends_pictures_unasked() -> None:
    refusal = rights_of_client(Client("robot1", bench=BenchmarkLimits()), "pc").purpose_refusal(VIEW, sends=True)
    assert refusal is not None
    assert says(refusal.reason, DeniedText.NO_SENDING, right="look", peer="robot1")


def test_a_benchmark_without_permission_has_its_own_remedy() -> None:
    refusal = rights_of_client(Client("robot1"), "pc").purpose_refusal(BENCH, sends=True)
    assert refusal is not None
    assert says(refusal.remedy, DeniedRemedy.ADD_BENCH)
