"""The effect of `allow` and `deny` on topics and on what is called, on a server and on a client."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.config.mistakes import has, problems
from tests.support.wording import says

from rsb_bridge.config.advice import Advice, advise
from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.grants import GrantError, RightsMistake, typed_grants
from rsb_bridge.config.rights import DeniedRemedy, DeniedText, Place, Rights, Use, rights_of_client, rights_of_server
from rsb_bridge.config.rights_listing import EVERY_CALL, listings
from rsb_bridge.config.session_file import dump, parse
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.config.validation import validate
from rsb_bridge.link.proposals import use_of
from rsb_bridge.model.session import Client, Grant, Session, Topic
from rsb_bridge.wire.messages import Propose

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.wording import Wording

CLIENT: dict[str, Any] = {
    "name": "robot1", "role": "client", "server_ip": "10.0.0.1", "server_port": 7060, "key_file": "k"
}  # fmt: skip
SERVER: dict[str, Any] = CLIENT | {"name": "pc", "role": "server"}
HEAD = "name: robot1\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 7060\nkey_file: k\n"
ON_CLIENT, ON_SERVER = Place.ON_CLIENT(client="robot1"), Place.ON_SERVER(client="robot1", server="pc")
DRIVE = Grant("/cmd_vel", may="publish", protocol="udp", max_rate=10.0)
CALL_ENTRY = "{services: /dock, may: call}"
CALL, SERVE = Grant(services="/dock", may="call"), Grant(services="/dock", may="serve")
DOCK = Topic("/dock", "receive", kind="service")  # the robot's own node docks it
MAP = Topic("/get_map", "transmit", kind="service")
NAVIGATE = Topic("/navigate", "receive", kind="action")


def call(name: str, kind: Any = "service", protocol: str = "tcp") -> Use:
    return Use(name, "call", protocol, kind)


def serve(name: str, kind: Any = "service", protocol: str = "tcp") -> Use:
    return Use(name, "serve", protocol, kind)


def on_client(**session: Any) -> Rights:
    """The rights of the server on a client."""
    return rights_of_server(Session(**CLIENT, **session))


def on_server(**client: Any) -> Rights:
    """The rights of a client on the server."""
    return rights_of_client(Client("robot1", **client), "pc")


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
        ({}, call("/dock"), False),
        ({}, serve("/dock"), False),
        ({"topics": (DOCK,)}, call("/dock"), True),
        ({"topics": (DOCK,)}, serve("/dock"), False),
        ({"topics": (DOCK,)}, call("/dock", "action"), False),
        ({"topics": (DOCK,)}, Use("/dock", "publish", "tcp"), False),
        ({"topics": (MAP,)}, serve("/get_map"), True),
        ({"topics": (MAP,)}, call("/get_map"), False),
        ({"topics": (DOCK,), "deny": ("/dock",)}, call("/dock"), False),
        ({"topics": (DOCK,), "allow": ("/*",)}, call("/dock"), True),
        ({"allow": ("/*",)}, call("/dock"), False),
        ({"allow": (CALL,)}, call("/dock"), True),
        ({"allow": (CALL,)}, serve("/dock"), False),
    ],
)
def test_what_a_server_may_do_on_a_client(session: dict[str, Any], use: Use, may: bool) -> None:
    assert (on_client(**session).refusal(use) is None) is may


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
        ({}, call("/dock"), True),
        ({}, serve("/dock"), True),
        ({"allow": ("/*",)}, call("/dock"), False),
        ({"allow": ("/*",)}, serve("/dock"), False),
        ({"allow": ("/*", CALL)}, call("/dock"), True),
        ({"allow": ("/*", CALL)}, serve("/dock"), False),
        ({"allow": ("/*", CALL)}, call("/undock"), False),
        ({"allow": (CALL,)}, Use("/dock", "read", "tcp"), False),
        ({"allow": (CALL,)}, call("/robot1/dock"), True),
        ({"allow": (Grant(services="/nav/*"),)}, call("/nav/to_pose", "action"), True),
        ({"allow": (Grant(services="/n"),)}, call("/n", "parameters"), True),
        ({"allow": (Grant(services="/n"),)}, call("/n/set_parameters"), False),
        ({"allow": (Grant(services="/n/get_parameters"),)}, call("/n", "parameters"), False),
        ({"allow": (Grant(services="/dock", protocol="tcp"),)}, call("/dock", protocol="bluetooth"), False),
        ({"deny": ("/dock",)}, call("/dock"), False),
        ({"deny": ("/dock",)}, Use("/dock", "read", "tcp"), False),
        ({"deny": (Grant("/dock"),)}, call("/dock"), True),
        ({"deny": (SERVE,)}, call("/dock"), True),
        ({"deny": (SERVE,)}, Use("/dock", "read", "tcp"), True),
        ({"deny": (Grant(services="/dock", protocol="bluetooth"),)}, call("/dock"), True),
    ],
)
def test_what_a_client_may_do_on_a_server(client: dict[str, Any], use: Use, may: bool) -> None:
    assert (on_server(**client).refusal(use) is None) is may


def test_of_several_rates_the_lowest_counts() -> None:
    grants = ("/*", Grant("/cmd_*", max_rate=20.0), Grant("/cmd_vel", may="publish", max_rate=10.0))
    rights = on_client(allow=grants)
    assert rights.max_rate(Use("/cmd_vel", "publish", "tcp")) == 10.0
    assert rights.max_rate(Use("/cmd_vel", "read", "tcp")) == 20.0
    assert rights.max_rate(Use("/scan", "read", "tcp")) == 0.0


def test_peer_is_shown_what_it_may_use() -> None:
    rights = on_client(allow=(DRIVE,), deny=("/secret",))
    assert rights.shows("/cmd_vel")
    assert not rights.shows("/scan")
    assert not on_client(deny=("/secret",)).shows("/secret")


REASONS = {DeniedRemedy.CHANGE_DENY: DeniedText.DENIED, DeniedRemedy.CHANGE_ALLOW: DeniedText.OTHER_PROTOCOL}
"""The reasons of remedies, except where something is not allowed."""


@pytest.mark.parametrize(
    ("make", "given", "use", "remedy", "parameters"),
    [
        (on_client, {}, Use("/cmd_vel", "publish"), DeniedRemedy.LIST, {"direction": "direction: receive"}),
        (on_client, {}, call("/navigate", "action"), DeniedRemedy.LIST, {"direction": "provider: client"}),
        (on_client, {"allow": ("/a",)}, Use("/cmd_vel", "publish"), DeniedRemedy.LIST_OR_ALLOW,
         {"direction": "direction: receive", "entry": "{topics: /cmd_vel, may: publish}"}),
        (on_client, {"allow": ("/a",)}, serve("/n", "parameters"), DeniedRemedy.LIST_OR_ALLOW,
         {"direction": "provider: server", "entry": "{services: /n, may: serve}"}),
        (on_client, {"deny": ("/cmd*",)}, Use("/cmd_vel", "publish"), DeniedRemedy.CHANGE_DENY, {"entry": "/cmd*"}),
        (on_client, {"allow": (DRIVE,)}, Use("/cmd_vel", "publish", "tcp"), DeniedRemedy.CHANGE_ALLOW, {}),
        (on_server, {"allow": ("/a",)}, Use("/b", "read"), DeniedRemedy.ADD_ALLOW,
         {"entry": "{topics: /b, may: read}"}),
        (on_server, {"allow": ("/dock",)}, call("/dock"), DeniedRemedy.ADD_ALLOW, {"entry": CALL_ENTRY}),
        (on_server, {"deny": ("/d*",)}, call("/dock"), DeniedRemedy.CHANGE_DENY, {"entry": "/d*"}),
        (on_server, {"deny": (CALL,)}, call("/dock"), DeniedRemedy.CHANGE_DENY, {"entry": CALL_ENTRY}),
    ],
)  # fmt: skip
def test_a_refusal_names_the_use_and_the_remedy(
    make: Callable[..., Rights], given: dict[str, Any], use: Use, remedy: DeniedRemedy, parameters: dict[str, str]
) -> None:
    rights = make(**given)
    refusal = rights.refusal(use)
    assert refusal is not None
    assert says(refusal.reason, REASONS.get(remedy, DeniedText.NOT_ALLOWED), peer=rights.peer, use=use)
    if remedy in (DeniedRemedy.LIST, DeniedRemedy.LIST_OR_ALLOW):
        parameters = {"list": {"topic": "topics", "action": "actions"}.get(use.kind, use.kind), **parameters}
    assert says(refusal.remedy, remedy, place=ON_CLIENT if make is on_client else ON_SERVER, **parameters)


def test_grants_are_read_and_written() -> None:
    text = (
        f"{HEAD}allow: [/camera/*, {{topics: /cmd_vel, may: publish, protocol: udp, max_rate: 10}},"
        " {services: /dock, may: call, max_rate: 10.0}]\n"
        "deny:\n  - topics: /tf\n    may: read\n    protocol: [tcp, udp]\n  - services: /tf2/*\n"
    )
    session = parse(text, Path("robot1.yaml"))
    dock = Grant(services="/dock", may="call", max_rate=10.0)
    assert session.allow == ("/camera/*", DRIVE, dock)
    assert session.deny == (Grant("/tf", may="read", protocol=("tcp", "udp")), Grant(services="/tf2/*"))
    assert "{services: /dock, may: call, max_rate: 10}" in dump(session)
    assert typed_grants("{services: /dock, may: call, max_rate: 10}") == (dock,)
    assert parse(dump(session), Path("again.yaml")) == session


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
        ({"deny": ("/*/*",)}, None),
        ({"deny": ("/**",)}, DeniedRemedy.NARROW_DENY),
        ({"deny": (Grant("*", may="look"),), "allow": ("/scan",)}, DeniedRemedy.NARROW_DENY),
    ],
)
def test_view_needs_right_to_look_at_something(rights: dict[str, Any], remedy: Wording | None) -> None:
    refusal = on_server(**rights).no_look()
    if remedy is None:
        assert refusal is None
    else:
        assert refusal is not None
        assert says(refusal.remedy, remedy)
        assert "look" in str(refusal)


@pytest.mark.parametrize(
    ("denied", "use"),
    [
        ("/n/set_parameters", call("/n", "parameters")),
        ("*/set_parameters*", call("/n", "parameters")),
        ("/n", call("/n/set_parameters_atomically")),
        ("/navigate/_action/send_goal", call("/navigate", "action")),
    ],
)
def test_denied_part_is_denied_by_whole(denied: str, use: Use) -> None:
    for rights in (
        on_server(deny=(denied,)),
        rights_of_server(
            Session(**CLIENT, deny=(Grant(services=denied),), topics=(Topic(use.topic, "receive", kind=use.kind),))
        ),
    ):
        refusal = rights.refusal(use)
        assert refusal is not None
        assert denied in refusal.remedy


def test_calls_have_a_rate_of_their_own() -> None:
    rights = rights_of_client(
        Client("robot1", allow=("/*", Grant("/dock", max_rate=1.0), Grant(services="/dock", max_rate=5.0))), "pc"
    )
    assert rights.max_rate(call("/dock")) == 5.0
    assert rights.max_rate(Use("/dock", "publish")) == 1.0


def test_useless_names_are_not_shown() -> None:
    rights = on_client(topics=(DOCK, NAVIGATE), deny=("/navigate",))
    assert rights.shows("/dock", "service")
    assert not rights.shows("/dock", "action")
    assert not rights.shows("/navigate", "action")
    assert not rights.shows("/other", "service")
    assert rights.shows("/other")


@pytest.mark.parametrize(
    ("from_client", "is_client", "use"),
    [
        (True, False, Use("/far", "call", "tcp", "service")),
        (False, True, Use("/far", "call", "tcp", "service")),
        (True, True, Use("/near", "serve", "tcp", "service")),
        (False, False, Use("/near", "serve", "tcp", "service")),
    ],
)
def test_whose_nodes_call_decides_what_proposal_asks_for(from_client: bool, is_client: bool, use: Use) -> None:
    """`Propose.topic` is the name on the callers' side."""
    proposal = Propose(
        route=1, topic="/near", remote_topic="/far", from_client=from_client, transport="tcp", kind="service", type="",
        compression="none", qos=None, port=0, max_rate=0.0, expected_rate=0.0, stale_after=None,
    )  # fmt: skip
    assert use_of(proposal, is_client=is_client) == use


