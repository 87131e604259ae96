"""The engine stops in time with any peer, and leaves nothing behind."""

from __future__ import annotations

import gc
import signal
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.bridge import STOPS_WITHIN, carries, happened, link, linked, outgoing
from tests.support.domain import text
from tests.support.ports import taken
from tests.support.resources import resources, returns_to
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError, Unable
from rsb_bridge.engine import Engine
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.ros.node import RosNode
from rsb_bridge.transport.listening import ListenProblem

if TYPE_CHECKING:
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Programs
    from tests.support.relay import Relay


def stops(engine: Engine) -> None:
    """Stop it, in time; a second stop does nothing."""
    began = time.monotonic()
    engine.stop()
    engine.stop()
    assert time.monotonic() - began < STOPS_WITHIN
    assert not engine.snapshot().running


def test_the_peer_is_told(bridge: Bridge) -> None:
    server, client = bridge.both()
    stops(client)
    eventually(lambda: happened(server, EventCode.LINK_CLOSED_BY_PEER))
    again = bridge.client()
    eventually(lambda: linked(again))
    stops(server)
    eventually(lambda: happened(again, EventCode.LINK_CLOSED_BY_PEER))


def test_what_was_measured_ends_with_the_link(bridge: Bridge) -> None:
    server, client = bridge.both()
    eventually(lambda: None not in (link(client).rtt, link(client).clock_offset, link(client).clock_uncertainty))
    stops(server)
    eventually(lambda: not linked(client))
    over = link(client)
    assert over.state is not State.OK
    assert (over.rtt, over.clock_offset, over.clock_uncertainty) == (None, None, None)


