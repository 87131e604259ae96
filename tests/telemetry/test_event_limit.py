"""A peer that makes log lines as fast as it can: the log stays readable, and says how many are left out."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import carries, happened, heard, linked
from tests.support.domain import text
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.telemetry.event_log import A_SECOND, AT_ONCE
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
    with contextlib.closing(Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)) as made:
        yield made


def propose(number: int, topic: str) -> Propose:
    return Propose(route=number, topic=topic, remote_topic=topic, from_client=True, transport="tcp")


def come_and_go(rogue: Rogue) -> None:
    for number in range(1, 2 * FRAMES, 2):
        rogue.say(propose(number, f"/came{number}"))
        rogue.say(Close(route=number, reason="gone", code=EndCode.REMOVED))


def are_refused(rogue: Rogue) -> None:
    for number in range(1, 2 * FRAMES, 2):
        rogue.say(propose(number, f"/no name {number}"))


def pause_and_resume(rogue: Rogue) -> None:
    route = rogue.route("/beat", "tcp", Qos())
    for number in range(FRAMES):
        rogue.say(Pause(route=route, paused=number % 2 == 0, revision=number))


def room(began: float) -> float:
    """For lines, since so long ago: how fast a machine floods is its own affair."""
    return AT_ONCE + 100 + A_SECOND * (time.monotonic() - began)


@contextlib.contextmanager
def kept_alive(rogue: Rogue) -> Iterator[None]:
    """Keep its link while something takes long: it pings, and it reads, or the kernel gives the connection up."""
    over = threading.Event()

    def ping() -> None:
        while not over.is_set():
            rogue.say(Ping(n=1, sent=1))
            rogue.drain_for(0.5)

    pinging = threading.Thread(target=ping)
    pinging.start()
    try:
        yield
    finally:
        over.set()
        pinging.join()


def of_link(server: Engine, name: str) -> list[Event]:
    return [event for event in server.events() if event.link == name]


@pytest.mark.parametrize(
    ("flood", "codes"),
    [
        pytest.param(come_and_go, {EventCode.ROUTE_REMOVED}, marks=pytest.mark.long),
        pytest.param(are_refused, {EventCode.ROUTE_REFUSED}, marks=pytest.mark.long),
        (pause_and_resume, {EventCode.ROUTE_PAUSED, EventCode.ROUTE_RESUMED}),
    ],
)
def test_lines_at_line_speed(
    flood: Callable[[Rogue], None], codes: set[EventCode], bridge: Bridge, server: Engine, rogue: Rogue
) -> None:
    """A third of three thousand lines is written, with the number of the others; none about the link itself is lost."""
    began = time.monotonic()
    flood(rogue)
    rogue.say(Ping(n=1, sent=1))
    rogue.wait_for(Pong)  # so it has read everything before
    rogue.close()
    lost = eventually(lambda: happened(server, EventCode.LINK_LOST))
    written = of_link(server, "robot1")
    assert len(written) < room(began)
    told = [event for event in written if event.code in codes]
    counts = [event for event in written if event.code == EventCode.LINK_EVENTS_LEFT_OUT]
    left_out = sum(int(event.text.partition(" ")[0].replace(",", "")) for event in counts)
    assert len(told) >= AT_ONCE - 2
    assert len(told) + left_out == FRAMES
    assert counts[-1].number == lost.number - 1
    again = Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)
    eventually(lambda: len([event for event in of_link(server, "robot1") if event.code == EventCode.LINK_UP]) == 2)
    again.close()


@pytest.mark.long
def test_link_made_and_broken_at_full_speed(bridge: Bridge, server: Engine) -> None:
    """Its last state is logged nevertheless, and the lines of its topics keep their room."""
    key = read_key(bridge.folder / bridge.key_file).secret
    began = time.monotonic()
    for _ in range(FRAMES // 4):
        Rogue(bridge.port, key).close()
    eventually(lambda: happened(server, EventCode.LINK_EVENTS_LEFT_OUT) and not linked(server))
    eventually(lambda: of_link(server, "robot1")[-1].code == EventCode.LINK_LOST)
    assert len(server.events()) < room(began)
    again = Rogue(bridge.port, key)
    again.say(propose(1, "/no name"))
    eventually(lambda: happened(server, EventCode.ROUTE_REFUSED, "/no name"))
    again.close()


def test_the_others_lines_are_written(bridge: Bridge, server: Engine, rogue: Rogue, robot: Domain, pc: Domain) -> None:
    """Each link has its own share; the end of a flood is logged while the link lives."""
    with kept_alive(rogue):
        are_refused(rogue)
        there, out = pc.listener("/beat"), robot.publisher("/beat")
        other = bridge.client(Topic("/beat", "transmit"), name="robot2", key_file="other.key")
        carries([out], server, ["/beat"])
        assert any(event.code == EventCode.ROUTE_CONNECTED for event in of_link(server, "robot2"))
        assert not any(
            event.code == EventCode.LINK_EVENTS_LEFT_OUT for event in (*of_link(server, "robot2"), *other.events())
        )
        eventually(lambda: happened(server, EventCode.LINK_EVENTS_LEFT_OUT))
        assert linked(server)
    out.publish(text("served"))
    heard(there, 1)
