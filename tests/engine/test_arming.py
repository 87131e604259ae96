"""Topics that have to be armed, between two real domains: what crosses, and what never does."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace
from std_srvs.srv import SetBool
from tests.engine.arming_helpers import COMMANDS, both_armed, is_set_up
from tests.support import constants, replaced
from tests.support.bridge import balance, carries, happened, heard, linked, route
from tests.support.domain import LATCHED, RELIABLE, text
from tests.support.inside import inside
from tests.support.long import long_cases
from tests.support.relay import TCP
from tests.support.waiting import eventually, holds

from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.receiver import Receiver

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Domain, Listener
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.ros.node import RosNode

__all__ = ["both_armed"]


def armed(*engines: Engine) -> list[bool]:
    found = [route(engine, "/cmd").arming for engine in engines]
    return [each is not None and each.armed for each in found]


def disarmings(engine: Engine) -> int:
    """Return how often its log has that an operator disarmed."""
    return sum(each.code == EventCode.OPERATOR_DISARMED for each in engine.events())


def published(engine: Engine) -> int:
    """How many messages it has published of the opening that was armed, which is over."""
    (found,) = [each for link in inside(engine).role.links() for each in tuple(link.routes.values())]
    assert isinstance(found.half, Receiver)
    before = found.half._before
    return before[1].delivered if before else 0


def publish_for(out: Publisher, words: str, done: Callable[[], object]) -> None:
    """Publish on until something has come of it."""

    def once_more() -> object:
        out.publish(text(words))
        return done()

    eventually(once_more)


def publish_until_heard(out: Publisher, words: str, listener: Listener) -> None:
    publish_for(out, words, lambda: words in listener.texts(100))


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize(
    ("protocol", "operator"), [("tcp", "server"), ("udp", "client"), *long_cases(("tcp", "client"), ("udp", "server"))]
)
def test_nothing_crosses_until_it_is_armed_nor_after(
    protocol: str, operator: str, bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    topic = Topic("/cmd", "receive", protocol="udp" if protocol == "udp" else "tcp", arm=True, deadman=0.0)
    server, client = bridge.both(topic)
    engine = client if operator == "client" else server
    eventually(lambda: is_set_up(server, client))
    for _ in range(20):
        joystick.publish(text("before"))
    holds(lambda: not motors.payloads and not joystick.get_subscription_count(), 0.5)

    for number, words in enumerate(("first", "second")):
        consoles.arm(engine)
        assert armed(server, client) == [True, True]
        publish_until_heard(joystick, words, motors)
        engine.disarm(route(engine, "/cmd").key).result(30)
        assert armed(engine) == [False]
        eventually(lambda: is_set_up(server, client))
        for _ in range(20):
            joystick.publish(text("while it is disarmed"))
        for side in (server, client):
            eventually(lambda side=side, count=number + 1: disarmings(side) == count)
    holds(lambda: not {"before", "while it is disarmed"} & set(motors.texts(1000)), 0.5)
    ledger = eventually(lambda: ledger if not (ledger := route(server, "/cmd").ledger).open else None)
    assert balance(ledger) == ledger.offered


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize(
    ("protocol", "compression"), [("tcp", "none"), ("udp", "zstd"), *long_cases(("tcp", "zstd"), ("udp", "none"))]
)
def test_what_is_armed_crosses_unchanged(
    protocol: str, compression: str, bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    """In one piece, and in many."""
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    topic = Topic("/cmd", "receive", protocol="udp" if protocol == "udp" else "tcp", arm=True, deadman=0.0)
    server, client = bridge.both(replace(topic, compression="zstd" if compression == "zstd" else "none"))
    eventually(lambda: is_set_up(server, client))
    consoles.arm(client)
    for words in ("short", "long " * 200_000):
        publish_until_heard(joystick, words, motors)


def test_messages_before_disarming_reach_no_robot_later(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The network holds the commands back, and releases them when both sides are armed again."""
    # The lease does not end while they are held, however long that takes.
    constants.LEASE_GIVEN_UP_AFTER.set(monkeypatch, 60.0)
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    server, client = bridge.both(COMMANDS)
    eventually(lambda: is_set_up(server, client))
    consoles.arm(server)
    carries([joystick], client, ["/cmd"])
    relay.stall()
    for _ in range(50):
        joystick.publish(text("old"))
    eventually(lambda: route(server, "/cmd").ledger.offered >= 50)
    server.disarm(route(server, "/cmd").key).result(30)
    relay.stall(False)
    eventually(lambda: is_set_up(server, client) and linked(client))
    # What arrived before its sender's word that it is disarmed was armed on both sides; DDS may still be delivering it.
    crossed = published(client)
    eventually(lambda: len(motors.payloads) == crossed)
    consoles.arm(server)
    publish_until_heard(joystick, "new", motors)
    assert set(motors.texts(1000)[crossed:]) == {"new"}
    ledger = eventually(lambda: ledger if not (ledger := route(server, "/cmd").ledger).open else None)
    lost = ledger.dropped.get("disarmed", 0) + ledger.dropped.get("link lost", 0)  # a slow machine may lose the link
    assert lost + crossed == 50
    assert balance(ledger) == ledger.offered


