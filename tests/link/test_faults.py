"""Both sides' link rows for a wrong key, a missing robot, and two machines with one name."""

from __future__ import annotations

import json
import socket
import threading
from typing import TYPE_CHECKING
from unittest.mock import MagicMock

import pytest
from tests.support import constants
from tests.support.bridge import happened, link, linked, now
from tests.support.inside import inside
from tests.support.waiting import eventually, holds
from tests.support.wording import says

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.link import Link
from rsb_bridge.link.refused_clients import REMEDY, SameName
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import CLOSED_BY_PEER
from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.sealing import CipherSuite
from rsb_console.command.formatting import json_status

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine


@pytest.fixture
def heard_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine, too, the first client counts as one that is there."""
    constants.SERVER_SILENT.set(monkeypatch, 60.0)


def as_json(engine: Engine, name: str = "robot1") -> tuple[str, str, str]:
    """A link's state, cause and reason as headless says them."""
    shown = json.loads(json_status(now(engine)))["status"]["links"][name]
    return shown["state"], shown["cause"], shown["reason"]


@pytest.mark.usefixtures("heard_of")
def test_of_two_clients_of_one_name_the_first_keeps_the_link(bridge: Bridge) -> None:
    """Here both run on one machine, as with a second terminal; it is the same with two machines."""
    server, first = bridge.both()
    up_since = link(server).since
    second = bridge.client()
    eventually(lambda: link(second).cause == LinkCause.NAME_TAKEN)
    assert link(second).state is State.DOWN
    assert says(link(second).reason, SameName.TAKEN, name="robot1")
    assert REMEDY in link(second).reason
    for engine in (server, first):
        # Each on its own: where the second client is late with its next attempt, the warning ends for a moment.
        eventually(lambda engine=engine: says(link(engine).warning, SameName.SECOND, name="robot1"))
        eventually(lambda engine=engine: as_json(engine)[:2] == ("ok", "name_taken"))
    second.retry().result(60)
    holds(lambda: linked(first) and linked(server) and not linked(second), 2.0)
    assert link(server).since == up_since
    first.stop()
    second.retry().result(60)
    eventually(lambda: linked(second) and linked(server) and link(server).warning == "")


@pytest.mark.usefixtures("heard_of")
def test_the_warning_of_a_second_client_ends_soon_after_it(bridge: Bridge) -> None:
    server, first = bridge.both()
    second = bridge.client()
    eventually(lambda: link(server).warning and link(first).warning)
    second.stop()
    eventually(lambda: not link(server).warning and not link(first).warning)
    eventually(lambda: as_json(first)[:2] == as_json(server)[:2] == ("ok", ""))
    told = [event for event in first.events() if event.code == EventCode.LINK_NAME_TAKEN]
    assert len(told) == 1, "however often it tried"
    for engine in (server, first):
        eventually(lambda engine=engine: happened(engine, EventCode.LINK_NAME_FREE))
        ends = [event for event in engine.events() if event.code == EventCode.LINK_NAME_FREE]
        assert [(event.link, event.level) for event in ends] == [("robot1", Level.INFO)]


@pytest.mark.usefixtures("heard_of")
def test_a_replay_is_no_second_client(bridge: Bridge) -> None:
    """Somebody without the key has recorded a client's first message, and sends it again."""
    server, first = bridge.both()
    hello = Hello("0.1.0", "robot1", "feedbeef", 0, host="spare")
    recorded = ClientConnection(hello, read_key(bridge.folder / bridge.key_file).secret, CipherSuite.CHACHAPOLY).start()
    for _ in range(3):
        with socket.create_connection(("127.0.0.1", bridge.port), 10.0) as stream:
            stream.sendall(recorded)
            assert stream.recv(1 << 16), "it is answered"
            assert link(server).warning == ""
    assert happened(server, EventCode.LINK_NAME_TAKEN) is None
    assert linked(first)


def test_a_client_takes_the_name_of_one_that_is_silent(bridge: Bridge) -> None:
    """A process that hangs, or whose end a network in between hides."""
    server, first = bridge.both()
    over = threading.Event()
    inside(first).context.loop.call_soon_threadsafe(over.wait, 90.0)
    try:
        second = bridge.client()
        eventually(lambda: linked(second), what="linked")
    finally:
        over.set()
    ended = eventually(lambda: happened(server, EventCode.LINK_REPLACED) or happened(server, EventCode.LINK_LOST))
    assert ended.level is Level.WARNING
    eventually(lambda: not linked(first))


@pytest.mark.parametrize(
    ("reason", "code", "cause", "remedy"),
    [
        (CLOSED_BY_PEER, EventCode.LINK_LOST, LinkCause.LOST, True),
        ("Connection reset by peer", EventCode.LINK_LOST, LinkCause.LOST, False),
        ("the server stops", EventCode.LINK_CLOSED, LinkCause.CLOSED, False),
        (CLOSED_BY_PEER, EventCode.LINK_CLOSED, LinkCause.CLOSED, False),
    ],
)
def test_only_without_a_goodbye_is_there_a_remedy(reason: str, code: EventCode, cause: LinkCause, remedy: bool) -> None:
    """The kernel of a killed process closes its connection in order."""
    broken = MagicMock(_is_silent=False)
    broken.transport.problem = ""
    Link.lost(broken, reason, code)
    found, said = broken.status.down.call_args.args
    assert found == cause
    assert (said != reason) is remedy


def test_a_client_that_is_shut_down_names_the_remedy_on_both_sides(bridge: Bridge) -> None:
    server, client = bridge.server(), bridge.client()
    eventually(lambda: linked(client) and linked(server), what="linked")
    client.shut_down().result(60)
    for side in (client, server):
        eventually(lambda side=side: not linked(side), what="down")
        _, _, reason = as_json(side)
        assert "rsb-console retry" in reason