@pytest.mark.parametrize("stopped", ["server", "client"])
def test_a_peer_that_is_frozen(
    stopped: str, bridge: Bridge, programs: Programs, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGSTOP, with messages that wait for it in queues and sockets."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)  # the link is up however long its queues take to be full
    topic = Topic("/chat", "transmit" if stopped == "server" else "receive", type="String", qos=10)
    near, far = (robot, pc) if stopped == "server" else (pc, robot)
    there, out = far.listener("/chat"), near.publisher("/chat")
    sessions = {"server": bridge.server_session(), "client": bridge.client_session(topic)}
    peer = programs.start(sessions[stopped])
    engine = bridge.start(sessions["client" if stopped == "server" else "server"])

    def crosses() -> bool:
        out.publish(text("hello"))
        time.sleep(0.02)
        return bool(there.payloads)

    eventually(crosses)
    peer.signal(signal.SIGSTOP)

    def full() -> bool:
        """Whether its queue is full: a snapshot's ledger may come after the link's end."""
        for _ in range(10):
            out.publish(text("x" * 500_000))
        # The cause depends on the machine: from a second of silence on, what is dropped counts as an outage.
        return any(outgoing(engine, "/chat").counts.dropped.values())

    eventually(full)
    assert linked(engine)
    stops(engine)


def test_a_line_that_is_stalled(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    there, out = pc.listener("/chat"), robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    carries([out], server, ["/chat"])
    relay.stall()
    for _ in range(20):
        out.publish(text("x" * 500_000))
    stops(client)
    stops(server)
    assert len(there.payloads) < 20


def test_while_calling(bridge: Bridge) -> None:
    """Somebody accepts the connection and says nothing; nobody takes it at all."""
    with socket.create_server(("127.0.0.1", bridge.port), backlog=1) as silent:
        client = bridge.client()
        connection, _ = silent.accept()
        stops(client)
        connection.close()
        fillers = [socket.socket() for _ in range(4)]
        for filler in fillers:
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", bridge.port))
        other = bridge.client()
        eventually(lambda: happened(other, EventCode.LINK_CONNECTING))
        stops(other)
        for filler in fillers:
            filler.close()


def succeeded(command: Future[None]) -> bool:
    return command.done() and command.exception() is None


def test_commands_meanwhile(bridge: Bridge) -> None:
    """Each of them is done or refused, and none of that is an internal error."""
    for _ in range(2):
        server = bridge.server()
        commands: list[Future[None]] = [server.restart()]
        stopped = threading.Event()

        def give(engine: Engine, given: list[Future[None]], until: threading.Event) -> None:
            while not until.wait(0.0002):
                given += [engine.retry(), engine.pause("none", True)]

        with ThreadPoolExecutor(2) as threads:
            giving = [threads.submit(give, server, commands, stopped) for _ in range(2)]
            try:
                eventually(lambda commands=commands: any(succeeded(each) for each in tuple(commands)))
                stops(server)
            finally:
                stopped.set()
        assert [thread.exception() for thread in giving] == [None, None]
        done, left = wait(commands, 60)
        assert not left
        assert not any(command.cancelled() for command in done)
        assert {type(command.exception()) for command in done} == {type(None), EngineError}
        assert not happened(server, EventCode.ENGINE_ERROR)


def test_a_restart_that_waits_fails(bridge: Bridge) -> None:
    """For a server that is not there."""
    client = bridge.client()
    restart = client.restart()
    assert not wait([restart], 0.3).done
    stops(client)
    with pytest.raises(EngineError, match=pattern(Unable.NOT_RUNNING)):
        restart.result(0)


def test_nothing_is_left(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Threads and descriptors after three more bridges are what they were after the first; ports are free at once."""
    port = bridge.port
    topics = (
        Topic("/tcp", "transmit", type="String", qos="default"),
        Topic("/udp", "receive", type="String", qos="default", protocol="udp"),
    )

    def once() -> None:
        server, client = bridge.both(*topics)
        eventually(
            lambda: all(r.state != "down" and r.type_hash for e in (server, client) for r in e.snapshot().routes)
        )
        stops(client)
        stops(server)
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
            with socket.socket(type=kind) as free:
                free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                free.bind(("127.0.0.1", port))

    once()
    before = resources()
    for _ in range(3):
        once()
    gc.collect()
    returns_to(before)


class Waiting(RosNode):
    """A node that has joined its domain, and whose start returns only when the test lets it."""

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "waiting")
        self.joined = threading.Event()
        self.may_return = threading.Event()

    def start(self) -> None:
        super().start()
        self.joined.set()
        assert self.may_return.wait(60)


def test_a_stop_while_it_starts_wins(bridge: Bridge, robot: Domain) -> None:
    """No thread, port or node is left, and it cannot be started any more."""
    ros = Waiting(robot.id)
    session = bridge.client_session()
    engine = Engine(session, base=bridge.folder, ros=ros)
    with ThreadPoolExecutor(2) as threads:
        starting = threads.submit(engine.start)
        assert ros.joined.wait(60)
        stopping = threads.submit(engine.stop)
        eventually(lambda: engine._stop_wanted)
        ros.may_return.set()
        with pytest.raises(EngineError, match=pattern(Unable.STOPPED_BEFORE_START)):
            starting.result(60)
        stopping.result(60)
    assert not engine.snapshot().running
    eventually(lambda: not [each for each in threading.enumerate() if each.name in ("rsb-io", "ros")])
    with pytest.raises(EngineError, match=pattern(Unable.STOPPED_BEFORE_START)):
        engine.start()


def test_stop_does_not_wait_for_start_that_hangs(bridge: Bridge, robot: Domain) -> None:
    """The start cleans up when it returns."""
    ros = Waiting(robot.id)
    engine = Engine(bridge.client_session(), base=bridge.folder, ros=ros)
    with ThreadPoolExecutor(1) as threads:
        starting = threads.submit(engine.start)
        assert ros.joined.wait(60)
        engine.stop(timeout=0.1)
        assert not starting.done()
        ros.may_return.set()
        with pytest.raises(EngineError, match=pattern(Unable.STOPPED_BEFORE_START)):
            starting.result(60)
    eventually(lambda: not [each for each in threading.enumerate() if each.name in ("rsb-io", "ros")])


def test_a_start_that_fails_leaves_nothing(bridge: Bridge) -> None:
    before = resources()
    with taken(bridge.port, socket.SOCK_DGRAM):
        for _ in range(3):
            with pytest.raises(EngineError, match=pattern(ListenProblem.TAKEN)):
                bridge.server()
    gc.collect()
    returns_to(before)
