"""What both sides' link rows say of a wrong key, of a robot that is missing, and of two machines with one name."""

from __future__ import annotations

import json
import socket
import threading
from typing import TYPE_CHECKING

from tests.support.bridge import happened, link, linked, now
from tests.support.waiting import eventually, holds

from rsb_bridge.config.keys import fingerprint, read_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.verdict import LinkCause
from rsb_console.command.reports import json_status

if TYPE_CHECKING:
    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine


def as_json(engine: Engine, name: str = "robot1") -> tuple[str, str, str]:
    """A link's state, cause and reason as headless says them."""
    shown = json.loads(json_status(now(engine)))["status"]["links"][name]
    return shown["state"], shown["cause"], shown["reason"]


def test_a_wrong_key_is_a_fault_of_the_link_on_both_sides(bridge: Bridge) -> None:
    theirs = bridge.make_key("other")
    server = bridge.server(name="pc", clients=(Client("robot1"), Client("robot2")))
    client = bridge.client(key_file=theirs)
    eventually(lambda: link(client).cause == link(server).cause == LinkCause.WRONG_KEY)
    marks = [fingerprint(read_key(bridge.folder / name)) for name in (theirs, bridge.key_file)]
    words = f"the keys of 'robot1' differ: {marks[0]} on the client, {marks[1]} on the server"
    for engine in (client, server):
        assert link(engine).state is State.DOWN
        assert words in link(engine).reason
        assert as_json(engine) == ("down", "wrong_key", link(engine).reason)
    assert "127.0.0.1" in link(server).reason
    event = happened(server, EventCode.LINK_WRONG_KEY)
    assert event is not None
    assert (event.link, event.level) == ("robot1", Level.WARNING)
    assert link(server, "robot2").cause == LinkCause.NOT_YET


def test_a_robot_that_is_missing_was_last_seen_somewhere(bridge: Bridge) -> None:
    server, client = bridge.both()
    address = link(server).peer
    assert address
    client.stop()
    eventually(lambda: link(server).state is State.DOWN)
    assert (link(server).peer, link(server).cause) == (address, LinkCause.CLOSED)


def test_of_two_clients_of_one_name_the_first_keeps_the_link(bridge: Bridge) -> None:
    """Here both run on one machine, as with a second terminal; it is the same with two machines."""
    server, first = bridge.both()
    up_since = link(server).since
    second = bridge.client()
    eventually(lambda: link(second).cause == LinkCause.NAME_TAKEN)
    host = socket.gethostname()
    assert link(second).state is State.DOWN
    assert "'robot1' is linked already, since 2" in link(second).reason
    assert f"UTC, from {link(server).peer} (host {host}): stop one of the two" in link(second).reason
    assert as_json(second) == ("down", "name_taken", link(second).reason)
    eventually(lambda: link(server).warning)
    assert link(server).cause == LinkCause.NAME_TAKEN
    assert f"a second client, from 127.0.0.1 (host {host}), calls itself 'robot1' too" in link(server).warning
    assert as_json(server)[:2] == ("ok", "name_taken")
    assert as_json(server)[2].startswith("a second client, from 127.0.0.1")
    event = happened(server, EventCode.LINK_NAME_TAKEN)
    assert event is not None
    assert (event.link, event.level) == ("robot1", Level.WARNING)
    second.retry().result(5)
    holds(lambda: linked(first) and linked(server) and not linked(second), 2.0)
    assert link(server).since == up_since
    first.stop()
    second.retry().result(5)
    eventually(lambda: linked(second) and linked(server))
    assert link(server).warning == ""


def test_a_client_takes_the_name_of_one_that_is_silent(bridge: Bridge) -> None:
    """A process that hangs, or whose end a network in between hides."""
    server, first = bridge.both()
    assert first._bridge is not None
    over = threading.Event()
    first._bridge.context.loop.call_soon_threadsafe(over.wait, 30.0)
    try:
        second = bridge.client()
        eventually(lambda: linked(second), what="linked")
    finally:
        over.set()
    ended = happened(server, EventCode.LINK_REPLACED) or happened(server, EventCode.LINK_LOST)
    assert ended is not None
    assert ended.level is Level.WARNING
    eventually(lambda: not linked(first))
