"""A peer that has the key and makes lines for the log as fast as it can send: the log stays readable, and says so."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import carries, eventually, heard, linked, said
from tests.support.domain import text
from tests.support.rogue import Rogue

from rsb_bridge.config.keys import read_key
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.telemetry.event_limit import AT_ONCE
from rsb_bridge.wire.messages import Close, Pause, Ping, Pong, Propose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import Event

FRAMES = 3000
"""Each makes one line."""


@pytest.fixture
def server(bridge: Bridge) -> Engine:
    bridge.make_key("other")
    return bridge.server(name="pc", clients=(Client("robot1"), Client("robot2", key_file="other.key")))


@pytest.fixture
def rogue(bridge: Bridge, server: Engine) -> Iterator[Rogue]:
    made = Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)
    yield made
    made.close()


def propose(number: int, topic: str) -> Propose:
    return Propose(route=number, topic=topic, remote_topic=topic, from_client=True, transport="tcp")


def come_and_go(rogue: Rogue) -> None:
    for number in range(1, 2 * FRAMES, 2):
        rogue.say(propose(number, f"/came{number}"))
        rogue.say(Close(route=number, reason="gone", removed=True))


def are_refused(rogue: Rogue) -> None:
    for number in range(1, 2 * FRAMES, 2):
        rogue.say(propose(number, f"/no name {number}"))


def pause_and_resume(rogue: Rogue) -> None:
    route = rogue.route("/beat", "tcp", Qos())
    for number in range(FRAMES):
        rogue.say(Pause(route=route, paused=number % 2 == 0))


def of_link(server: Engine, name: str) -> list[Event]:
    return [event for event in server.events() if event.link == name]


@pytest.mark.parametrize(
    ("flood", "words"),
    [
        (come_and_go, "removed by the other side: gone"),
        (are_refused, "is not an absolute topic name"),
        (pause_and_resume, ("paused", "resumed")),
    ],
)
def test_lines_at_line_speed(
    flood: Callable[[Rogue], None], words: str | tuple[str, ...], bridge: Bridge, server: Engine, rogue: Rogue
) -> None:
    """Of three thousand lines a third are written, and how many were not; none about the link itself is lost."""
    flood(rogue)
    rogue.say(Ping(n=1, sent=1))
    rogue._wait(Pong)  # so it has read everything before
    rogue.close()
    lost = eventually(lambda: said(server, "link lost"))
    written = of_link(server, "robot1")
    assert len(written) < AT_ONCE + 100
    ends = (words,) if isinstance(words, str) else words
    told = [event for event in written if any(end in event.text for end in ends)]
    counts = [re.fullmatch(r"([\d,]+) more lines left out", event.text) for event in written]
    left_out = sum(int(count[1].replace(",", "")) for count in counts if count)
    assert len(told) >= AT_ONCE - 2
    assert len(told) + left_out == FRAMES
    assert [event.number for event in written if "left out" in event.text][-1] == lost.number - 1
    again = Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)
    eventually(lambda: len([event for event in of_link(server, "robot1") if "linked with" in event.text]) == 2)
    again.close()


def test_a_link_that_is_made_and_broken_at_full_speed(bridge: Bridge, server: Engine) -> None:
    """What became of it last is told nevertheless, and the lines of its topics have not lost their room."""
    key = read_key(bridge.folder / bridge.key_file).secret
    for _ in range(FRAMES // 4):
        Rogue(bridge.port, key).close()
    eventually(lambda: said(server, "left out") and not linked(server))
    told = eventually(lambda: (event := of_link(server, "robot1")[-1]) and "lost" in event.text and event, within=12)
    assert re.fullmatch(r"(\d+ more lines left out; the last one: )?link lost: .*", told.text)
    assert len(server.events()) < AT_ONCE + 100
    again = Rogue(bridge.port, key)
    again.say(propose(1, "/no name"))
    eventually(lambda: said(server, "refused /no name"))
    again.close()


def test_the_others_lines_are_written(bridge: Bridge, server: Engine, rogue: Rogue, robot: Domain, pc: Domain) -> None:
    """Each link has its own share; and a flood that is over is told of while the link lives."""
    are_refused(rogue)
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    other = bridge.client(Topic("/beat", "transmit"), name="robot2", key_file="other.key")
    carries([out], server, ["/beat"])
    assert any("connected" in event.text for event in of_link(server, "robot2"))
    assert not any("left out" in event.text for event in (*of_link(server, "robot2"), *other.events()))
    eventually(lambda: any("left out" in event.text for event in of_link(server, "robot1")), within=3)
    assert linked(server)
    out.publish(text("served"))
    heard(there, 1)
