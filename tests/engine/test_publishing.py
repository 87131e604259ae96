"""Messages that operators publish by hand: what they reach, what is refused, what is recorded."""

from __future__ import annotations

import time
from threading import Event
from typing import TYPE_CHECKING

import pytest
import yaml
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from msgspec.structs import replace
from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from tests.support import constants, replaced
from tests.support.bridge import balance, carries, happened, is_accepted, now, route
from tests.support.consoles import Consoles
from tests.support.domain import BEST_EFFORT, LATCHED, RELIABLE, Domain, text
from tests.support.waiting import eventually, holds
from tests.support.wording import pattern, says

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.config.fields_text import read_fields
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.engine.publishing import AT_ONCE, ENDS_AFTER, TOPICS, PublishProblem
from rsb_bridge.model.by_hand import TICKET_LIFE
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.command_origin import acting, on_console
from rsb_bridge.model.commands import Command, PauseTopics, Publish, RemoveTopic, Restart, ShutDownLinks
from rsb_bridge.model.purposes import VIEW
from rsb_bridge.model.session import ArmedName, Client, Topic
from rsb_console.session.landing import Landing, LandingText

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Listener

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.by_hand import Published
    from rsb_bridge.model.wording import Wording

STRING, TWIST, TWIST_STAMPED = "std_msgs/msg/String", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
DRIVEN = Topic("/cmd", "receive", arm=True, deadman=0.0)


@pytest.fixture
def consoles() -> Iterator[Consoles]:
    made = Consoles()
    yield made
    made.close()


def publish(engine: Engine, fields: str, topic: str = "/cmd", **more: object) -> Published:
    """Publish a message, with a ticket where it needs one."""
    published = engine.do(Publish(topic, fields, **more)).result(30)  # type: ignore[arg-type]
    if not published.is_done:
        again: dict[str, object] = {**more, "ticket": published.ticket}
        published = engine.do(Publish(topic, fields, **again)).result(30)  # type: ignore[arg-type]
    assert published.is_done
    return published


def armed(engine: Engine) -> bool:
    found = route(engine, "/cmd").arming
    return found is not None and found.armed


def can_be_armed(*engines: Engine) -> bool:
    return all(route(engine, "/cmd").state == "disarmed" and is_accepted(engine, "/cmd") for engine in engines)


def of(engine: Engine, code: EventCode) -> list[tuple[str, str, str]]:
    return [(event.topic, event.who, event.new) for event in engine.events() if event.code == code]


