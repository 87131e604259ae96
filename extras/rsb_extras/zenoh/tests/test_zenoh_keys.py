"""Zenoh in session files: the network, links and topics over it, and what clients get of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace
from tests.channel.window_helpers import QUEUES_MUCH
from tests.config.mistakes import CLIENT, FILE, problems
from tests.support.wording import says

from rsb_bridge.config.advice import Advice, advise
from rsb_bridge.config.session_file import load, parse, save
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.config.validation import SessionMistake, validate
from rsb_bridge.model.transports import of_link
from rsb_console.screens.topic_fields import fields_by_kind
from rsb_console.session.draft import Ends
from rsb_extras.zenoh import ZENOH, ZenohSettings
from rsb_extras.zenoh.zenoh_rules import ZenohMistake
from rsb_extras.zenoh.zenoh_traits import ZenohTraits

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.commands import Ran

    from rsb_bridge.model.session import Session

OVER_ZENOH = CLIENT.replace("192.168.1.10", "zenoh").replace("server_port: 49152\n", "")


def with_network(session: Session, **settings: Any) -> Session:
    return replace(session, features={ZENOH.name: ZenohSettings(**settings)})


@pytest.mark.parametrize(
    ("text", "location", "code", "parameters"),
    [
        (OVER_ZENOH, "zenoh", ZenohMistake.MISSING, {}),
        (OVER_ZENOH + "zenoh: {connect: [tcp/a:1], fleet: 'a b'}\n", "zenoh.fleet", ZenohMistake.FLEET_INVALID, {}),
        (OVER_ZENOH + "zenoh: {connect: [tpc/hub:7447]}\n", "zenoh.connect[0]", ZenohMistake.PROTOCOL_UNKNOWN, {}),
        (OVER_ZENOH + "zenoh: {connect: ['tcp/hub:7447', 'tls/[fe80::1]:7447']}\n", "zenoh.connect[1]",
         SessionMistake.ZONE_MISSING, {"address": "fe80::1"}),
        (OVER_ZENOH + "zenoh: {listen: ['udp/[FE80::1]:7447#iface=lo']}\n", "zenoh.listen[0]",
         SessionMistake.ZONE_MISSING, {"address": "FE80::1"}),
        (CLIENT + "services:\n  - {service: /d, provider: client, protocol: zenoh}\n", "services[0].protocol",
         TopicMistake.NOT_CROSSING, {"chosen_by": "server_ip: zenoh", "crossing": "tcp"}),
    ],
)  # fmt: skip
def test_mistakes_are_named(text: str, location: str, code: Any, parameters: dict[str, Any]) -> None:
    (problem,) = problems(text)
    assert problem.location == location
    assert says(problem.message, code, **parameters)


@pytest.mark.parametrize("zone", ["wlan0", "br-lan", "eth0.100", "2"])
def test_a_zone_of_an_endpoint_is_any_interface(zone: str) -> None:
    endpoint = f"tls/[fe80::1%{zone}]:7447"
    settings = ZENOH.of(parse(f"{OVER_ZENOH}zenoh: {{connect: ['{endpoint}']}}\n", FILE))
    assert settings is not None
    assert settings.connect == (endpoint,)


def test_an_interface_that_this_machine_lacks_is_named() -> None:
    session = with_network(parse(CLIENT, FILE), connect=("tls/hub:7447", "tls/[fe80::1%nope]:7447"))
    assert validate(session) == []
    (problem,) = advise(session, None)
    assert problem.location == "zenoh.connect[1]"
    assert says(problem.message, Advice.NO_INTERFACE, zone="nope")


def test_form_over_zenoh_offers_transports_without_port() -> None:
    session = with_network(parse(CLIENT, FILE), connect=("tcp/hub:7447",))
    session = replace(session, server_ip="zenoh", server_port=0)
    form = fields_by_kind(session, Ends(is_server=False, client="robot1", use_name=False), None)["topic"]
    assert "port" not in form
    assert {value for value, _ in form["protocol"].options if value} == {"zenoh", "zenoh-drop"}


def test_a_link_is_placed_in_its_fleet() -> None:
    session = with_network(parse(CLIENT, FILE), connect=("tcp/hub:7447",), fleet="lab")
    place = of_link("zenoh").place(replace(session, server_ip="zenoh"))
    assert "lab" in place
    assert "tcp/hub:7447" in place


def test_its_window_is_tested_with_its_ages() -> None:
    assert ZenohTraits.ages == QUEUES_MUCH


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("10.0.0.9", "10.0.0.9:7447"),
        ("2001:db8::1", "[2001:db8::1]:7447"),
        ("[fe80::1%wlan0]:7448", "[fe80::1%wlan0]:7448"),
    ],
)
def test_client_connects_to_endpoint_of_its_server(
    address: str, place: str, path: Path, ran: Callable[..., Ran]
) -> None:
    there = with_network(load(path), listen=("tcp/[::]:7447",))
    save(replace(there, server_ip="zenoh", server_port=0), path)
    file = path.parent / "robot2.yaml"
    assert ran("client", "add", str(path), "robot2", "-o", str(file), "--address", address).code == 0
    session = load(file)
    assert (session.server_ip, ZENOH.of(session)) == ("zenoh", ZenohSettings(connect=(f"tcp/{place}",)))


def test_port_of_tcp_server_is_not_its_fleets(path: Path, ran: Callable[..., Ran]) -> None:
    save(with_network(load(path), listen=("tcp/0.0.0.0:7447",)), path)
    file = path.parent / "robot2.yaml"
    assert ran("client", "add", str(path), "robot2", "-o", str(file), "--address", "10.0.0.9:50000").code == 0
    session = load(file)
    assert (session.server_ip, session.server_port) == ("10.0.0.9", 50000)
    assert ZENOH.of(session) == ZenohSettings(connect=("tcp/10.0.0.9:7447",))
