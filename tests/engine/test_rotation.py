"""A client's key is replaced while both the old and the new one are valid, and then the old one opens nothing."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest
from tests.engine.reloading_helpers import Edited, codes
from tests.support.bridge import carries, happened, heard, link, linked
from tests.support.domain import BEST_EFFORT, text
from tests.support.frames import write_frame
from tests.support.rogue import Rogue
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import KeyFileProblem, fingerprint, read_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.wire.connection import ClientConnection
from rsb_bridge.wire.events import RefusalCode, StreamRefused
from rsb_bridge.wire.messages import Hello, Ping
from rsb_bridge.wire.preamble import RefusalText
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.wire.events import Event

OLD, BOTH, NEW = (Client("robot1", "old.key"), Client("robot1", "old.key", "new.key"), Client("robot1", "new.key"))
STRING = ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")


@pytest.fixture
def marks(bridge: Bridge) -> tuple[str, str]:
    """The fingerprints of the old and the new key, whose files are there; the robot's is a copy of the old one."""
    for name in ("old", "new", "robot2"):
        bridge.make_key(name)
    copy(bridge, "old.key")
    old, new = (fingerprint(read_key(bridge.folder / f"{name}.key")) for name in ("old", "new"))
    return old, new


def copy(bridge: Bridge, key_file: str) -> None:
    """Put a key in the place of the robot's."""
    (bridge.folder / "robot.key").write_bytes((bridge.folder / key_file).read_bytes())


def shown(engine: Engine) -> tuple[str, str]:
    """The fingerprints that operators see of the link: of the key in use, and of the next one."""
    now = link(engine)
    return now.fingerprint, now.next_fingerprint


def is_closed(stream: socket.socket) -> bool:
    """Whether the server has closed a stream; waits for what it says."""
    try:
        return not stream.recv(4096)
    except ConnectionResetError:
        return True


def refusal(port: int, key: bytes) -> RefusalCode:
    """Return a server's refusal of a client with a key."""
    connection = ClientConnection(Hello("0.1.0", "robot1", "again", 0), key, CipherSuite.AESGCM)
    with socket.create_connection(("127.0.0.1", port), timeout=60) as stream:
        stream.sendall(connection.start())
        events: list[Event] = []
        while not events and (data := stream.recv(4096)):
            events = connection.receive_data(data)
            stream.sendall(connection.data_to_send())
    (event,) = events
    assert isinstance(event, StreamRefused)
    return event.code


def test_a_key_is_replaced_while_the_link_stays(
    bridge: Bridge, robot: Domain, pc: Domain, marks: tuple[str, str]
) -> None:
    """It connects again once, when the robot takes the new key."""
    old, new = marks
    server = bridge.server(name="pc", clients=(OLD,))
    client = bridge.client(Topic("/chat", "transmit"), key_file="robot.key")
    there, here = Edited(server, bridge.folder / "pc.yaml"), Edited(client, bridge.folder / "robot1.yaml")
    heard_there, out = pc.listener("/chat"), robot.publisher("/chat")
    carries([out], server, ["/chat"])
    since = link(server).since

    assert there.reload(clients=(BOTH,)).changed == (f"client robot1: next key none → {new}",)
    assert shown(server) == (old, new)
    assert shown(client) == (old, "")
    out.publish(text("with the old key"))
    heard(heard_there, 1)
    assert link(server).since == since

    copy(bridge, "new.key")
    assert len(here.reload().changed) == 1
    eventually(lambda: linked(client) and shown(server) == (new, new))
    assert shown(client) == (new, "")
    assert [event.new for event in server.events() if event.code == EventCode.KEY_USED] == [new]
    carries([out], server, ["/chat"])
    out.publish(text("with the new key"))
    heard(heard_there, 2)
    assert len(codes(server, EventCode.LINK_UP)) == len(codes(client, EventCode.LINK_UP)) == 2
    since = link(server).since

    would = there.reload(dry_run=True, clients=(NEW,))
    assert would.changed == (f"client robot1: key {old} → {new}, next key {new} → none",)
    assert there.reload() == would
    assert shown(server) == (new, "")
    assert link(server).since == since
    assert codes(client, EventCode.LINK_REFUSED) == codes(server, EventCode.LINK_WRONG_KEY) == []

    copy(bridge, "old.key")
    here.reload()
    differ = RefusalText.KEYS_DIFFER(name="robot1", theirs=old, there="client", ours=new, here="server")
    eventually(lambda: happened(client, EventCode.LINK_REFUSED, differ) and happened(server, EventCode.LINK_WRONG_KEY))
    assert shown(server) == (new, "")