@pytest.mark.parametrize(
    ("entry", "location", "code", "parameters"),
    [
        ("allow: [cmd_vel]", "allow[0]", RightsMistake.NO_MATCH, {"noun": "topic"}),
        ("allow: [{topics: cmd_vel}]", "allow[0].topics", RightsMistake.NO_MATCH, {}),
        ("allow: [{topics: /a, may: write}]", "allow[0].may", ValueMistake.MISFIT, {}),
        ("allow: [{topics: /a, protocol: tpc}]", "allow[0].protocol", ValueMistake.MISFIT, {}),
        ("allow: [{topics: /a, protocol: []}]", "allow[0].protocol", RightsMistake.NO_PROTOCOLS, {}),
        ("allow: [{topics: /a, max_rate: 0}]", "allow[0].max_rate", TopicMistake.OUT_OF_RANGE, {"value": 0.0}),
        ("allow: [{topics: /a, rate: 1}]", "allow[0].rate", ValueMistake.MISSPELT_KEY, {}),
        ("allow: [3]", "allow[0]", ValueMistake.MISFIT, {}),
        ("deny: [/cmd_vel/]", "deny[0]", RightsMistake.SLASHES, {}),
        ("deny: [{topics: //cmd_vel}]", "deny[0].topics", RightsMistake.SLASHES, {}),
        ("allow: [{services: dock}]", "allow[0].services", RightsMistake.NO_MATCH, {"noun": "service"}),
        ("allow: [{services: /dock/}]", "allow[0].services", RightsMistake.SLASHES, {"noun": "service"}),
        ("allow: [{services: /a, topics: /a}]", "allow[0].services", RightsMistake.BOTH, {}),
        ("allow: [{may: call}]", "allow[0].topics", RightsMistake.NO_PATTERN, {}),
        ("allow: [{services: /a, may: read}]", "allow[0].may", RightsMistake.OTHER_USE, {"uses": "call or serve"}),
        ("allow: [{topics: /a, may: serve}]", "allow[0].may", RightsMistake.OTHER_USE, {}),
        ("allow: [{services: /a, protocol: udp}]", "allow[0].protocol", RightsMistake.UNRELIABLE, {"protocol": "udp"}),
        ("allow: [{services: /a, protocol: [tcp, udp]}]", "allow[0].protocol", RightsMistake.UNRELIABLE, {}),
        ("deny: [{services: /a, max_rate: 5}]", "deny[0].max_rate", RightsMistake.RATE_OF_DENIED, {}),
        ("allow: [{service: /a}]", "allow[0].service", ValueMistake.MISSPELT_KEY, {}),
    ],
)
def test_a_mistake_has_its_place_and_words(
    entry: str, location: str, code: Wording, parameters: dict[str, Any]
) -> None:
    problem = problems(f"{HEAD}{entry}\n")[0]
    assert has(problem, 6, location, code, parameters)


