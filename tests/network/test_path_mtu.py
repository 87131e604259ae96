"""Large packets vanish silently: both sides show the cause and the remedy, on their screens and as JSON."""

from __future__ import annotations

import contextlib
import shutil
from typing import TYPE_CHECKING

import pytest
from tests.console.side import Side, in_order
from tests.support.log_lines import check_lines
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.route.sending import USE_TCP

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.network.bridging import Bridge, Program
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="it needs tmux (apt install tmux)")

_PC = "10.99.1.1"
_LARGE = 20_000
"""Bytes of a message: more than a packet."""
_TWO_DATAGRAMS = 2_000
"""Bytes of a message."""


def test_large_packets_that_vanish_without_a_word(
    network: Network, robot: Host, pc: Host, cable: Cable, tmp_path: Path
) -> None:
    topics = ({"topic": "/scan", "protocol": "udp"}, {"topic": "/odom", "protocol": "tcp"})
    bridge = network.bridge(robot, pc, _PC, *topics)
    bridge.listen(pc=("/scan", "/odom"))
    pc.nft(
        "add table inet narrow;"
        "add chain inet narrow in { type filter hook prerouting priority -500; };"
        "add rule inet narrow in iif eth0 meta length > 1200 drop"
    )
    for topic in ("/scan", "/odom"):
        bridge.robot.talk(topic, rate=5, size=_LARGE)
    for side, who in ((bridge.client, ""), (bridge.server, "robot1: ")):
        eventually(lambda side=side: side.link().get("cause") == LinkCause.LARGE_PACKETS, what="the link shows it")
        for topic in ("/scan", "/odom"):
            eventually(
                lambda side=side, topic=topic, who=who: (
                    _remedied(side, topic, "down", Cause.NO_PATH, "MTU").startswith("robot1: ") is bool(who)
                ),
                what=f"{topic}'s reason is of the side that sends",
            )
        assert not side.happened(EventCode.LINK_LOST)
    with _consoles(bridge, tmp_path) as (client, server):
        for screen, who in ((client, ""), (server, "robot1: ")):
            for topic in ("/scan", "/odom"):
                screen.choose(topic)
                screen.says("✗ DOWN", who, "large packets are lost", "MTU")
    pc.nft("delete table inet narrow")
    for topic in ("/scan", "/odom"):
        for side in (bridge.client, bridge.server):
            eventually(lambda topic=topic, side=side: side.route(topic).get("state") == "ok", what=f"{topic} is ok")
    _check_lines(bridge)


def test_half_of_the_datagrams_lost(network: Network, robot: Host, pc: Host, cable: Cable, tmp_path: Path) -> None:
    bridge = network.bridge(robot, pc, _PC, {"topic": "/scan", "protocol": "udp"})
    bridge.listen(pc=("/scan",))
    bridge.robot.talk("/scan", rate=20, size=_TWO_DATAGRAMS)
    for side in (bridge.client, bridge.server):
        eventually(lambda side=side: side.route("/scan").get("state") == "ok", what="/scan is ok")
    pc.nft(
        "add table inet narrow;"
        "add chain inet narrow in { type filter hook prerouting priority -500; };"
        "add rule inet narrow in iif eth0 meta l4proto udp meta length > 300 numgen random mod 2 == 0 drop"
    )
    words = ("of the last", "did not arrive, for", "lost on the way", "2 datagrams", USE_TCP)
    for side, who in ((bridge.client, ""), (bridge.server, "robot1: ")):
        reason = _remedied(side, "/scan", "slow", Cause.LOSSY, USE_TCP)
        assert reason.startswith("robot1: ") is bool(who), reason
        assert in_order(reason, words), reason
        eventually(lambda side=side: side.happened(EventCode.ROUTE_FAULT, USE_TCP), what="it is logged")
    with _consoles(bridge, tmp_path) as (client, server):
        for screen, who in ((client, ""), (server, "robot1: ")):
            screen.choose("/scan")
            screen.says("≈ SLOW", who, *words)
    _check_lines(bridge)


def _remedied(side: Program, topic: str, state: str, cause: Cause, remedy: str) -> str:
    """The reason for a state once it names a remedy, which it does when it is clear that the link is not full."""

    def reason() -> str:
        text = _why(side, topic, state, cause)
        return text if remedy in text else ""

    return eventually(reason, what=f"{topic} {state}: {cause}, {remedy}")


def _why(side: Program, topic: str, state: str, cause: Cause) -> str:
    """Return the reason of a topic's state, or an empty string if it has another state or cause."""
    shown = side.route(topic)
    return shown["reason"] if (shown.get("state"), shown.get("cause")) == (state, cause) else ""


@contextlib.contextmanager
def _consoles(bridge: Bridge, folder: Path) -> Iterator[tuple[Side, Side]]:
    """A console in a real terminal that is attached to each side."""
    with contextlib.ExitStack() as consoles:
        made = [
            Side(folder / f"screen{number}", program.control, "attach")
            for number, program in enumerate((bridge.client, bridge.server))
        ]
        for side in made:
            consoles.callback(side.close)
        yield made[0], made[1]


def _check_lines(bridge: Bridge) -> None:
    for program in (bridge.client, bridge.server):
        check_lines(line for line in program.log if "code" in line)
