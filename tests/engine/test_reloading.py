"""A session file that is read again: what differs changes, what does not goes on."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.engine.reloading_helpers import Edited, codes
from tests.support import constants, replaced
from tests.support.bridge import carries, find, happened, heard, link, linked, route
from tests.support.domain import text
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError, Unable
from rsb_bridge.config.rights import DeniedText
from rsb_bridge.config.session_changes import ChangeRefused
from rsb_bridge.config.session_file import load_file
from rsb_bridge.link.reloading import ClientStep
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import OWN_CONSOLE, acting
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
    from concurrent.futures import Future
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.engine import Engine


def test_only_the_topics_that_differ_change(
    bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # a busy machine that stands still loses no link
    kept_there, kept = pc.listener("/kept"), robot.publisher("/kept")
    robot.publisher("/gone")
    added_there, added = pc.listener("/added"), robot.publisher("/added")
    server, client = bridge.both(Topic("/kept", "transmit"), Topic("/gone", "transmit"), Topic("/map", "transmit"))
    carries([kept], server, ["/kept"])
    kept.publish(text("one"))
    heard(kept_there, 1)
    eventually(lambda: route(client, "/kept").ledger.delivered == 1)
    since = link(client).since
    file = Edited(client, tmp_path / "robot1.yaml")
    wanted: dict[str, Any] = {"topics": (Topic("/kept", "transmit"), Topic("/map", "transmit", protocol="udp"),
                         Topic("/added", "transmit"))}  # fmt: skip
    would = file.reload(dry_run=True, **wanted)
    assert client.session.topics[1].topic == "/gone", "nothing has changed yet"
    reloaded = file.reload(**wanted)
    assert reloaded == would
    assert (reloaded.left, reloaded.failed) == ((), ())
    assert reloaded.changed == (
        "/gone (transmit): removed (it was {topic: /gone, direction: transmit})",
        "/map (transmit): protocol none → udp; reopened, counted from 0",
        "/added (transmit): added: {topic: /added, direction: transmit}",
    )
    assert set(client.session.topics) == set(wanted["topics"])
    carries([added], server, ["/added"])
    added.publish(text("two"))
    heard(added_there, 1)
    eventually(lambda: find(server, "/gone") is None)
    assert route(client, "/kept").ledger.delivered == 1
    assert link(client).since == since
    assert len(codes(client, EventCode.LINK_UP)) == 1
    assert codes(client, EventCode.OPERATOR_RELOADED) == [
        f"reload by {OWN_CONSOLE}: {change}" for change in reloaded.changed
    ], "each once"
    assert happened(server, EventCode.ROUTE_REMOVED, "/gone: removed by the other side: removed from the session file")
    assert file.reload() == type(reloaded)(), "nothing differs any more"
    same = f"reload by {OWN_CONSOLE}: nothing differs in {file.path}"
    assert codes(client, EventCode.OPERATOR_RELOADED)[-1] == same


def test_another_rate_limit_keeps_counts_and_link(
    bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # a busy machine that stands still loses no link
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])
    out.publish(text("one"))
    heard(there, 1)
    eventually(lambda: route(client, "/chat").ledger.delivered == 1)
    before = [link(side).since for side in (client, server)]
    file = Edited(client, tmp_path / "robot1.yaml")
    reloaded = file.reload(topics=(Topic("/chat", "transmit", max_rate=0.01),))
    assert reloaded.changed == ("/chat (transmit): max_rate none → 0.01",)
    out.publish(text("two"))
    out.publish(text("three"))
    ledger = eventually(lambda: now if (now := route(client, "/chat").ledger).offered == 3 else None)
    assert ledger.throttled == 1
    eventually(lambda: route(server, "/chat").spec.max_rate == 0.01)
    eventually(lambda: route(server, "/chat").ledger.delivered == 2)
    assert [link(side).since for side in (client, server)] == before
    assert [len(codes(side, EventCode.ROUTE_CONNECTED)) for side in (client, server)] == [1, 1]


def test_unsaved_changes_become_what_file_says(bridge: Bridge, tmp_path: Path) -> None:
    _, client = bridge.both(Topic("/chat", "transmit"))
    file = Edited(client, tmp_path / "robot1.yaml")
    with acting("anna (uid 1000, pid 1)"):
        client.add_topic(Topic("/extra", "receive", max_rate=2.0)).result(60)
        client.pause(route(client, "/chat").key, True).result(60)
    assert set(file.reload().changed) == {
        "/extra (receive): removed (it was {topic: /extra, direction: receive, max_rate: 2.0})",
        "/chat (transmit): paused true → false",
    }
    assert client.session.topics == (Topic("/chat", "transmit"),)


BAD_FILES = (
    ("name: robot1\nrole: client\ntopics: {", "robot1.yaml:3"),
    ("name: robot1\nrole: client\nserver_ip: 127.0.0.1\nserver_port: 5\nkey_file: none.key\n", "no such key file"),
    ("name: robot1\nrole: client\nserver_ip: 127.0.0.1\nserver_port: 0\nkey_file: robot1.key\n", "server_port"),
    (
        "name: robot2\nrole: client\nserver_ip: 127.0.0.1\nserver_port: 5\nkey_file: robot1.key\n",
        "name robot1 → robot2: that is another session; restart",
    ),
    ("", "no such file"),
)


def test_a_bad_file_changes_nothing(bridge: Bridge, tmp_path: Path) -> None:
    _, client = bridge.both(Topic("/chat", "transmit"))
    file = Edited(client, tmp_path / "robot1.yaml")
    before = client.session
    for number, (content, said) in enumerate(BAD_FILES, 1):
        if content:
            file.path.write_text(content)
        else:
            file.path.unlink()
        with pytest.raises(EngineError, match=said):
            client.reload().result(60)
        assert client.session == before
        failed = [event for event in client.events() if event.code == EventCode.ENGINE_RELOAD_FAILED]
        assert len(failed) == number
        assert failed[-1].level is Level.ERROR
        assert failed[-1].text.startswith("not reloaded, nothing is changed: ")
        assert "\n" not in failed[-1].text
    assert link(client).state == "ok"


def test_fixed_keys_are_told_the_rest_changes(bridge: Bridge, tmp_path: Path) -> None:
    _, client = bridge.both(Topic("/chat", "transmit"))
    file = Edited(client, tmp_path / "robot1.yaml")
    port, domain = client.session.server_port, client.session.domain_id
    reloaded = file.reload(server_port=port + 1, domain_id=100, topics=(), stale_after=3.0, shutdown_topic="/halt")
    assert reloaded.changed == (
        "stale_after 15.0 → 3.0",
        "shutdown_topic /shutdown → /halt",
        "/chat (transmit): removed (it was {topic: /chat, direction: transmit})",
    )
    assert [left.partition(":")[0] for left in reloaded.left] == [
        f"server_port {port} → {port + 1}",
        f"domain_id {domain} → 100",
    ]
    assert all(says(left, ChangeRefused.RESTART) for left in reloaded.left)
    assert (client.session.server_port, client.session.stale_after) == (port, 3.0)
    assert len(codes(client, EventCode.ENGINE_RELOAD_INCOMPLETE)) == 2
    assert file.reload().left == reloaded.left, "it is shown as long as it lasts"


def test_ports_and_shared_keys_are_shown_first(bridge: Bridge, tmp_path: Path) -> None:
    """A console that shows no difference reloads nothing."""
    server, _ = bridge.both()
    file = Edited(server, tmp_path / "pc.yaml")
    for key, value in (("ports", (bridge.port + 1,)), ("shared_keys", True)):
        shown = file.reload(dry_run=True, **{key: value}).changed
        assert [each.partition(" ")[0] for each in shown] == [key]
        assert file.reload().changed == shown
        assert getattr(server.session, key) == value


def test_clients_change_without_others_noticing(
    bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # a busy machine that stands still loses no link
    for name in ("robot2", "robot3", "new"):
        bridge.make_key(name)
    clients = (Client("robot1", key_file="robot1.key"), Client("robot2", key_file="robot2.key"))
    server = bridge.server(clients=clients, name="pc")
    file = Edited(server, tmp_path / "pc.yaml")
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    robot.publisher("/secret")
    first = bridge.client(Topic("/chat", "transmit"), Topic("/secret", "transmit"))
    second = bridge.client(name="robot2", key_file="robot2.key")
    third = bridge.client(name="robot3", key_file="robot3.key")
    eventually(lambda: linked(first) and linked(second, "robot2"))
    carries([out], server, ["/chat"])
    eventually(lambda: link(third, "robot3").cause == LinkCause.UNKNOWN_NAME)
    since = link(first).since

    reloaded = file.reload(
        clients=(
            Client("robot1", key_file="robot1.key", deny=("/secret",)),
            Client("robot3", key_file="robot3.key"),
        )
    )
    assert [change.partition(" (")[0] for change in reloaded.changed] == [
        "client robot1: deny [] → [/secret]: /secret may not cross any more",
        ClientStep.REMOVED_WHILE_LINKED(name="robot2"),
        next(change for change in reloaded.changed if change.startswith("client robot3: added, key ")),
    ]
    third.retry().result(60)
    eventually(lambda: linked(third, "robot3"))
    eventually(lambda: link(second, "robot2").cause == LinkCause.UNKNOWN_NAME)
    assert happened(second, EventCode.LINK_CLOSED_BY_PEER, "the server no longer accepts robot2")
    assert {each.name for each in server.snapshot().links} == {"robot1", "robot3"}
    assert find(server, "/secret") is None
    eventually(
        lambda: says(
            route(first, "/secret").reason, DeniedText.DENIED, owner="the server", use="/secret", peer="robot1"
        )
    )

    out.publish(text("still there"))
    heard(there, 1)
    assert link(first).since == since
    assert len(codes(first, EventCode.LINK_UP)) == 1

    file.reload(clients=(*file.session.listed_clients, Client("robot2", key_file="robot2.key")))
    second.retry().result(60)
    eventually(lambda: linked(second, "robot2"))
    assert link(first).since == since


def test_topics_that_a_server_proposes_follow_its_file(
    bridge: Bridge, pc: Domain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # a busy machine that stands still loses no link
    pc.publisher("/goal")
    robot1 = Client("robot1", key_file="robot1.key", topics=(Topic("/goal", "receive"), Topic("/old", "receive")))
    server = bridge.server(clients=(robot1,))
    client = bridge.client(allow=("/goal", "/old", "/new"))
    file = Edited(server, tmp_path / "pc.yaml")
    eventually(lambda: find(client, "/goal"))
    since = link(client).since
    topics = (Topic("/goal", "receive", max_rate=2.0), Topic("/new", "receive"))
    assert file.reload(clients=(msgspec.structs.replace(robot1, topics=topics),)).changed == (
        "client robot1: /old (receive): removed (it was {topic: /old, direction: receive})",
        "client robot1: /goal (receive): max_rate none → 2.0",
        "client robot1: /new (receive): added: {topic: /new, direction: receive}",
    )
    eventually(lambda: {each.topic for each in client.snapshot().routes} == {"/goal", "/new"})
    eventually(lambda: route(client, "/goal").spec.max_rate == 2.0)
    assert link(client).since == since
    assert server.session.clients == file.session.clients
    renamed = file.reload(use_name=True, clients=(msgspec.structs.replace(robot1, topics=topics[:1]),))
    assert len(renamed.changed) == 2
    eventually(lambda: {each.topic for each in server.snapshot().routes} == {"/robot1/goal"})
    assert server.session.clients == file.session.clients


def test_other_changes_wait_for_a_reload_that_runs(
    bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An operator's change while another one's file is being read is not undone by it."""
    client = bridge.client(*(Topic(name, "transmit") for name in ("/kept", "/edited", "/gone")))
    file = Edited(client, tmp_path / "robot1.yaml")
    keys = {name: route(client, name).key for name in ("/kept", "/edited", "/gone")}
    reads, may_read = threading.Event(), threading.Event()

    def held(path: Path) -> SessionFile:
        reads.set()
        assert may_read.wait(30.0)
        return load_file(path)

    replaced.ENGINE_LOAD.set(monkeypatch, held)
    reload = client.reload()
    assert reads.wait(30.0)
    others: tuple[Future[Any], ...] = (
        client.add_topic(Topic("/added", "transmit")),
        client.edit_topic(keys["/edited"], Topic("/edited", "transmit", max_rate=5.0)),
        client.pause(keys["/kept"], True),
        client.remove_topic(keys["/gone"]),
    )
    holds(lambda: not any(each.done() for each in others), 0.2)
    may_read.set()
    assert reload.result(60).changed == ()
    for each in others:
        each.result(60)
    assert client.session.topics == (
        Topic("/kept", "transmit", paused=True),
        Topic("/edited", "transmit", max_rate=5.0),
        Topic("/added", "transmit"),
    )
    assert file.session.topics != client.session.topics