# --- what it reaches


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first message waits for nodes and routes as long as a busy machine takes, not 3 s."""
    constants.PUBLISHING_MATCHED_WITHIN.set(monkeypatch, 100.0)


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("qos", [RELIABLE, BEST_EFFORT, LATCHED])
def test_nodes_of_this_side_get_it(bridge: Bridge, robot: Domain, qos: QoSProfile) -> None:
    """The first message already, with any QoS that they ask for."""
    listener = robot.listener("/text", qos=qos)
    client = bridge.client()
    published = publish(client, "data: here", "/text")
    assert (published.type_name, published.nodes, published.links) == (STRING, 1, ())
    eventually(lambda: listener.texts(10) == ["here"])


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("first", [True, False])
def test_a_route_takes_it_like_a_nodes_message(
    bridge: Bridge, robot: Domain, pc: Domain, protocol: str, first: bool
) -> None:
    """The first message, too, although the route opens only when it has a publisher."""
    listener = pc.listener("/text")
    topic = Topic("/text", "transmit", protocol="udp" if protocol == "udp" else "tcp")
    server, client = bridge.both(topic)
    if not first:
        publisher = robot.publisher("/text")
        carries([publisher], server, ["/text"])
        robot.node.destroy_publisher(publisher)
    published = publish(client, "data: by hand", "/text", type_name=STRING if first else "")
    assert published.links == ("robot1",)
    eventually(lambda: "by hand" in listener.texts(100))
    ledger = eventually(lambda: each if not (each := route(client, "/text").ledger).in_flight else None)
    assert balance(ledger) == ledger.offered
    assert server.session.clients is None


def test_beside_a_node_of_a_latched_topic(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """The route stays latched."""
    publisher = robot.publisher("/text", qos=LATCHED)
    publisher.publish(text("kept"))
    server, client = bridge.both(Topic("/text", "transmit"))
    eventually(lambda: pc.listener("/text", qos=LATCHED).texts(1) == ["kept"])
    publish(client, "data: by hand", "/text")
    late = pc.listener("/text", qos=QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    eventually(lambda: {"kept", "by hand"} <= set(late.texts(10)))
    assert (found := route(server, "/text").qos) is not None
    assert found.latched


@pytest.mark.usefixtures("patient")
def test_many_come_in_order_and_are_recorded_once(bridge: Bridge, pc: Domain) -> None:
    """The last arrives; of those before it, DDS keeps 10 for a subscription whose process gets no time."""
    listener = pc.listener("/text")
    server, client = bridge.both(Topic("/text", "transmit"))
    for number in range(50):
        publish(client, f"data: '{number}'", "/text", type_name=STRING)
    eventually(lambda: "49" in listener.texts(100))
    heard = [int(each) for each in listener.texts(100)]
    assert heard == sorted(set(heard))
    assert of(client, EventCode.OPERATOR_PUBLISHED) == [("/text", "the bridge's own console", "data: '0'")]
    (there,) = eventually(lambda: of(server, EventCode.OPERATOR_PUBLISHED))
    assert there[::2] == ("/text", "data: '0'")
    assert "robot1" in there[1]


def test_a_publisher_that_is_not_used_is_closed(bridge: Bridge, robot: Domain, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.PUBLISHING_ENDS_AFTER.set(monkeypatch, ENDS_AFTER / 20)
    listener = robot.listener("/text")
    client = bridge.client()
    publish(client, "data: a", "/text")
    publish(client, "data: b", "/text")
    eventually(lambda: listener.matched == 1)
    eventually(lambda: listener.matched == 0)
    assert [new for *_, new in of(client, EventCode.OPERATOR_PUBLISH_ENDED)] == ["2"]


# --- what is refused


@pytest.mark.parametrize(
    ("topic", "fields", "type_name", "problem"),
    [
        ("/nobody", "", "", PublishProblem.NO_TYPE),
        ("/text", "", TWIST, PublishProblem.OTHER_TYPE),
        (VIEW.route_name("1"), "", STRING, TopicMistake.NOT_ABSOLUTE),
    ],
)
def test_refused(bridge: Bridge, robot: Domain, topic: str, fields: str, type_name: str, problem: Wording) -> None:
    assert robot.listener("/text")
    client = bridge.client()
    eventually(lambda: any(each.topic == "/text" for each in client.topics(None).result(30)))
    with pytest.raises(EngineError, match=pattern(problem)):
        client.publish(topic, fields, type_name).result(30)


@pytest.mark.parametrize("fields", ["dta: x", "data: [1]", "data: !x y", "- 1"])
def test_fields_that_do_not_fit(bridge: Bridge, robot: Domain, fields: str) -> None:
    listener = robot.listener("/text")
    client = bridge.client()
    with pytest.raises(InvalidRequestError):
        client.publish("/text", fields).result(30)
    assert not listener.matched


def test_a_topic_of_two_types(bridge: Bridge, robot: Domain) -> None:
    other = Domain(robot.id)  # one participant has one type a topic
    listeners = robot.listener("/two"), other.listener("/two", Twist)
    client = bridge.client()
    with pytest.raises(EngineError, match=pattern(PublishProblem.TYPES_DIFFER)):
        eventually(lambda: client.publish("/two", "").result(30) and False)
    publish(client, "data: x", "/two", type_name=STRING)
    eventually(lambda: listeners[0].texts(10)[-1:] == ["x"])
    assert not listeners[1].payloads
    other.close()


def test_no_more_topics_than_the_limit(bridge: Bridge) -> None:
    client = bridge.client()
    for number in range(TOPICS):
        publish(client, "", f"/text{number}", type_name=STRING)
    with pytest.raises(EngineError, match=pattern(PublishProblem.TOO_MANY)):
        client.publish("/more", "", STRING).result(30)


# --- arming


@pytest.mark.parametrize("side", ["client", "server"])
def test_nothing_is_published_unless_it_is_armed(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, side: str
) -> None:
    """On either side of the route, also for nodes of the operator's own side."""
    motors, near = robot.listener("/cmd"), pc.listener("/cmd")
    server, client = bridge.both(DRIVEN)
    engine = client if side == "client" else server
    with pytest.raises(EngineError):
        engine.publish("/cmd", "data: too soon", STRING).result(30)
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


def test_a_demand_without_a_route(bridge: Bridge, robot: Domain) -> None:
    """The name has it, wherever it comes from."""
    listener = robot.listener("/cmd")
    client = bridge.client(armed=("/cm*",))
    with pytest.raises(EngineError, match=pattern(PublishProblem.NO_ROUTE_TO_ARM)):
        client.publish("/cmd", "data: x").result(30)
    assert not listener.matched