def test_table_tells_callable_names_and_effects() -> None:
    clients = (
        Client("open"),
        Client("named", use_name=True),
        Client("viewer", allow=("/*",)),
        Client("reader", allow=(Grant(services="*/get_parameters", may="call"), Grant(services="/dock", may="serve"))),
        Client("driver", allow=(CALL, Grant(services="/n/*"), Grant(services="/x/get_state")), deny=("/n/*",)),
        Client("shut", deny=("*",)),
    )
    found = {each.peer: each for each in listings(Session(**SERVER, clients=clients))}
    calls = {peer: [row[1:5] for row in each.rows if row.may[0] in "cs"] for peer, each in found.items()}
    assert calls["open"] == [("call, serve", "all", "tcp", "any")]
    assert calls["named"] == [("call, serve", "/named/*", "tcp", "any")]
    assert calls["viewer"] == [("call, serve", "nothing", "-", "-")]
    assert calls["reader"] == [("call", "*/get_parameters", "tcp", "any"), ("serve", "/dock", "tcp", "any")]
    assert calls["driver"] == [
        ("call", "/dock, /n/* and /x/get_state, not /n/*", "tcp", "any"),
        ("serve", "/n/* and /x/get_state, not /n/*", "tcp", "any"),
    ]
    assert {peer: each.acts for peer, each in found.items()} == {
        "open": (EVERY_CALL,),
        "named": (), "viewer": (), "reader": (), "shut": (),
        "driver": ("/dock",),
    }  # fmt: skip