@pytest.mark.parametrize(
    ("used", "before", "after"),
    [("old.key", BOTH, NEW), ("new.key", BOTH, OLD), ("old.key", OLD, NEW)],
    ids=["the old one is given up", "the next one is withdrawn", "replaced at once"],
)
def test_link_with_invalid_key_ends_at_once(
    used: str, before: Client, after: Client, bridge: Bridge, marks: tuple[str, str]
) -> None:
    copy(bridge, used)
    server = bridge.server(name="pc", clients=(before,))
    client = bridge.client(key_file="robot.key")
    eventually(lambda: linked(client) and linked(server))
    (change,) = Edited(server, bridge.folder / "pc.yaml").reload(clients=(after,)).changed
    assert "its link is closed" in change
    assert not linked(server), "at once"
    assert happened(server, EventCode.LINK_CLOSED, "another key for robot1")
    eventually(lambda: happened(client, EventCode.LINK_CLOSED_BY_PEER, "another key for robot1"))
    eventually(lambda: happened(client, EventCode.LINK_REFUSED, " differ: "))
    assert codes(client, EventCode.LINK_UP)[1:] == []


def test_who_has_neither_key_reads_of_both(bridge: Bridge, marks: tuple[str, str]) -> None:
    server = bridge.server(name="pc", clients=(BOTH,))
    client = bridge.client(key_file="robot2.key")
    words = f"{link(client).fingerprint} on the client, {marks[0]} or {marks[1]} on the server"
    eventually(lambda: happened(client, EventCode.LINK_REFUSED, words))
    assert happened(server, EventCode.LINK_WRONG_KEY, words)
    assert not linked(server)


def _removed(server: Engine, _: Path) -> None:
    server.remove_client("robot1").result(60)


def _replaced(server: Engine, _: Path) -> None:
    server.change_client(NEW).result(60)


def _withdrawn(server: Engine, folder: Path) -> None:
    Edited(server, folder / "pc.yaml").reload(clients=(NEW, Client("robot2", "robot2.key")))


@pytest.mark.parametrize("end", [_removed, _replaced, _withdrawn])
def test_what_the_old_connection_still_sends_opens_nothing(
    end: Callable[[Engine, Path], None], bridge: Bridge, robot: Domain, pc: Domain, marks: tuple[str, str]
) -> None:
    """From somebody with the old key who does not go when told to, on the stream and the datagrams that were open."""
    server = bridge.server(name="pc", clients=(BOTH, Client("robot2", "robot2.key")))
    old = read_key(bridge.folder / "old.key").secret
    beats, out = pc.listener("/beat"), robot.publisher("/beat")
    bridge.client(Topic("/beat", "transmit"), name="robot2", key_file="robot2.key")
    carries([out], server, ["/beat"])
    theres = [pc.listener("/stream"), pc.listener("/datagrams", qos=BEST_EFFORT)]
    with Rogue(bridge.port, old) as rogue:
        stream, frames = rogue.stream(rogue.route("/stream", "tcp", Qos(), STRING))
        # It repeats nothing, so one lost datagram would hold back all later ones of a reliable topic.
        best_effort = Qos(reliability="best_effort")
        datagrams = rogue.datagrams(rogue.route("/datagrams", "udp", best_effort, STRING))

        def send() -> None:
            rogue.say(Ping(1, 0))  # discovery may take longer than a link without a word lasts
            rogue.probe()
            for datagram in datagrams.write(text("x"), 0, 0, 1400):
                rogue.udp.send(datagram)
            stream.sendall(write_frame(frames, text("x"), 0))

        def all_heard() -> bool:
            send()
            return all(there.payloads for there in theres)

        eventually(all_heard)
        end(server, bridge.folder)
        assert not linked(server)
        eventually(lambda: is_closed(stream), what="its stream is closed")
        for _ in range(20):
            rogue.probe()
            for datagram in datagrams.write(text("late"), 0, 0, 1400):
                rogue.udp.send(datagram)
        out.publish(text("another robot's"))
        heard(beats, 1)
        assert all(text("late") not in there.payloads for there in theres)
        assert refusal(bridge.port, old) in (RefusalCode.WRONG_KEY, RefusalCode.UNKNOWN_NAME)


def test_the_next_key_is_one_clients_only(bridge: Bridge, marks: tuple[str, str]) -> None:
    words = pattern(KeyFileProblem.ONE_KEY, names="robot1 and robot2")
    with pytest.raises(EngineError, match=words):
        bridge.server(name="pc", clients=(BOTH, Client("robot2", "new.key")))
    server = bridge.server(name="pc", clients=(OLD, Client("robot2", "new.key")))
    with pytest.raises(EngineError, match=words):
        server.change_client(BOTH).result(60)


def test_session_of_one_client_has_two_keys(bridge: Bridge, marks: tuple[str, str]) -> None:
    copy(bridge, "new.key")
    server = bridge.server(key_file="old.key", next_key_file="new.key")
    client = bridge.client(key_file="robot.key")
    eventually(lambda: linked(client) and linked(server))
    assert shown(server) == (marks[1], marks[1])
