"""What a peer begins to send and never ends: bounded over its whole link, and no robot notices."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import carries, eventually, heard, linked, said, settled
from tests.support.domain import text
from tests.support.rogue import Rogue

from rsb_bridge.keys import read_key
from rsb_bridge.qos import Qos
from rsb_bridge.session import Topic
from rsb_bridge.wire.framing import MESSAGE_LIMIT, UNFINISHED_LIMIT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.link import Link

ROUTES = 8
WORDS = f"would hold more than {UNFINISHED_LIMIT:,} bytes"


@pytest.fixture
def server(bridge: Bridge) -> Engine:
    return bridge.server()


@pytest.fixture
def rogue(bridge: Bridge, server: Engine) -> Iterator[Rogue]:
    made = Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)
    yield made
    made.close()


def link_of(server: Engine) -> Link:
    assert server._end is not None
    return next(iter(server._end.links()))


@pytest.mark.parametrize("how", ["frames", "chunks"])
def test_on_streams(how: str, bridge: Bridge, server: Engine, rogue: Rogue, robot: Domain, pc: Domain) -> None:
    """Eight times the longest message, all but its end: half of that is kept; then a robot is served as ever."""
    assert ROUTES * MESSAGE_LIMIT >= 2 * UNFINISHED_LIMIT
    link = link_of(server)
    for number in range(ROUTES):
        stream, writer = rogue.stream(rogue.route(f"/begun{number}", "tcp", Qos()))
        if how == "frames":
            rogue.begin_frame(stream)
        else:
            rogue.begin_chunks(stream, writer)
        assert link.unfinished.held <= UNFINISHED_LIMIT
    eventually(lambda: said(server, WORDS))
    assert linked(server)
    rogue.close()
    eventually(lambda: not linked(server))
    assert link.unfinished.held == 0
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    bridge.client(Topic("/beat", "transmit"))
    carries([out], server, ["/beat"])
    out.publish(text("x" * (8 << 20)))
    heard(there, 1)
    eventually(lambda: link.unfinished.held == 0)


def test_on_datagrams(server: Engine, rogue: Rogue) -> None:
    """The last fragment never comes: routes share what one of them could have, and it is all given back in time."""
    writers = [rogue.datagrams(rogue.route(f"/begun{number}", "udp", Qos())) for number in range(3)]
    rogue.probe()
    link = link_of(server)
    eventually(lambda: link.lanes, what="the server has heard the probe")
    highest, over = 0, time.monotonic() + 4.0
    while time.monotonic() < over:
        for writer in writers:
            rogue.udp.send(writer.write(bytes(120_000), 0, 0, 60_000)[0])
        highest = max(highest, link.unfinished.held)
    assert MESSAGE_LIMIT // 16 < highest <= UNFINISHED_LIMIT
    eventually(lambda: link.unfinished.held == 0)


def test_many_large_messages_at_once(bridge: Bridge, server: Engine, robot: Domain, pc: Domain) -> None:
    """Eight topics of 8 MB, all at the same moment, three times."""
    names = [f"/large{number}" for number in range(ROUTES)]
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    client = bridge.client(*(Topic(name, "transmit") for name in names))
    carries(outs, server, names)
    payload = text("x" * ((8 << 20) - 100))
    for count in (1, 2, 3):
        for out in outs:
            out.publish(payload)
        for there in theres:
            assert heard(there, count, 30)[-1] == payload
    for name in names:
        assert settled(client, name, 3).delivered == 3
    assert link_of(server).unfinished.held == 0