def test_clients_table_tells_what_server_may_do() -> None:
    state = Topic("/n/get_state", "receive", kind="service")
    (found,) = listings(Session(**CLIENT, topics=(DOCK, MAP, NAVIGATE, state)))
    rows = {row.may: row.topics for row in found.rows}
    assert rows["call"] == "/dock, /n/get_state and /navigate (action)"
    assert rows["serve"] == "/get_map"
    assert rows["publish"] == "nothing"
    assert set(found.acts) == {"/dock", "/navigate (action)"}


def test_crossing_despite_deny_is_warned_of() -> None:
    """On either side; what `allow` does not name is no contradiction, since own entries need none."""
    given: dict[str, Any] = {"topics": (DOCK, MAP, Topic("/a", "transmit")), "allow": ("/b",), "deny": ("/dock",)}
    session = Session(**CLIENT, **given, domain_id=3)
    (problem,) = [each for each in advise(session, None) if says(each.message, Advice.CROSSES_ALTHOUGH_DENIED)]
    assert problem.location == "services[0]"
    assert problem.place == "service /dock"
    server = Session(**SERVER, clients=(Client("robot1", **given),), domain_id=3)
    (problem,) = [each for each in advise(server, None) if says(each.message, Advice.CROSSES_ALTHOUGH_DENIED)]
    assert (problem.location, problem.place) == ("clients[0].services[0]", "service /dock")


@pytest.mark.parametrize("denied", ["/a", "/robot1/a", "/cam", "/b"])
def test_the_servers_own_names_are_denied_as_well(denied: str) -> None:
    topics = (Topic("/a", "transmit"), Topic("/b", "receive", remote_topic="/cam"))
    server = Session(**SERVER, use_name=True, clients=(Client("robot1", topics=topics, deny=(denied,)),), domain_id=3)
    (problem,) = [each for each in advise(server, None) if says(each.message, Advice.CROSSES_ALTHOUGH_DENIED)]
    assert problem.place == ("topic /a" if denied.endswith("/a") else "topic /b")
