"""Engines on both sides of a bridge between two domains, and what one may ask of them."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakSet

import msgspec
from tests.support.inside import inside, is_running, outputs_of, renew_snapshot
from tests.support.participants import KnownNode, agree
from tests.support.ports import free_port
from tests.support.waiting import eventually
from tests.support.wording import has_text

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import load_file, save
from rsb_bridge.engine import Engine
from rsb_bridge.model.calls import FEEDBACK
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from enum import StrEnum
    from pathlib import Path

    from rclpy.publisher import Publisher
    from tests.support.domain import Domain, Listener
    from tests.support.offline import HalfT
    from tests.support.relay import Relay

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.snapshot import Event, Ledger, LinkSnapshot, Reloaded, RouteSnapshot, Snapshot
    from rsb_bridge.model.transports import Protocol
    from rsb_bridge.model.wording import Wording
    from rsb_bridge.ros.ros_interface import RosInterface
    from rsb_bridge.route.route import Route

STOPS_WITHIN = 15.0
THREADS = ("rsb-io", "ros", "rsb-history", "rsb-disk", "rsb-ring", "rsb-metrics", "rsb-on-fault")
"""Of an engine."""


class Bridge:
    """Makes engines: clients in the robot's domain, servers in the PC's. One key, one port, one name unless told.

    Attributes:
        folder: where key files are.
        expected: engines that fail inside, as their test wants them to.
    """

    started: ClassVar[WeakSet[Engine]] = WeakSet()
    """All engines of this process."""

    def __init__(self, folder: Path, robot: Domain, pc: Domain) -> None:
        self.folder = folder
        self.robot = robot
        self.pc = pc
        self.port = free_port()
        self.key_file = self.make_key("robot1")
        self._addresses = {"server": "127.0.0.1", "client": "127.0.0.1"}
        self._relay_port: int | None = None
        self._engines: list[Engine] = []
        self.expected: set[Engine] = set()
        self._present = {*threading.enumerate()}

    def move(self) -> None:
        """Have sessions from now on use another port."""
        self.port = free_port()

    def through(self, relay: Relay) -> None:
        """Have clients call a relay instead of the server."""
        self._addresses = {"server": relay.target[0], "client": relay.host}
        self._relay_port = relay.port

    def make_key(self, name: str) -> str:
        """A new key file."""
        path = self.folder / f"{name}.key"
        write_key(path)
        return path.name

    def secret(self) -> str:
        """Return the content of the key file that both sides use."""
        return (self.folder / self.key_file).read_text().strip()

    def server_session(self, **changes: Any) -> Session:
        return self._session("server", self.pc.id, changes)

    def client_session(self, *topics: Topic, **changes: Any) -> Session:
        return self._session("client", self.robot.id, {"topics": topics, **changes})

    def _session(self, role: str, domain_id: int, changes: dict[str, Any]) -> Session:
        common = {
            "name": "robot1",
            "role": role,
            "server_ip": self._addresses[role],
            "server_port": self.port if role == "server" else self._relay_port or self.port,
            "domain_id": domain_id,
            "key_file": self.key_file,
        }
        return Session(**{**common, **changes})

    def server(self, **changes: Any) -> Engine:
        return self.start(self.server_session(**changes))

    def client(self, *topics: Topic, **changes: Any) -> Engine:
        return self.start(self.client_session(*topics, **changes))

    def both(self, *topics: Topic, **changes: Any) -> tuple[Engine, Engine]:
        """A server and a client with these topics, linked; the changes are both sessions'."""
        server, client = self.server(**changes), self.client(*topics, **changes)
        eventually(lambda: linked(client) and linked(server), what="linked")
        return server, client

    def start(self, session: Session, ros: RosInterface | None = None, clock: Clock | None = None) -> Engine:
        known = KnownNode(session.domain_id or 0, session.name)
        engine = Engine(session, base=self.folder, ros=ros or known, clock=clock)
        self._engines.append(engine)
        self.started.add(engine)
        engine.start()
        return engine

    def close(self) -> None:
        """Stop all engines: in time, without ever having failed inside, and without a thread left a little later."""
        engines, self._engines = self._engines, []
        for engine in engines:
            began = time.monotonic()
            engine.stop()
            assert time.monotonic() - began < STOPS_WITHIN
        eventually(lambda: not _threads() - self._present, what="no thread of theirs")
        assert [
            event.text
            for engine in engines
            if engine not in self.expected
            for event in engine.events()
            if event.code == EventCode.ENGINE_ERROR
        ] == []


