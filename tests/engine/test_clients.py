"""Clients added, changed and removed on a server that runs: the others' links stay."""

from __future__ import annotations

import gc
import weakref
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.bridge import carries, find, happened, heard, link, linked, now
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError, Unable
from rsb_bridge.config.keys import KeyFileProblem, fingerprint, read_key, write_key
from rsb_bridge.config.session_changes import ClientProblem
from rsb_bridge.config.session_file import save
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

CHAT, MAP = Topic("/chat", "transmit"), Topic("/map", "transmit")
ROBOT2 = Client("robot2", "robot2.key", topics=(MAP,))


def test_a_client_comes_and_goes_while_another_stays(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # a busy machine that stands still loses no link
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, first = bridge.both(CHAT)
    carries([out], server, ["/chat"])
    since = link(server).since
    bridge.make_key("robot2")

    second = bridge.client(name="robot2", key_file="robot2.key")
    eventually(lambda: link(second, "robot2").cause == LinkCause.UNKNOWN_NAME)
    server.add_client(ROBOT2).result(60)
    second.retry().result(60)
    eventually(lambda: linked(server, "robot2"))
    assert server.session.clients == (Client("robot1"), ROBOT2)
    eventually(lambda: find(second, "/map"), what="its topic is proposed to it")

    server.remove_client("robot2").result(60)
    eventually(lambda: not linked(second, "robot2"))
    eventually(lambda: "robot2" in link(second, "robot2").reason, what="the client gets the reason")
    assert [each.name for each in server.snapshot().links] == ["robot1"]
    assert [each.name for each in server.session.listed_clients] == ["robot1"]
    assert find(server, "/map") is None

    out.publish(text("all along"))
    assert heard(there, 1) == [text("all along")]
    assert link(server).since == since
    assert linked(first)


def test_retry_of_unknown_link_is_refused(bridge: Bridge) -> None:
    server, client = bridge.both()
    for side in server, client:
        with pytest.raises(EngineError, match=pattern(Denied.WHICH_CLIENT, clients="robot1")):
            side.retry("robot9").result(60)


def test_changes_that_wait_for_each_other_undo_nothing(bridge: Bridge) -> None:
    server = bridge.server(clients=(Client("robot1"),), shared_keys=True)
    topics = tuple(Topic(f"/t{number}", "transmit") for number in range(60))  # takes several turns of the loop
    new = (Client("robot2", topics=topics), Client("robot3"), Client("robot4"))
    for change in [server.add_client(each) for each in new]:
        change.result(60)
    assert sorted(server.session.listed_clients, key=lambda each: each.name) == [Client("robot1"), *new]


def test_the_same_file_with_another_key_counts(bridge: Bridge) -> None:
    server, client = bridge.both()
    write_key(bridge.folder / bridge.key_file, force=True)
    server.change_client(Client("robot1")).result(60)
    eventually(lambda: link(server).fingerprint == fingerprint(read_key(bridge.folder / bridge.key_file)))
    eventually(lambda: not linked(client))


def test_impossible_change_is_refused_and_changes_nothing(bridge: Bridge) -> None:
    server, client = bridge.both()
    session = server.session
    unknown = pattern(ClientProblem.MISSPELT, name="robot2", near="robot1")
    no_key = pattern(KeyFileProblem.NO_SUCH_FILE, path=bridge.folder / "gone.key")
    refused: tuple[tuple[Callable[[], Future[None]], str], ...] = (
        (lambda: server.add_client(Client("robot1")), pattern(ClientProblem.EXISTS, name="robot1")),
        (
            lambda: server.add_client(Client("robot2", "gone.key")),
            no_key,
        ),
        (lambda: server.add_client(Client("robot2", deny=("scan",))), "'scan' matches no topic"),
        (lambda: server.change_client(Client("robot2")), unknown),
        (lambda: server.remove_client("robot2"), unknown),
        (lambda: client.add_client(Client("robot2")), Unable.NOT_A_SERVER()),
    )
    for command, words in refused:
        with pytest.raises(EngineError, match=words):
            command().result(60)
    assert server.session == session
    assert linked(server)


def test_clients_share_key_only_on_purpose(bridge: Bridge) -> None:
    """Each could take the other's name and rights: at the start, when one is added, and when the file is read again."""
    bridge.make_key("robot2")
    (bridge.folder / "copy.key").write_bytes((bridge.folder / bridge.key_file).read_bytes())
    both = (Client("robot1", bridge.key_file), Client("robot2", "copy.key"))
    words = pattern(KeyFileProblem.SHARED, owners=KeyFileProblem.ONE_KEY(names="robot1 and robot2"))
    for clients in (both, (Client("robot1"), Client("robot2"))):
        with pytest.raises(EngineError, match=words):
            bridge.server(clients=clients)
    server = bridge.server()
    for client in both[1:], (Client("robot2"),):
        with pytest.raises(EngineError, match=words):
            server.add_client(*client).result(60)
    server.add_client(ROBOT2).result(60)
    with pytest.raises(EngineError, match=words):
        server.change_client(Client("robot2", "copy.key")).result(60)
    path = bridge.folder / "server.yaml"
    save(bridge.server_session(clients=both), path)
    server.use_file(path)
    with pytest.raises(EngineError, match=words):
        server.reload().result(60)
    assert [each.name for each in server.session.listed_clients] == ["robot1", "robot2"]
    server.stop()
    bridge.server(clients=both, shared_keys=True)


def test_log_tells_arrivals_and_departures_only(bridge: Bridge) -> None:
    server = bridge.server()
    bridge.make_key("robot2")
    server.add_client(ROBOT2).result(60)
    kept = [weakref.ref(each) for each in inside(server).role.links() if each.name == "robot2"]
    server.remove_client("robot2").result(60)
    eventually(lambda: gc.collect() >= 0 and [each() for each in kept] == [None])
    assert happened(server, EventCode.OPERATOR_CLIENTS, "client robot2: added")
    assert happened(server, EventCode.OPERATOR_CLIENTS, "client robot2: removed")


def test_server_begins_and_ends_without_clients(bridge: Bridge, pc: Domain) -> None:
    server = bridge.server(clients=())
    assert now(server).links == ()
    assert now(server).running
    server.add_client(Client("robot1")).result(60)
    client = bridge.client()
    eventually(lambda: linked(client) and linked(server))
    server.remove_client("robot1").result(60)
    assert now(server).links == ()
    assert server.session.clients == ()
    eventually(lambda: not linked(client))