@pytest.mark.usefixtures("long_lease")
def test_latched_history_does_not_cross_on_arming(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    motors, planner = robot.listener("/cmd"), pc.publisher("/cmd", qos=LATCHED)
    planner.publish(text("latched long ago"))
    server, client = bridge.both(COMMANDS)
    eventually(lambda: is_set_up(server, client))
    consoles.arm(client)
    carries([planner], client, ["/cmd"])
    holds(lambda: not motors.payloads, 0.5)
    planner.publish(text("now"))
    assert heard(motors, 1) == [text("now")]
    client.disarm(route(client, "/cmd").key).result(30)
    late = robot.listener("/cmd", qos=RELIABLE)
    holds(lambda: not late.payloads, 0.5)


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize("what", ["pause", "remove"])
def test_disarming_ends_once_nothing_is_published(what: str, both_armed: tuple[Engine, Engine], relay: Relay) -> None:
    """The network holds back the sent messages and the disarming."""
    server, _ = both_armed
    key = route(server, "/cmd").key
    (link,) = inside(server).role.links()
    half, lease = link.routes[key], link.table.arming.lease.state
    relay.stall(new=True)
    began = time.monotonic()  # first: this thread may stand still before it looks
    may_be_published = lease.left
    (server.pause(key, True) if what == "pause" else server.remove_topic(key)).result(30)
    assert 0.0 < may_be_published <= time.monotonic() - began
    assert not half.settling.under_way


@pytest.mark.usefixtures("long_lease")
def test_armed_udp_does_not_wait_for_tcp(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link that loses packets may hold a stream up for seconds; lease and disarm cross as datagrams, too."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    server, client = bridge.both(replace(COMMANDS, protocol="udp"))
    eventually(lambda: is_set_up(server, client))
    consoles.arm(server)
    publish_until_heard(joystick, "before", motors)
    relay.hold(TCP)
    holds(lambda: armed(server, client) == [True, True], 1.2 * constants.LEASE_LASTS.value)
    publish_until_heard(joystick, "while TCP stands", motors)
    disarming = server.disarm(route(server, "/cmd").key)
    eventually(lambda: armed(client) == [False])
    relay.release(TCP)
    disarming.result(30)
    eventually(lambda: is_set_up(server, client))


@pytest.mark.usefixtures("long_lease")
def test_a_restart_and_a_reload_disarm(both_armed: tuple[Engine, Engine], bridge: Bridge, consoles: Consoles) -> None:
    server, client = both_armed
    path = bridge.folder / "server.yaml"
    save(server.session, path)
    server.use_file(path)
    server.reload(dry_run=True).result(30)
    assert armed(server, client) == [True, True]
    server.reload().result(30)
    assert armed(server) == [False]
    assert (event := happened(client, EventCode.ROUTE_DISARMED)) is None or event.cause == Disarmed.RELOADED
    eventually(lambda: is_set_up(server, client))
    consoles.arm(server)
    client.restart().result(60)
    eventually(lambda: is_set_up(server, client))


def test_robot_publishes_no_unarmed_message_of_peer(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The control PC's bridge is made to hold everything for armed."""
    motors, joystick = robot.listener("/cmd"), pc.publisher("/cmd")
    server, client = bridge.both(COMMANDS)
    eventually(lambda: is_set_up(server, client))
    (liar,) = [each for link in inside(server).role.links() for each in tuple(link.routes.values())]
    truth = replaced.ARMING_CROSSING.value

    def lie(arming: Any, now: float) -> Crossing:
        return Crossing.YES if arming is liar.arming else truth(arming, now)

    replaced.ARMING_CROSSING.set(monkeypatch, lie)
    inside(server).context.call(liar.advance)
    publish_for(joystick, "forged", lambda: route(client, "/cmd").ledger.dropped.get("disarmed", 0) >= 5)
    assert not motors.payloads


@pytest.mark.usefixtures("long_lease")
def test_first_loaded_type_does_not_end_lease(
    bridge: Bridge, robot: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A type is loaded for the first time in a process: NumPy comes with it, from a slow disk."""
    lasts = constants.LEASE_LASTS.value
    loaded, original = set(), replaced.INSTALLED_SERVICE_HASH.value

    def load(node: RosNode, type_name: str) -> str | None:
        if node not in loaded:
            loaded.add(node)
            time.sleep(1.2 * lasts)
        found: str | None = original(node, type_name)
        return found

    replaced.INSTALLED_SERVICE_HASH.set(monkeypatch, load)
    robot.node.create_service(SetBool, "/home", lambda _, answer: answer)
    server, client = bridge.both(Topic("/home", "receive", kind="service", arm=True, deadman=0.0))
    eventually(lambda: all(route(each, "/home").state == "disarmed" for each in (server, client)))
    consoles.arm(server, "/home")

    def stay_armed() -> bool:
        found = [route(each, "/home").arming for each in (server, client)]
        return all(each is not None and each.armed for each in found)

    eventually(lambda: len(loaded) == 2 or not stay_armed())
    holds(stay_armed, 1.5 * lasts)