def _threads() -> set[threading.Thread]:
    return {each for each in threading.enumerate() if each.name in THREADS}


def protocol_of(topic: str) -> Protocol:
    """Return the protocol that a topic's name ends with, as in ``/tcp`` or ``/from_pc_udp``."""
    return "udp" if topic.endswith("udp") else "tcp"


def now(engine: EngineApi) -> Snapshot:
    """Return a new snapshot of an engine; the published one may be a second old."""
    asked = time.time()
    if isinstance(engine, Engine):
        renew_snapshot(engine)
    return eventually(lambda: new if (new := engine.snapshot()).time > asked or not new.running else None)


def link(engine: Engine, name: str = "robot1") -> LinkSnapshot:
    """An engine's link by its client's name."""
    return next(each for each in now(engine).links if each.name == name)


def linked(engine: Engine, name: str = "robot1") -> bool:
    """Whether that link is up, asked of itself: the snapshot may be a second behind."""
    return any(link.linked for link in inside(engine).role.links() if link.name == name)


def connections(engine: Engine, name: str = "robot1") -> int:
    """How many connections that link has had: one that drops may be back before anybody sees that it is down."""
    return next(link.connections for link in inside(engine).role.links() if link.name == name)


def _routes(engine: Engine) -> list[Route]:
    return [route for link in inside(engine).role.links() for route in tuple(link.routes.values())]


def is_accepted(engine: Engine, topic: str) -> bool:
    """Whether both sides have agreed on all routes of a topic; one to be armed is disarmed before that, too."""
    found = [route for route in _routes(engine) if route.local_topic == topic]
    return bool(found) and all(route.life.accepted for route in found)


def halves(engine: Engine, kind: type[HalfT]) -> list[HalfT]:
    return [route.half for route in _routes(engine) if isinstance(route.half, kind)]


def outgoing(engine: Engine, topic: str) -> Sender:
    """Return a topic's sender, whose counts are newer than the snapshot's."""
    return next(sender for sender in halves(engine, Sender) if sender.route.topic == topic)


def route(engine: EngineApi, topic: str) -> RouteSnapshot:
    """An engine's route by the topic's name on its side, once it is there: the peer proposes it when the link is up."""
    try:
        return eventually(lambda: find(engine, topic))
    except AssertionError:
        raise AssertionError(f"no route of {topic}: {[each.key for each in now(engine).routes]}") from None


def find(engine: EngineApi, topic: str) -> RouteSnapshot | None:
    """Return the same as `route`, or None if no route matches."""
    return next((each for each in now(engine).routes if each.topic == topic), None)


def says(engine: EngineApi, topic: str, *words: str) -> bool:
    """Whether a topic's reason has all these words; one that is refused is proposed again now and then."""
    found = find(engine, topic)
    return found is not None and all(each in found.reason for each in words)


def stage(engine: Engine, topic: str, name: str) -> bool | None:
    """Return whether a stage of a message's path is done, in both directions if the topic has two."""
    found = [
        each.done for route in now(engine).routes if route.topic == topic for each in route.stages if each.name == name
    ]
    return None if None in found or not found else all(found)


def carries(publishers: Iterable[Publisher], receiver: Engine, topics: Iterable[str]) -> None:
    """Wait until nothing that is published would miss the listeners.

    Args:
        publishers: in the sending domain, one a topic.
        topics: their names on its side; somebody listens to each.
    """
    from tests.support.domain import Domain

    publishers, topics = tuple(publishers), set(topics)
    eventually(lambda: opened(receiver) >= topics, what="open on both sides")
    domain_id = now(receiver).domain_id
    near = {(each.id, one.topic_name) for each in Domain.joined for one in publishers if one in {*each.node.publishers}}
    for known in near | {(domain_id, topic) for topic in topics}:
        eventually(lambda known=known: agree(*known), what=f"all know the endpoints of {known}")
    eventually(lambda: all(each.get_subscription_count() for each in publishers), what="subscribed")
    eventually(lambda: listened_to(receiver) >= topics, what="heard by the listeners")
    listeners = [each for domain in Domain.joined if domain.id == domain_id for each in domain.listeners]
    for topic in topics & {each.topic for each in listeners}:
        there = [each for each in listeners if each.topic == topic]
        eventually(lambda there=there: any(each.matched for each in there), what="a listener knows who publishes")


