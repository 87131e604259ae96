"""Both sides' link rows for a wrong key, a missing robot, and two machines with one name."""

from __future__ import annotations

import json
import socket
from types import SimpleNamespace
from typing import TYPE_CHECKING
from unittest.mock import MagicMock

import pytest
from tests.support import constants
from tests.support.bridge import happened, link, linked, now
from tests.support.inside import pretend_linked
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.link.refused_clients import LinkShutdown
from rsb_bridge.link.roles import ClientRole
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.streams import CLOSED_BY_PEER
from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.sealing import CipherSuite
from rsb_console.command.formatting import json_status

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge

    from rsb_bridge.context import Context
    from rsb_bridge.engine import Engine


@pytest.fixture
def heard_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine, too, the first client counts as one that is there."""
    constants.SERVER_SILENT.set(monkeypatch, 60.0)


def as_json(engine: Engine, name: str = "robot1") -> tuple[str, str, str]:
    shown = json.loads(json_status(now(engine)))["status"]["links"][name]
    return shown["state"], shown["cause"], shown["reason"]


@pytest.mark.usefixtures("heard_of")
def test_warning_of_second_client_ends_soon_after(bridge: Bridge) -> None:
    server, first = bridge.both()
    up_since = link(server).since
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
    assert link(server).since == up_since, "the first one has kept the link"


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


RESET = Reason("Connection reset by peer", EndCode.BROKE)


@pytest.mark.parametrize(
    ("goodbye", "reason", "code", "remedy"),
    [
        ("", CLOSED_BY_PEER, EventCode.LINK_LOST, True),
        ("", RESET, EventCode.LINK_LOST, False),
        ("the server stops", CLOSED_BY_PEER, EventCode.LINK_CLOSED, False),
    ],
)
async def test_only_without_a_goodbye_is_there_a_remedy(
    goodbye: str, reason: Reason, code: EventCode, remedy: bool
) -> None:
    """The kernel of a killed process closes its connection in order."""
    lost: list[tuple[str, EventCode]] = []
    channel = ControlChannel(MagicMock(), MagicMock(), {}, lambda *found: lost.append(found), lambda _: None)
    if goodbye:
        channel.abort(goodbye, code)
    channel.closed(reason)
    ((said, found),) = lost
    assert found is code
    assert (said not in (goodbye, reason.text)) is remedy


@pytest.mark.parametrize(
    ("code", "cause"), [(EventCode.LINK_LOST, LinkCause.LOST), (EventCode.LINK_CLOSED, LinkCause.CLOSED)]
)
def test_link_that_ends_has_cause_of_its_code(
    make_context: Callable[..., Context], code: EventCode, cause: LinkCause
) -> None:
    (link,) = ClientRole(make_context(), {"robot1": ()}).links()
    pretend_linked(link, SimpleNamespace(is_fault=False))
    link.lost("in words", code)
    assert (link.status.cause, link.status.reason) == (cause, "in words")


def test_shut_down_client_names_remedy_on_both_sides(bridge: Bridge) -> None:
    server, client = bridge.server(), bridge.client()
    eventually(lambda: linked(client) and linked(server), what="linked")
    client.shut_down().result(60)
    for side in client, server:
        eventually(lambda side=side: not linked(side), what="down")
        _, _, reason = as_json(side)
        assert "rsb-console retry robot1`" in reason
        assert "press r " in reason


def test_link_shut_down_by_server_names_key() -> None:
    reason = LinkShutdown("anna", 0.0).reason("control pc", "robot1")
    assert "rsb-console retry 'control pc' --link robot1`" in reason
    assert "press r " in reason
