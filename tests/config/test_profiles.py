"""A link's profile, and the settings that override it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rsb_bridge.channel.scheduler import SendingChannel
from rsb_bridge.config.session_changes import kept
from rsb_bridge.config.session_file import SessionError, dump, parse
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.transports import NO_PROFILE, PROFILES, LinkProfile, profile_of
from rsb_bridge.route.catching_up import Backlog
from rsb_bridge.route.half import Carried
from rsb_bridge.route.ledger import RouteLedger
from rsb_bridge.route.peer_budget import PeerBudget
from rsb_bridge.route.rate_limit import RateLimit
from rsb_bridge.route.sending import Outbox, QueueLimits
from rsb_bridge.route.topic_flow import AgreedEnd
from rsb_bridge.transport.registry import default_transports
from rsb_console.command.check import summary

_CLIENT = """\
name: robot1
role: client
server_ip: {address}
server_port: {port}
use_encryption: false
profile: {profile}
topics:
  - {{topic: /scan, direction: transmit, priority: high}}
  - {{topic: /map, direction: transmit, compression: none}}
"""


def session(profile: str, address: str = "192.168.1.10", port: int = 49152) -> Session:
    return parse(_CLIENT.format(profile=profile, address=address, port=port), Path("robot1.yaml"))


def test_what_is_given_wins() -> None:
    tcp = default_transports()["tcp"]
    lte = PROFILES["lte"]
    given, none = (
        proposal_of(topic, tcp, client_name="robot1", use_name=False, profile=lte)
        for topic in session("lte").topics[::-1]
    )
    assert (given.compression, none.compression) == ("none", "zstd")


def test_clients_profile_overrides_servers() -> None:
    assert profile_of("wifi", "lte") is PROFILES["wifi"]
    assert profile_of(None, "lte") is PROFILES["lte"]
    assert profile_of(None, None) is NO_PROFILE is PROFILES["lan"]


@pytest.mark.parametrize("profile", ["lan", "wifi", "lte", "satellite"])
def test_a_radio_is_no_network(profile: str) -> None:
    with pytest.raises(SessionError) as refused:
        session(profile, "5C:F3:70:9A:1B:2E", 3)
    assert [problem.location for problem in refused.value.problems] == ["profile"]


def test_profile_is_kept_in_file_and_bridge() -> None:
    wifi, lte = session("wifi"), session("lte")
    assert parse(dump(wifi), Path("again.yaml")) == wifi
    unchanged, left = kept(wifi, lte)
    assert unchanged == wifi
    assert len(left) == 1


def test_check_says_what_it_gives() -> None:
    lines = list(summary(session("lte")))
    assert any("profile lte" in line and "256 KiB" in line for line in lines)
    assert [("zstd" in line, "high priority" in line) for line in lines if "transmit" in line] == [
        (True, True),
        (False, False),
    ]


def test_queues() -> None:
    """Best effort waits for less, reliable for longer."""
    transport = default_transports()["tcp"]
    proposal = proposal_of(Topic("/scan", "transmit"), transport, client_name="robot1", use_name=False)
    channel: Any = SimpleNamespace(free=False, behind=lambda now: False, still=lambda now: 0.0)

    def limits(qos: Qos, profile: LinkProfile) -> QueueLimits:
        peer = SimpleNamespace(profile=profile, linked=True, budget=PeerBudget(0.0))
        arming, age = SimpleNamespace(required=False), SimpleNamespace(only_newest=False)
        route: Any = SimpleNamespace(transport=transport, proposal=proposal, peer=peer, arming=arming, age=age)
        carried, end = Carried[SendingChannel](), AgreedEnd(route)
        flow: Any = SimpleNamespace(route=route, qos=qos, carried=carried, end=end)
        return Outbox(flow, RouteLedger(), Backlog()).limits(channel, 0, 0.0)

    live = limits(Qos(reliability="best_effort"), PROFILES["lte"])
    plain, lte = limits(Qos(), NO_PROFILE), limits(Qos(), PROFILES["lte"])
    assert (live.older_than, live.size) == (1.0, 256 * 1024)
    assert (plain.younger_than, lte.younger_than, lte.size) == (5.0, 15.0, plain.size)


def test_its_rate_is_one_limit_among_others() -> None:
    limit = RateLimit(0.0, lambda *_: None)
    told: list[float] = []
    limit.switched = lambda: told.append(limit.rate)
    limit.set_profile_rate(10.0)
    assert (limit.rate, told) == (10.0, [10.0])
    assert "profile" in limit.why
    limit.allow_here(4.0)
    assert limit.rate == 4.0
    assert "profile" not in limit.why