@pytest.mark.parametrize("age", [None, TICKET_LIFE + 0.2, -60.0])
def test_an_old_command_is_not_carried_out(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, age: float | None
) -> None:
    """A command without a ticket, with an old one, or with one of another time, only gets a new one."""
    motors = robot.listener("/cmd")
    pc.publisher("/cmd")
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    ticket = publish(server, "data: first").ticket
    old = 0 if age is None else ticket - int(age * 1000)
    published = server.publish("/cmd", "data: old", ticket=old).result(30)
    assert not published.is_done
    publish(server, "data: new", ticket=published.ticket)
    eventually(lambda: "new" in motors.texts(10))
    assert motors.texts(10) == ["first", "new"]


# --- driving


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


@pytest.mark.parametrize("topic", [Topic("/cmd", "receive"), Topic("/cmd", "receive", arm=True, max_age=0.0)])
def test_only_an_armed_topic_with_young_messages_is_driven(
    bridge: Bridge, pc: Domain, robot: Domain, consoles: Consoles, topic: Topic
) -> None:
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(topic)
    if topic.arm:
        eventually(lambda: can_be_armed(server, client))
        consoles.arm(server)
    with pytest.raises(EngineError, match=pattern(PublishProblem.NO_DEADMAN)):
        publish(server, "", rest="linear: {x: 0}")
    assert not motors.payloads


# --- rests


def speeds(listener: Listener) -> list[float]:
    return [deserialize_message(each, Twist).linear.x for each in listener.payloads]


def drive(engine: Engine, speed: float, rest_after: float = 0.5) -> Published:
    return publish(engine, f"linear: {{x: {speed}}}", rest="linear: {x: 0}", rest_after=rest_after)


def driven(bridge: Bridge, pc: Domain, consoles: Consoles) -> tuple[Engine, Engine]:
    """A server and a client with a topic that is armed on the server and may be driven."""
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(replace(DRIVEN, type=TWIST))
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    return server, client


@pytest.mark.parametrize("type_name", ["auto", "Twist"])
def test_a_topic_is_driven_whose_type_only_the_robot_knows(
    bridge: Bridge, robot: Domain, consoles: Consoles, type_name: str
) -> None:
    """As documented: ``{topic: /cmd_vel, direction: receive, arm: true}``, and no publisher on the control PC."""
    motors = robot.listener("/cmd", Twist)
    server, _ = bridge.both(replace(DRIVEN, type=type_name))
    eventually(lambda: route(server, "/cmd").arming is not None)
    assert server.draft_message("/cmd").result(30).type_name == TWIST
    consoles.arm(server)
    drive(server, 0.1)
    eventually(lambda: speeds(motors)[:1] == [0.1])
    eventually(lambda: speeds(motors)[-1] == 0.0)


