"""Messages that operators publish by hand: what they reach, what is refused, what is recorded."""

from __future__ import annotations

import contextlib
import itertools
import time
from threading import Event
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from msgspec.structs import replace
from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from tests.support import constants
from tests.support.bridge import balance, carries, happened, is_accepted, now, protocol_of, route
from tests.support.domain import BEST_EFFORT, LATCHED, RELIABLE, Domain, text
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import (
    ActingOperator,
    PauseTopics,
    ReleaseArmed,
    RemoveTopic,
    Restart,
    ShutDownLinks,
    acting,
    on_console,
)
from rsb_bridge.model.session import ArmedName, Client, Topic
from rsb_extras.driving.landing import Landing, LandingText
from rsb_extras.driving.publish_requests import Draft, DraftMessage, Publish
from rsb_extras.driving.publishing import AT_ONCE, TOPICS, PublishProblem
from rsb_extras.driving.tests import driving_places
from rsb_extras.driving.tests.publishing_helpers import (
    DRIVEN,
    STRING,
    TWIST,
    TWIST_STAMPED,
    can_be_armed,
    drive,
    driven,
    of,
    publish,
    speeds,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.consoles import Consoles
    from tests.support.domain import Listener
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.wording import Wording
    from rsb_extras.driving.publish_requests import Published

POSE = "geometry_msgs/msg/PoseStamped"


def give(engine: Engine, topic: str, fields: str, type_name: str = "", ticket: int = 0) -> Future[Published]:
    return engine.do(Publish(topic, fields, type_name, ticket))


def draft(engine: Engine, topic: str, type_name: str = "") -> Draft:
    return engine.do(DraftMessage(topic, type_name)).result(30)


def armed(engine: Engine) -> bool:
    found = route(engine, "/cmd").arming
    return found is not None and found.armed


# --- what it reaches


@pytest.mark.usefixtures("patient")
def test_nodes_of_this_side_get_it(bridge: Bridge, robot: Domain) -> None:
    """The first message already, with any QoS that they ask for."""
    listeners = {"/reliable": RELIABLE, "/best_effort": BEST_EFFORT, "/latched": LATCHED}
    heard = {topic: robot.listener(topic, qos=qos) for topic, qos in listeners.items()}
    client = bridge.client()
    for topic, listener in heard.items():
        published = publish(client, "data: here", topic)
        assert (published.type_name, published.audience.count, published.links) == (STRING, 1, ())
        if listeners[topic] is BEST_EFFORT:  # it misses what comes before it has heard of the publisher
            eventually(lambda listener=listener: listener.matched)
            publish(client, "data: again", topic)
            eventually(lambda listener=listener: listener.texts(10) in (["here", "again"], ["again"]))
        else:
            eventually(lambda listener=listener: listener.texts(10) == ["here"])


@pytest.mark.usefixtures("patient")
def test_routes_take_it_like_a_nodes_message(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """The first message, too, although a route opens only when it has a publisher."""
    names = ("/tcp", "/udp", "/used_tcp", "/used_udp")
    heard = {name: pc.listener(name) for name in names}
    server, client = bridge.both(*(Topic(name, "transmit", protocol=protocol_of(name)) for name in names))
    used = [robot.publisher(name) for name in names[2:]]
    carries(used, server, names[2:])
    for each in used:
        robot.node.destroy_publisher(each)
    for name in names:
        published = publish(client, "data: by hand", name, type_name="" if "used" in name else STRING)
        assert published.links == ("robot1",)
        eventually(lambda name=name: "by hand" in heard[name].texts(100))
        ledger = eventually(lambda name=name: each if not (each := route(client, name).ledger).open else None)
        assert balance(ledger) == ledger.offered
    assert server.session.clients is None


@pytest.mark.usefixtures("patient")
def test_a_route_stays_as_its_nodes_have_it(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Latched, or best effort though nodes of this side hear the message reliably."""
    publisher, kept = robot.publisher("/latched", qos=LATCHED), pc.listener("/latched", qos=LATCHED)
    robot.publisher("/best_effort", qos=BEST_EFFORT)
    reliable = robot.listener("/best_effort", qos=RELIABLE)
    pc.listener("/best_effort", qos=BEST_EFFORT)
    publisher.publish(text("kept"))
    server, client = bridge.both(Topic("/latched", "transmit"), Topic("/best_effort", "transmit"))
    eventually(lambda: kept.texts(1) == ["kept"])
    before = eventually(lambda: route(client, "/best_effort").qos)
    assert publish(client, "data: by hand", "/best_effort").links == ("robot1",)
    eventually(lambda: reliable.texts(1) == ["by hand"])
    assert route(client, "/best_effort").qos == before
    publish(client, "data: by hand", "/latched")
    late = pc.listener("/latched", qos=QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    eventually(lambda: {"kept", "by hand"} <= set(late.texts(10)))
    assert (found := route(server, "/latched").qos) is not None
    assert found.latched


@pytest.mark.usefixtures("patient")
def test_many_come_in_order_operators_recorded_once(bridge: Bridge, pc: Domain) -> None:
    """The last arrives; of those before it, DDS keeps 10 for a subscription whose process gets no time."""
    listener = pc.listener("/text")
    server, client = bridge.both(Topic("/text", "transmit"))
    for number in range(50):
        with acting("ben" if number % 2 else "anna"):
            publish(client, f"data: '{number}'", "/text", type_name=STRING)
    eventually(lambda: "49" in listener.texts(100))
    heard = [int(each) for each in listener.texts(100)]
    assert heard == sorted(set(heard))
    recorded = [("/text", "anna", "data: '0'"), ("/text", "ben", "data: '1'")]
    assert of(client, EventCode.OPERATOR_PUBLISHED) == recorded
    there = eventually(lambda: found if len(found := of(server, EventCode.OPERATOR_PUBLISHED)) == 2 else None)
    assert [(topic, new) for topic, _, new in there] == [(topic, new) for topic, _, new in recorded]
    assert all("robot1" in who for _, who, _ in there)
    assert not happened(server, EventCode.OPERATOR_CALLED)


def test_a_publisher_that_is_not_used_is_closed(bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch) -> None:
    driving_places.ENDS_AFTER.set(monkeypatch, 100.0)
    listener = robot.listener("/text")
    client = bridge.client()
    publish(client, "data: a", "/text")
    publish(client, "data: b", "/text")
    eventually(lambda: listener.matched == 1)
    driving_places.ENDS_AFTER.set(monkeypatch, 0.1)
    eventually(lambda: listener.matched == 0)
    eventually(lambda: [new for *_, new in of(client, EventCode.OPERATOR_PUBLISH_ENDED)] == ["2"])


# --- what is refused


def test_what_is_refused(bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of it shows in the graph, and none of it takes one of the places."""
    driving_places.ENDS_AFTER.set(monkeypatch, 100.0)
    text_there, armed_there = robot.listener("/text"), robot.listener("/cmd")
    client = bridge.client(armed=("/cm*", ArmedName("/*", type=TWIST)))
    eventually(lambda: {each.topic for each in client.topics(None).result(30)} >= {"/text", "/cmd"})
    refused: tuple[tuple[str, str, str, Wording], ...] = (
        ("/nobody", "", "", PublishProblem.NO_TYPE),
        ("/text", "", TWIST, PublishProblem.OTHER_TYPE),
        ("view/1", "", STRING, NameMistake.NOT_ABSOLUTE),
        ("/cmd", "data: x", "", PublishProblem.NO_ROUTE_TO_ARM),  # wherever it comes from
    )
    for topic, fields, type_name, problem in refused:
        with pytest.raises(EngineError, match=pattern(problem)):
            give(client, topic, fields, type_name).result(30)
    for fields in ("dta: x", "data: [1]", "data: !x y", "- 1"):
        with pytest.raises(InvalidRequestError):
            give(client, "/text", fields).result(30)
    for number in range(TOPICS):
        with pytest.raises(EngineError):
            give(client, f"/text{number}", "no field: 1", STRING).result(30)
    assert not text_there.matched
    assert not armed_there.matched
    publish(client, "data: x", "/text")  # a demand of another type is none
    eventually(lambda: text_there.texts(10) == ["x"])
    for number in range(TOPICS - 1):
        publish(client, "", f"/text{number}", type_name=STRING)
    with pytest.raises(EngineError, match=pattern(PublishProblem.TOO_MANY)):
        give(client, "/more", "", STRING).result(30)


def test_a_topic_of_two_types(bridge: Bridge, robot: Domain) -> None:
    other = Domain(robot.id)  # one participant has one type a topic
    listeners = robot.listener("/two"), other.listener("/two", Twist)
    client = bridge.client()
    with pytest.raises(EngineError, match=pattern(PublishProblem.TYPES_DIFFER)):
        eventually(lambda: give(client, "/two", "").result(30) and False)
    publish(client, "data: x", "/two", type_name=STRING)
    eventually(lambda: listeners[0].texts(10)[-1:] == ["x"])
    assert not listeners[1].payloads
    other.close()


# --- arming


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize("side", ["client", "server"])
def test_nothing_is_published_unless_it_is_armed(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, side: str
) -> None:
    """On either side of the route, also for nodes of the operator's own side."""
    motors, near = robot.listener("/cmd"), pc.listener("/cmd")
    server, client = bridge.both(DRIVEN)
    engine = client if side == "client" else server
    # The server's session demands nothing: until the client has proposed the topic, it is none of the bridge's.
    eventually(lambda: any(each.topic == "/cmd" for each in engine.snapshot().routes))
    with pytest.raises(EngineError):
        give(engine, "/cmd", "data: too soon", STRING).result(30)
    eventually(lambda: can_be_armed(server, client))
    with pytest.raises(EngineError, match=pattern(PublishProblem.NOT_ARMED)):
        publish(engine, "data: disarmed")
    consoles.arm(engine)
    publish(engine, "data: armed")
    eventually(lambda: motors.texts(10) == ["armed"])
    engine.disarm(route(engine, "/cmd").key).result(30)
    with pytest.raises(EngineError, match=pattern(PublishProblem.NOT_ARMED)):
        publish(engine, "data: disarmed again")
    holds(lambda: {*motors.texts(10), *near.texts(10)} <= {"armed"}, 0.5)


@pytest.mark.usefixtures("long_lease")
def test_an_old_command_is_not_carried_out(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command without a ticket, or with one that is old, of another time or another engine, only gets a new one."""
    life = 30.0
    driving_places.TICKET_LIFE.set(monkeypatch, life)
    motors = robot.listener("/cmd")
    pc.publisher("/cmd")
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    ticket = publish(server, "data: first").ticket
    assert give(server, "/cmd", "data: second", ticket=ticket).result(30).is_done
    another = publish(client, "", "/text", type_name=STRING).ticket
    for old in (0, ticket - int((life + 0.2) * 1000), ticket + 60_000, another):
        published = give(server, "/cmd", "data: old", ticket=old).result(30)
        assert not published.is_done
    publish(server, "data: new", ticket=published.ticket)
    eventually(lambda: "new" in motors.texts(10))
    assert motors.texts(10) == ["first", "second", "new"]


# --- driving


@pytest.mark.usefixtures("long_lease")
def test_a_silent_console_ends_a_motion(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    motors = robot.listener("/cmd", Twist)
    server, client = bridge.both(replace(DRIVEN, type=TWIST))
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)

    def speeds() -> list[float]:
        return [deserialize_message(each, Twist).linear.x for each in motors.payloads]

    ticket = publish(server, "linear: {x: 0.1}", rest="linear: {x: 0}", rest_after=0.3).ticket
    for number in range(2, 6):
        time.sleep(0.05)  # a person's keys
        ticket = publish(
            server, f"linear: {{x: 0.{number}}}", ticket=ticket, rest="linear: {x: 0}", rest_after=0.3
        ).ticket
    moving = [0.1, 0.2, 0.3, 0.4, 0.5]
    eventually(lambda: speeds()[-2:] == [0.5, 0.0])
    # A busy machine takes longer than 0.3 s between two keys now and then: then the motion ends there, too.
    holds(lambda: [each for each in speeds() if each] == moving and speeds()[-1] == 0.0, 0.5)


def test_a_topic_without_arming_is_not_driven(bridge: Bridge, pc: Domain, robot: Domain) -> None:
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, _ = bridge.both(Topic("/cmd", "receive"))
    with pytest.raises(EngineError, match=pattern(PublishProblem.NO_DEADMAN)):
        publish(server, "", rest="linear: {x: 0}")
    assert not motors.payloads


# --- rests


def changes(listener: Listener) -> list[float]:
    """Return its speeds without repetitions: a rest comes several times."""
    return [speed for speed, _ in itertools.groupby(speeds(listener))]


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize(("on_end", "moves"), [({"linear": {"x": 0}}, True), ({"linera": {"x": 0}}, False)])
def test_no_motion_begins_that_no_rest_can_follow(
    bridge: Bridge, robot: Domain, consoles: Consoles, on_end: dict[str, Any], moves: bool
) -> None:
    """An operator drives on the robot's side, so no publisher has shown the type when the route opened."""
    motors = robot.listener("/cmd", Twist)
    server, client = bridge.both(replace(DRIVEN, on_end=on_end))
    eventually(lambda: is_accepted(client, "/cmd") and is_accepted(server, "/cmd"))
    consoles.arm(client)
    for _ in range(3):
        with contextlib.nullcontext() if moves else pytest.raises(EngineError):
            drive(client, 0.1)
    if moves:
        eventually(lambda: changes(motors)[-2:] == [0.1, 0.0])
    else:
        holds(lambda: not motors.payloads, 0.5)


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize("type_name", ["auto", "Twist"])
def test_topic_is_driven_whose_type_only_robot_knows(
    bridge: Bridge, robot: Domain, consoles: Consoles, type_name: str
) -> None:
    """Documented: ``{topic: /cmd_vel, direction: receive, arm: true}``, and no publisher on the control PC."""
    motors = robot.listener("/cmd", Twist)
    server, _ = bridge.both(replace(DRIVEN, type=type_name))
    eventually(lambda: route(server, "/cmd").arming is not None)
    assert draft(server, "/cmd").type_name == TWIST
    consoles.arm(server)
    drive(server, 0.1)
    eventually(lambda: speeds(motors)[:1] == [0.1])
    eventually(lambda: speeds(motors)[-1] == 0.0)


DEAF_BASES = {
    "latched": (Twist, LATCHED, "qos_incompatible"),
    "deadline": (Twist, QoSProfile(depth=10, deadline=Duration(seconds=1)), "qos_incompatible"),
    "type": (TwistStamped, RELIABLE, "type_conflict"),
}


@pytest.mark.usefixtures("long_lease")
@pytest.mark.parametrize(("kind", "qos", "cause"), DEAF_BASES.values(), ids=DEAF_BASES)
def test_a_base_that_cannot_hear_is_not_driven(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, kind: type, qos: QoSProfile, cause: str
) -> None:
    base = robot.listener("/cmd", kind, qos)
    server, client = driven(bridge, pc, consoles)
    landing = Landing("/cmd", now(server))
    eventually(lambda: drive(server, 0.1).links)
    eventually(lambda: landing.is_settled(now(server), ("robot1",)))
    (landed,) = landing.reports(now(server), ("robot1",))
    assert not landed.is_heard
    for engine in (server, client):
        heard = eventually(lambda engine=engine: each if (each := route(engine, "/cmd").audience).deaf else None)
        assert (heard.count, heard.nodes) == (0, ())
        assert [(each.node, each.cause) for each in heard.deaf] == [("/stock", cause)]
        arming = route(engine, "/cmd").arming
        assert arming is not None
        assert arming.velocity in (None, (0.0, 0.0))
    eventually(lambda: route(server, "/cmd").cause == cause)
    assert not base.payloads


@pytest.mark.parametrize("from_server", [True, False], ids=["receive", "transmit"])
def test_message_has_sessions_type_and_names_others(
    bridge: Bridge, robot: Domain, pc: Domain, from_server: bool
) -> None:
    base = (robot if from_server else pc).listener("/cmd", TwistStamped)
    engine = bridge.both(Topic("/cmd", "receive" if from_server else "transmit", type="Twist"))[not from_server]
    eventually(lambda: now(engine).routes)
    # Also once the other side has reported what it has.
    holds(lambda: draft(engine, "/cmd").type_name == TWIST, 3.0)
    landing = Landing("/cmd", now(engine))
    eventually(lambda: publish(engine, "linear: {x: 0.1}").links)
    eventually(lambda: landing.is_settled(now(engine), ("robot1",)))
    (landed,) = landing.reports(now(engine), ("robot1",))
    assert [(each.node, each.cause) for each in landed.audience.deaf] == [("/stock", "type_conflict")]
    assert not base.payloads


@pytest.mark.parametrize("bridged", [True, False])
def test_a_message_names_who_cannot_hear_it(
    bridge: Bridge, robot: Domain, pc: Domain, bridged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    driving_places.MATCHED_WITHIN.set(monkeypatch, 1e6)  # it does not wait for who cannot hear it
    robot.publisher("/words")  # its QoS is taken
    deaf = robot.listener("/words", qos=LATCHED)
    client = bridge.both(Topic("/words", "transmit"))[1] if bridged else bridge.client()
    eventually(lambda: {each.subscriptions for each in client.topics().result(30) if each.topic == "/words"} == {1})
    heard = publish(client, "data: hello", "/words", type_name=STRING).audience
    assert (heard.count, heard.nodes) == (0, ())
    assert [(each.node, each.cause) for each in heard.deaf] == [("/stock", "qos_incompatible")]
    assert not deaf.payloads
    hears = robot.listener("/words")
    eventually(lambda: publish(client, "data: hello", "/words").audience.count == 1)
    eventually(lambda: hears.payloads)


@pytest.mark.usefixtures("long_lease")
def test_abandoned_motion_ends_with_new_stamp(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """The rest was made with the command before it; a controller drops what is older than its timeout, often 0.5 s."""
    motors = robot.listener("/cmd", TwistStamped)
    server, _ = driven(bridge, pc, consoles, replace(DRIVEN, type=TWIST_STAMPED), TwistStamped)
    publish(
        server,
        "header: {stamp: now}\ntwist: {linear: {x: 0.1}}",
        rest="header: {stamp: now}\ntwist: {linear: {x: 0}}",
        rest_after=0.5,
    )
    eventually(lambda: len(motors.payloads) >= 2)
    moves, rests = (deserialize_message(each, TwistStamped) for each in motors.payloads[:2])
    assert (moves.twist.linear.x, rests.twist.linear.x) == (0.1, 0.0)
    between = Time.from_msg(rests.header.stamp) - Time.from_msg(moves.header.stamp)
    assert between.nanoseconds / 1e9 >= 0.45


@pytest.mark.usefixtures("long_lease")
def test_a_rest_does_not_outlive_its_arming(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """The motion ends when the topic is disarmed, and does not continue when it is armed again."""
    motors = robot.listener("/cmd", Twist)
    server, client = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=2.0)
    key = route(server, "/cmd").key
    server.pause(key, paused=True).result(30)
    eventually(lambda: speeds(motors) == [0.1, 0.0])
    server.pause(key, paused=False).result(30)
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    holds(lambda: speeds(motors) == [0.1, 0.0], 2.5)


@pytest.mark.usefixtures("long_lease")
def test_another_operators_message_leaves_the_rest(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    """A driven robot stops, even if others publish. The report of what has landed has the robot's counts."""
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    landing, links = Landing("/cmd", now(server)), ("robot1",)

    def passes_during_the_motion() -> bool:
        """A machine that stands still for a second has ended the motion before the other message comes."""
        assert drive(server, 0.1, rest_after=1.0).links == links
        publish(server, "linear: {x: 0.2}")
        with contextlib.suppress(AssertionError):
            return eventually(lambda: (0.1, 0.2) in itertools.pairwise(changes(motors)), 2.0)
        return False

    eventually(passes_during_the_motion)
    eventually(lambda: changes(motors)[-3:] == [0.1, 0.2, 0.0])
    eventually(lambda: landing.is_known(now(server), links) and route(server, "/cmd").audience.nodes)
    (landed,) = landing.reports(now(server), links)
    assert landed.is_heard
    assert says(landed.text, LandingText.DELIVERED)


@pytest.mark.usefixtures("long_lease")
def test_a_message_without_ticket_leaves_the_rest(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if it needs another publisher."""
    driving_places.RESOLVE_EVERY.set(monkeypatch, 0.0)
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1)
    eventually(lambda: speeds(motors)[-1:] == [0.0])
    pc.clear()
    pc.publisher("/cmd", Twist, QoSProfile(depth=10, deadline=Duration(seconds=5)))
    drive(server, 0.2, rest_after=2.0)
    pc.clear()
    assert not give(server, "/cmd", "linear: {x: 0.3}").result(30).is_done
    eventually(lambda: speeds(motors) == [0.1, 0.0, 0.2, 0.0])


def test_whatever_disarms_ends_the_motion_first(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """Afterwards, no message could stop the robot. The operator's other nodes hear the end, too."""
    motors, near = robot.listener("/cmd", Twist), pc.listener("/cmd", Twist)
    server, client = driven(bridge, pc, consoles)
    numbers = itertools.count(1)

    def ends_by(work: Callable[[str], Future[Any]]) -> None:
        speed = next(numbers) / 20

        def moves() -> bool:
            with contextlib.suppress(EngineError):  # a machine that stands still for a second has disarmed it
                if can_be_armed(server, client):
                    consoles.arm(server)
                drive(server, speed, rest_after=60.0)
            return speeds(motors)[-1:] == [speed]

        eventually(moves)
        work(route(server, "/cmd").key).result(60)
        eventually(lambda: changes(motors)[-2:] == changes(near)[-2:] == [speed, 0.0])

    ends_by(server.disarm)
    ends_by(lambda _: server.do(ReleaseArmed()))  # its console goes
    assert not armed(server)
    ends_by(lambda key: server.do(PauseTopics(key, True)))
    server.pause(route(server, "/cmd").key, paused=False).result(30)
    ends_by(lambda _: server.do(Restart()))
    ends_by(lambda key: server.do(RemoveTopic(key)))
    client.add_topic(DRIVEN).result(30)
    ends_by(lambda _: server.do(ShutDownLinks()))


@pytest.mark.usefixtures("long_lease")
def test_only_the_holder_drives(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """Two people who drive at the same time would send the robot to and fro."""
    motors = robot.listener("/cmd", Twist)
    server, client = driven(bridge, pc, consoles)
    drive(server, 0.1)
    with (
        on_console("another"),
        acting("bert on pts/7"),
        pytest.raises(EngineError, match=pattern(PublishProblem.ANOTHER_DRIVES)),
    ):
        drive(server, 0.5)
    with pytest.raises(EngineError, match=pattern(PublishProblem.ANOTHER_DRIVES)):
        publish(client, "linear: {x: 0.6}", type_name=TWIST)
    with on_console("another"):
        server.disarm(route(server, "/cmd").key).result(30)  # anybody may
    eventually(lambda: speeds(motors)[-1:] == [0.0])
    assert set(speeds(motors)) == {0.1, 0.0}


@pytest.mark.usefixtures("long_lease")
def test_arming_by_shell_is_for_its_operator(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """Names are not compared: an account on this machine is no operator with a key, and two keys are two operators."""
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    with on_console("arm"), acting(ActingOperator("uid 1000", "anna", "on pts/1")):
        server.arm(route(server, "/cmd").key, shared=True).result(30)
    with on_console("pub"), acting(ActingOperator("uid 1000", "anna", "on pts/2")):
        publish(server, "linear: {x: 0.1}")
    for account, name in (("uid 1001", "bert"), ("key 5a5a", "anna"), ("uid 0 for uid 1000", "anna"), ("", "anna")):
        with (
            on_console("pub"),
            acting(ActingOperator(account, name, "on pts/1")),
            pytest.raises(EngineError, match=pattern(PublishProblem.ANOTHER_DRIVES)),
        ):
            publish(server, "linear: {x: 0.5}")
    eventually(lambda: speeds(motors)[:1] == [0.1])


@pytest.mark.usefixtures("long_lease")
def test_a_bridge_that_stops_ends_a_motion(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    near = pc.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=2.0)
    server.stop()
    eventually(lambda: speeds(near) == [0.1, 0.0])


@pytest.mark.usefixtures("long_lease")
def test_all_robots_of_name_have_to_be_driven(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A robot that gets messages without arming, and of any age, might not stop."""
    others = robot.listener("/other", Twist)
    pc.publisher("/cmd", Twist)
    bridge.make_key("robot2")
    server = bridge.server(clients=(Client("robot1"), Client("robot2", key_file="robot2.key")))
    bridge.client(replace(DRIVEN, type=TWIST))
    bridge.client(Topic("/other", "receive", remote_topic="/cmd", type=TWIST), name="robot2", key_file="robot2.key")
    eventually(lambda: {each.state for each in now(server).routes} == {"disarmed", "waiting"})
    eventually(lambda: all(each.qos for each in now(server).routes))
    (needs_arming,) = (each for each in now(server).routes if each.arming is not None)
    eventually(lambda: is_accepted(server, "/cmd"))
    server.arm(needs_arming.key).result(30)
    with pytest.raises(EngineError, match=pattern(PublishProblem.NO_DEADMAN)):
        drive(server, 0.1)
    assert not others.payloads


# --- limits


@pytest.fixture
def may_read(monkeypatch: pytest.MonkeyPatch) -> Iterator[Event]:
    """Long messages are read only once this is set: a stand-in for many that take a processor for seconds."""
    event = Event()

    def reads(text: str) -> object:
        assert len(text) < 5_000 or event.wait(60)
        return read_fields(text)

    driving_places.READ_FIELDS.set(monkeypatch, reads)
    yield event
    event.set()


LONG = f"data: {'x' * 5_000}"


def test_long_messages_hold_up_no_short_one(bridge: Bridge, robot: Domain, may_read: Event) -> None:
    """However many consoles publish them: driving goes on."""
    robot.listener("/text")
    client = bridge.client()
    long = [give(client, f"/long{number}", LONG, STRING) for number in range(TOPICS - 1)]
    publish(client, "data: short", "/text")
    assert not any(each.done() for each in long)
    may_read.set()
    assert all(each.result(60).is_done for each in long)


def test_an_operator_leaves_room_for_the_next(bridge: Bridge, robot: Domain, may_read: Event) -> None:
    listener = robot.listener("/text")
    client = bridge.client()

    def publish_as(who: str, fields: str) -> Future[Published]:
        with acting(who):
            return give(client, "/text", fields)

    waiting = [publish_as("anna", LONG) for _ in range(AT_ONCE)]
    with pytest.raises(EngineError, match=pattern(PublishProblem.TOO_FAST)):
        publish_as("anna", "data: refused").result(30)
    waiting.append(publish_as("ben", "data: his"))
    may_read.set()
    assert all(each.result(60).is_done for each in waiting)
    assert publish_as("anna", "data: hers").result(30).is_done
    eventually(lambda: [len(each) for each in listener.texts(10)] == [5_000] * AT_ONCE + [3, 4])


# --- beginnings


def test_draft_has_fields_of_message_or_defaults(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/goal", PoseStamped, LATCHED)
    message = PoseStamped()
    message.header.frame_id, message.header.stamp.sec = "map", 7
    message.pose.position.x = 2.5
    publisher.publish(message)
    server, client = bridge.both(Topic("/goal", "transmit"))
    pc.listener("/goal", PoseStamped)
    eventually(lambda: now(server).routes and route(server, "/goal").messages_total)
    made = draft(server, "/goal")
    fields = yaml.safe_load(made.fields)
    assert (made.is_last, made.type_name) == (True, POSE)
    assert (fields["header"], fields["pose"]["position"]["x"]) == ({"stamp": "now", "frame_id": "map"}, 2.5)
    made = draft(client, "/nobody", POSE)
    fields = yaml.safe_load(made.fields)
    assert not made.is_last
    assert (fields["header"]["stamp"], fields["pose"]["orientation"]["w"]) == ("now", 1.0)
    assert publish(client, made.fields, "/nobody", type_name=made.type_name).audience.count == 0


def test_type_of_other_sides_subscription_is_taken(bridge: Bridge, pc: Domain) -> None:
    listener = pc.listener("/text")
    _, client = bridge.both(Topic("/text", "transmit"))

    def published() -> bool:
        try:
            return bool(publish(client, "data: x", "/text").links)
        except EngineError:  # it is not known yet
            return False

    eventually(published)
    eventually(lambda: "x" in listener.texts(10))


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("from_server", [False, True], ids=["sender", "receiver"])
def test_type_of_publisher_that_left_is_forgotten(bridge: Bridge, robot: Domain, pc: Domain, from_server: bool) -> None:
    """The remaining subscription's type counts, on the side of the publisher and on its own."""
    base = pc.listener("/cmd", TwistStamped)
    node = robot.publisher("/cmd", Twist)
    server, client = bridge.both(Topic("/cmd", "transmit"))
    eventually(lambda: route(server, "/cmd").type_name == TWIST)
    eventually(lambda: route(client, "/cmd").audience.deaf)
    robot.node.destroy_publisher(node)
    engine = server if from_server else client

    def is_forgotten() -> bool:
        with contextlib.suppress(EngineError):  # while the two sides learn that it has left, there are two types
            return draft(engine, "/cmd").type_name == TWIST_STAMPED
        return False

    eventually(is_forgotten)
    assert publish(engine, "twist: {linear: {x: 0.1}}").type_name == TWIST_STAMPED
    eventually(lambda: base.payloads or not publish(engine, "twist: {linear: {x: 0.1}}"))


def test_silent_peer_makes_nobody_arm_again(
    both_armed: tuple[Engine, Engine], relay: Relay, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.LEASE_GIVEN_UP_AFTER.set(monkeypatch, 60.0)
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    driving_places.TICKET_LIFE.set(monkeypatch, 60.0)
    server, client = both_armed
    relay.stall()

    def refused() -> str:
        try:
            publish(server, "data: held up")
        except EngineError as error:
            return str(error)
        return ""

    assert says(eventually(refused), PublishProblem.NOT_HEARD, topic="/cmd")
    assert armed(server)
    assert armed(client)
    relay.stall(False)
    eventually(lambda: not refused())