def opened(receiver: Engine) -> set[str]:
    """The topics that an engine publishes, and that the other side sends it in the same opening of their route.

    A side that has lost a route's channel closes it a moment before the other one hears of that.
    """
    found = set()
    for half in halves(receiver, Receiver):
        if half.route.connected:
            senders = _senders(receiver, half.route)
            if not senders or any(each.route.id == half.route.id and each.subscription.receives for each in senders):
                found.add(half.route.remote_topic)
    return found


def _senders(receiver: Engine, route: Route) -> list[Sender]:
    """Return a route's halves on the other side, or none if that is another process."""
    others = [each for each in Bridge.started if each is not receiver and is_running(each)]
    names = route.peer.name, route.topic, route.remote_topic
    return [
        half
        for other in others
        for half in halves(other, Sender)
        if (half.route.peer.name, half.route.topic, half.route.remote_topic) == names
    ]


def listened_to(engine: Engine) -> set[str]:
    """The topics that an engine publishes to somebody, asked of the publishers: the snapshot may be 1 s behind."""
    receivers = halves(engine, Receiver)
    return {each.route.remote_topic for each in receivers if outputs_of(each).subscriber_count}


def listeners(engine: Engine, topic: str) -> int:
    """How many subscriptions get what an engine publishes: a subscription may know of the publisher before that."""
    return sum(
        outputs_of(each).subscriber_count for each in halves(engine, Receiver) if each.route.remote_topic == topic
    )


def feedback_listeners(engine: Engine) -> int:
    """Return the number of listeners to the feedback of the only action that an engine offers."""
    (found,) = (half for half in halves(engine, Caller) if half.route.proposal.kind == "action")
    offered = found.offer.lanes.topics.get(FEEDBACK)
    return offered.publisher.subscriber_count if offered else 0


def reloaded(engine: Engine, path: Path, **changes: object) -> Reloaded:
    """Change the session file of an engine that runs, and have it read again."""
    if path.exists():
        opened = load_file(path)
        save(msgspec.structs.replace(opened.session, **changes), path, opened)
    else:
        save(msgspec.structs.replace(engine.session, **changes), path)
    engine.use_file(path)
    return engine.reload().result(60)


def settled(engine: Engine, topic: str, offered: int, delivered: Callable[[], int] | None = None) -> Ledger:
    """Wait until the ledger of a topic has so many messages offered, or lost in DDS before, and none in flight.

    Args:
        delivered: how many of a lossy topic arrive; those that take more than 2 s count as lost until then.
    """

    def done() -> Ledger | None:
        ledger = route(engine, topic).ledger
        is_done = ledger.offered + ledger.lost_in_dds == offered and not ledger.open
        return ledger if is_done and (delivered is None or ledger.delivered == delivered()) else None

    try:
        return eventually(done)
    except AssertionError:
        raise AssertionError(f"not settled: {route(engine, topic).ledger}, {offered} were offered") from None


def balance(ledger: Ledger) -> int:
    """Return the sum of a ledger's parts."""
    settled = ledger.delivered + ledger.throttled + ledger.dropped_total + ledger.expired
    return settled + ledger.unknown + ledger.open


def happened(engine: Engine, code: StrEnum, about: str | Wording = "", **parameters: object) -> Event | None:
    """The newest event of a kind; with `about`, the newest that has these words in it, or the text of a table."""
    for event in reversed(engine.events()):
        if event.code == code and has_text(event.text, about, **parameters):
            return event
    return None


def heard(listener: Listener, count: int, within: float = 180.0) -> list[bytes]:
    """Wait until a listener has heard so many messages."""
    eventually(lambda: len(listener.payloads) >= count, within, f"{count} messages")
    return listener.payloads