def test_a_motion_that_nobody_goes_on_with_ends_with_a_new_stamp(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    """The rest was made with the command before it; a controller drops what is older than its timeout, often 0.5 s."""
    motors = robot.listener("/cmd", TwistStamped)
    pc.publisher("/cmd", TwistStamped)
    server, client = bridge.both(replace(DRIVEN, type=TWIST_STAMPED))
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
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


def test_what_has_landed_is_reported(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """The counts are the robot's: given to DDS there, and the nodes that subscribe."""
    robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    landing = Landing("/cmd", now(server))
    links = drive(server, 0.1).links
    assert links == ("robot1",)
    eventually(lambda: landing.is_known(now(server), links) and route(server, "/cmd").subscribers)
    ((landed, report),) = landing.reports(now(server), links)
    assert landed
    assert says(report, LandingText.DELIVERED)


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


def test_another_operators_message_leaves_the_rest(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    """A driven robot stops, even if others publish."""
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=1.0)
    publish(server, "linear: {x: 0.2}")
    eventually(lambda: speeds(motors)[-1:] == [0.0])
    assert speeds(motors)[-2:] == [0.2, 0.0]


def test_a_message_without_ticket_leaves_the_rest(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if it needs another publisher."""
    constants.PUBLISHING_RESOLVE_EVERY.set(monkeypatch, 0.0)
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1)
    eventually(lambda: speeds(motors)[-1:] == [0.0])
    pc.clear()
    pc.publisher("/cmd", Twist, QoSProfile(depth=10, deadline=Duration(seconds=5)))
    drive(server, 0.2, rest_after=2.0)
    pc.clear()
    assert not server.publish("/cmd", "linear: {x: 0.3}").result(30).is_done
    eventually(lambda: speeds(motors) == [0.1, 0.0, 0.2, 0.0])


def test_whoever_disarms_ends_the_motion_first(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """Afterwards, no message could stop the robot."""
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=2.0)
    server.disarm(route(server, "/cmd").key).result(30)
    eventually(lambda: speeds(motors) == [0.1, 0.0])


@pytest.mark.parametrize("command", ["pause", "remove", "restart", "shut_down"])
def test_what_disarms_ends_the_motion_first(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles, command: str
) -> None:
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    consoles.arm(server)
    drive(server, 0.1, rest_after=2.0)
    key = route(server, "/cmd").key
    commands: dict[str, Command[object]] = {
        "pause": PauseTopics(key, True),
        "remove": RemoveTopic(key),
        "restart": Restart(),
        "shut_down": ShutDownLinks(),
    }
    server.do(commands[command])
    eventually(lambda: [deserialize_message(each, Twist).linear.x for each in motors.payloads] == [0.1, 0.0])


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


def test_an_arming_by_a_shell_is_for_the_commands_of_its_operator(
    bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles
) -> None:
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    with on_console("arm"), acting("anna on pts/1"):
        server.arm(route(server, "/cmd").key, shared=True).result(30)
    with on_console("pub"), acting("anna on pts/2"):
        publish(server, "linear: {x: 0.1}")
    with (
        on_console("pub"),
        acting("bert on pts/1"),
        pytest.raises(EngineError, match=pattern(PublishProblem.ANOTHER_DRIVES)),
    ):
        publish(server, "linear: {x: 0.5}")
    eventually(lambda: speeds(motors)[:1] == [0.1])


def test_a_console_that_goes_ends_the_motion(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    """The topic that it has armed is disarmed at once."""
    motors = robot.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=2.0)
    server.release_armed().result(30)
    eventually(lambda: speeds(motors) == [0.1, 0.0])
    assert not armed(server)


def test_a_bridge_that_stops_ends_a_motion(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    near = pc.listener("/cmd", Twist)
    server, _ = driven(bridge, pc, consoles)
    drive(server, 0.1, rest_after=2.0)
    server.stop()
    eventually(lambda: speeds(near) == [0.1, 0.0])


def test_all_robots_of_a_name_have_to_be_driven(bridge: Bridge, robot: Domain, pc: Domain) -> None:
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


def test_what_fails_takes_no_place(bridge: Bridge, robot: Domain) -> None:
    listener = robot.listener("/text")
    client = bridge.client()
    for number in range(TOPICS):
        with pytest.raises(EngineError):
            client.publish(f"/text{number}", "no field: 1", STRING).result(30)
    publish(client, "data: x", "/text", type_name=STRING)
    eventually(lambda: listener.texts(10) == ["x"])


@pytest.fixture
def may_read(monkeypatch: pytest.MonkeyPatch) -> Iterator[Event]:
    """Long messages are read only once this is set: a stand-in for many that take a processor for seconds."""
    event = Event()

    def reads(text: str) -> object:
        assert len(text) < 5_000 or event.wait(60)
        return read_fields(text)

    replaced.PUBLISHING_READ_FIELDS.set(monkeypatch, reads)
    yield event
    event.set()


LONG = f"data: {'x' * 5_000}"


def test_long_messages_hold_up_no_short_one(bridge: Bridge, robot: Domain, may_read: Event) -> None:
    """However many consoles publish them: driving goes on."""
    robot.listener("/text")
    client = bridge.client()
    long = [client.publish(f"/long{number}", LONG, STRING) for number in range(TOPICS - 1)]
    publish(client, "data: short", "/text")
    assert not any(each.done() for each in long)
    may_read.set()
    assert all(each.result(60).is_done for each in long)


def test_an_operator_leaves_room_for_the_next(bridge: Bridge, robot: Domain, may_read: Event) -> None:
    listener = robot.listener("/text")
    client = bridge.client()

    def publish_as(who: str, fields: str) -> Future[Published]:
        with acting(who):
            return client.publish("/text", fields)

    waiting = [publish_as("anna", LONG) for _ in range(AT_ONCE)]
    with pytest.raises(EngineError, match=pattern(PublishProblem.TOO_FAST)):
        publish_as("anna", "data: refused").result(30)
    waiting.append(publish_as("ben", "data: his"))
    may_read.set()
    assert all(each.result(60).is_done for each in waiting)
    assert publish_as("anna", "data: hers").result(30).is_done
    eventually(lambda: [len(each) for each in listener.texts(10)] == [5_000] * AT_ONCE + [3, 4])


def test_operators_in_turn_are_recorded_once_each(bridge: Bridge, pc: Domain) -> None:
    pc.listener("/text")
    server, client = bridge.both(Topic("/text", "transmit"))
    for number in range(6):
        with acting(("anna", "ben")[number % 2]):
            publish(client, f"data: '{number}'", "/text", type_name=STRING)
    assert [who for _, who, _ in of(client, EventCode.OPERATOR_PUBLISHED)] == ["anna", "ben"]
    eventually(lambda: len(of(server, EventCode.OPERATOR_PUBLISHED)) == 2)


def test_tickets_of_another_engine_are_void(bridge: Bridge, robot: Domain, pc: Domain, consoles: Consoles) -> None:
    server, client = driven(bridge, pc, consoles)
    ticket = publish(server, "").ticket
    assert server.publish("/cmd", "", ticket=ticket).result(30).is_done
    another = publish(client, "", "/text", type_name=STRING).ticket
    assert not server.publish("/cmd", "", ticket=another).result(30).is_done


def test_a_demand_of_another_type_is_no_demand(bridge: Bridge, robot: Domain) -> None:
    """It may be left out, because the topic has one."""
    listener = robot.listener("/text")
    client = bridge.client(armed=(ArmedName("/*", type=TWIST),))
    eventually(lambda: any(each.topic == "/text" for each in client.topics(None).result(30)))
    publish(client, "data: x", "/text")
    eventually(lambda: listener.texts(10) == ["x"])


def test_reliable_subscriptions_hear_it_beside_a_best_effort_publisher(
    bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    """And the route stays as it is."""
    robot.publisher("/text", qos=BEST_EFFORT)
    listener = robot.listener("/text", qos=RELIABLE)
    pc.listener("/text", qos=BEST_EFFORT)
    _, client = bridge.both(Topic("/text", "transmit"))
    eventually(lambda: route(client, "/text").qos)
    before = route(client, "/text").qos
    published = publish(client, "data: by hand", "/text")
    assert published.links == ("robot1",)
    eventually(lambda: listener.texts(1) == ["by hand"])
    assert route(client, "/text").qos == before


# --- beginnings


def test_a_draft_has_the_fields_of_a_message_that_passes(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/goal", PoseStamped, LATCHED)
    message = PoseStamped()
    message.header.frame_id, message.header.stamp.sec = "map", 7
    message.pose.position.x = 2.5
    publisher.publish(message)
    server, _ = bridge.both(Topic("/goal", "transmit"))
    pc.listener("/goal", PoseStamped)
    eventually(lambda: now(server).routes and route(server, "/goal").messages_total)
    draft = server.draft_message("/goal").result(30)
    fields = yaml.safe_load(draft.fields)
    assert (draft.is_last, draft.type_name) == (True, "geometry_msgs/msg/PoseStamped")
    assert (fields["header"], fields["pose"]["position"]["x"]) == ({"stamp": "now", "frame_id": "map"}, 2.5)


def test_a_draft_has_the_defaults_of_the_type(bridge: Bridge) -> None:
    client = bridge.client()
    draft = client.draft_message("/nobody", "geometry_msgs/msg/PoseStamped").result(30)
    fields = yaml.safe_load(draft.fields)
    assert not draft.is_last
    assert (fields["header"]["stamp"], fields["pose"]["orientation"]["w"]) == ("now", 1.0)
    published = publish(client, draft.fields, "/nobody", type_name=draft.type_name)
    assert published.nodes == 0


def test_the_type_of_the_other_sides_subscription_is_taken(bridge: Bridge, pc: Domain) -> None:
    listener = pc.listener("/text")
    _, client = bridge.both(Topic("/text", "transmit"))

    def published() -> bool:
        try:
            return bool(publish(client, "data: x", "/text").links)
        except EngineError:  # it is not known yet
            return False

    eventually(published)
    eventually(lambda: "x" in listener.texts(10))


def test_both_sides_know_who_published(bridge: Bridge, pc: Domain) -> None:
    pc.listener("/text")
    server, client = bridge.both(Topic("/text", "transmit"))
    publish(client, "data: x", "/text", type_name=STRING)
    eventually(lambda: happened(server, EventCode.OPERATOR_PUBLISHED))
    assert not happened(server, EventCode.OPERATOR_CALLED)