def test_hung_disk_holds_up_changes_for_a_while(
    bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A late answer resumes nothing."""
    constants.ENGINE_READ_WITHIN.set(monkeypatch, 0.5)
    constants.OLD_AFTER.set(monkeypatch, 0.1)
    client = bridge.client(Topic("/kept", "transmit"), Topic("/held", "transmit", paused=True))
    file, answers = Edited(client, tmp_path / "robot1.yaml"), threading.Event()

    def hangs(path: Path) -> SessionFile:
        answers.wait()
        return load_file(path)

    replaced.ENGINE_LOAD.set(monkeypatch, hangs)
    reload = file.engine.reload()
    pausing = client.pause(route(client, "/kept").key, True)
    resuming = client.pause(route(client, "/held").key, False)
    for each, problem in ((reload, Unable.DISK_SILENT), (resuming, Unable.TOO_LATE)):
        with pytest.raises(EngineError, match=pattern(problem)):
            each.result(60)
    pausing.result(60)
    answers.set()
    assert all(topic.paused for topic in client.session.topics)


def test_reload_that_operator_has_seen_does_nothing_else(bridge: Bridge, tmp_path: Path) -> None:
    client = bridge.client(Topic("/a", "transmit"))
    file = Edited(client, tmp_path / "robot1.yaml")
    would = file.reload(dry_run=True, topics=(Topic("/a", "transmit", max_rate=5.0),))
    client.pause(route(client, "/a").key, True).result(60)
    with pytest.raises(EngineError, match=pattern(Unable.RELOADS_OTHER)):
        client.reload(seen=would.digest).result(60)
    assert route(client, "/a").spec.paused
    client.reload(seen=file.reload(dry_run=True).digest).result(60)
    assert route(client, "/a").spec == file.session.topics[0]


def test_a_session_in_no_file_is_not_reloaded(bridge: Bridge) -> None:
    server = bridge.server()
    with pytest.raises(EngineError, match=pattern(Unable.NO_FILE)):
        server.reload().result(60)


def assert_told(engine: Engine, whose: str, expected: list[tuple[str, str, str]]) -> None:
    """The log has what an operator of the other side has done, as the words of that side."""

    def told() -> list[tuple[str, str, str]]:
        return [(each.code, each.old, each.new) for each in engine.events() if each.who == whose]

    eventually(lambda: len(told()) >= len(expected), what=f"{expected} in {told()}")
    # a topic as the other side has proposed it says what the session file leaves to the defaults
    assert [code for code, _, _ in told()] == [code for code, _, _ in expected]
    for (_, old, new), (_, old_there, new_there) in zip(told(), expected, strict=True):
        assert (bool(old), bool(new)) == (bool(old_there), bool(new_there))
    assert all(each.from_peer for each in engine.events() if each.who == whose)


def test_operators_changes_are_recorded_with_both_values(bridge: Bridge) -> None:
    server, client = bridge.both()
    who = "anna (uid 1000, pid 7)"
    with acting(who):
        key = client.add_topic(Topic("/chat", "transmit")).result(60)
        eventually(lambda: find(server, "/chat"))
        client.edit_topic(key, Topic("/chat", "transmit", max_rate=5.0)).result(60)
        client.pause(key, True).result(60)
        client.pause(key, False).result(60)
        client.remove_topic(key).result(60)
        client.retry().result(60)
        client.stop_bridge().result(60)
    plain = "{topic: /chat, direction: transmit}"
    limited = "{topic: /chat, direction: transmit, max_rate: 5.0}"
    did = [event for event in client.events() if event.source == "operator"]
    assert {event.who for event in did} == {who}
    assert [(event.code, event.text, event.topic, event.old, event.new) for event in did] == [
        ("operator.added", f"/chat: added by {who}", "/chat", "", plain),
        ("operator.edited", f"/chat: changed (max_rate none → 5.0) by {who}", "/chat", plain, limited),
        ("operator.paused", f"/chat: paused by {who}", "/chat", "not paused", "paused"),
        ("operator.resumed", f"/chat: resumed by {who}", "/chat", "paused", "not paused"),
        ("operator.removed", f"/chat: removed by {who}", "/chat", limited, ""),
        ("operator.retried", f"tried again by {who}", "", "", ""),
        ("operator.stopped", f"stopped by {who}", "", "", ""),
    ]
    with acting("otto"):
        other = server.add_topic(Topic("/map", "transmit")).result(60)
        eventually(lambda: find(client, "/map"))
        server.pause(other, True).result(60)
    there = [
        ("operator.added", "", plain),
        ("operator.edited", plain, limited),
        ("operator.paused", "not paused", "paused"),
        ("operator.resumed", "paused", "not paused"),
        ("operator.removed", limited, ""),
    ]
    assert_told(server, f"robot1 says: {who}", there)
    plain = plain.replace("/chat", "/map")
    assert_told(
        client, "server says: otto", [("operator.added", "", plain), ("operator.paused", "not paused", "paused")]
    )
    assert "otto" in route(server, "/map").reason
    eventually(lambda: "server says: otto" in route(client, "/map").reason)
    with acting("otto"):
        server.edit_topic(other, Topic("/map", "transmit", compression="zstd")).result(60)
    eventually(lambda: [each for each in client.events() if each.code == "operator.edited" and each.from_peer])
    assert not [each for each in client.events() if each.code == "operator.removed" and each.from_peer]
    with acting(who):
        client.restart().result(60)
        client.shut_down().result(60)
    assert [event.code for event in client.events() if event.source == "operator"][-2:] == [
        "operator.restarted",
        "operator.shut_down",
    ]
