"""A bridge that is stopped while a topic is armed, in a process of its own: what it held back reaches no robot."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from typing import TYPE_CHECKING, NamedTuple

import pytest
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_msgs.msg import String
from tests.support.bridge import balance, linked, route
from tests.support.consoles import Consoles
from tests.support.domain import RELIABLE, text
from tests.support.long import long_cases
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.route.lease import LASTS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.program import Program, Programs
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine

RATE = 50.0
BY_DDS = 0.15
"""Seconds that a message may take through DDS on both sides, on a busy machine."""


class Heard(NamedTuple):
    """A command that reached the robot.

    Attributes:
        at: s, when a bridge gave it to DDS. It may come later: a stop in the middle of a write to shared memory loses
            it there, and Fast DDS holds what follows until its next heartbeat, for up to 3 s.
        age: s, then.
    """

    at: float
    age: float


class Motors:
    """The robot's node, which notes how old each command is."""

    def __init__(self, robot: Domain) -> None:
        self.heard: list[Heard] = []
        self._executor = SingleThreadedExecutor(context=robot.node.context)
        self._executor.add_node(robot.node)
        robot.node.create_subscription(String, "/cmd", self._take, RELIABLE)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _take(self, message: String, about: dict[str, int]) -> None:
        at = time.monotonic() - (time.time_ns() - about["source_timestamp"]) / 1e9
        self.heard.append(Heard(at, at - float(message.data)))

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()


class Joystick:
    """The control PC's node: a command every 20 ms, which says when it was made."""

    def __init__(self, pc: Domain) -> None:
        self._publisher = pc.publisher("/cmd")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(1 / RATE):
            self._publisher.publish(text(f"{time.monotonic()}"))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


class Screen:
    """Watches the topic in the surviving engine's state, for the time when it is disarmed."""

    def __init__(self, engine: Engine) -> None:
        eventually(lambda: route(engine, "/cmd").state != "disarmed")  # a snapshot may be from before it was armed
        self.disarmed_at = float("inf")
        self._engine = engine
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(0.01):
            states = [each.state for each in self._engine.snapshot().routes]
            if "disarmed" in states or "down" in states:
                self.disarmed_at = time.monotonic()
                return

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture
def motors(robot: Domain) -> Iterator[Motors]:
    made = Motors(robot)
    yield made
    made.close()


@pytest.fixture
def joystick(pc: Domain) -> Iterator[Joystick]:
    made = Joystick(pc)
    yield made
    made.close()


@pytest.fixture
def consoles() -> Iterator[Consoles]:
    made = Consoles()
    yield made
    made.close()


def start(frozen: str, protocol: str, bridge: Bridge, programs: Programs) -> tuple[Engine, Program]:
    """The engine that goes on, in this process, and the other side's program."""
    topic = Topic("/cmd", "receive", protocol="udp" if protocol == "udp" else "tcp", arm=True, deadman=0.0)
    if frozen == "robot":
        engine = bridge.server()
        program = programs.start(bridge.client_session(topic))
    else:
        program = programs.start(bridge.server_session())
        engine = bridge.client(topic)
    eventually(lambda: linked(engine) and route(engine, "/cmd").state == "disarmed")
    return engine, program


@pytest.mark.parametrize(
    ("protocol", "frozen", "seconds"),
    [
        ("tcp", "robot", 3.0),
        ("udp", "robot", 0.8),
        ("tcp", "control PC", 0.8),
        ("udp", "control PC", 3.0),
        *long_cases(
            ("tcp", "robot", 0.8), ("udp", "robot", 3.0), ("tcp", "control PC", 3.0), ("udp", "control PC", 0.8)
        ),
    ],
)
def test_nothing_old_is_published_after_a_side_was_stopped(
    protocol: str,
    frozen: str,
    seconds: float,
    bridge: Bridge,
    programs: Programs,
    motors: Motors,
    joystick: Joystick,
    consoles: Consoles,
) -> None:
    engine, program = start(frozen, protocol, bridge, programs)
    consoles.arm(engine)
    eventually(lambda: len(motors.heard) >= RATE)
    screen = Screen(engine)
    program.signal(signal.SIGSTOP)
    time.sleep(seconds)
    program.signal(signal.SIGCONT)
    goes_on_at = time.monotonic()
    time.sleep(2.0)
    screen.close()
    old = [each for each in motors.heard if each.age > LASTS + BY_DDS]
    # Its age is checked, and then it is given to DDS, which takes time to send it: a stop may fall between.
    assert len(old) <= (1 if frozen == "robot" else 0)
    after = [each for each in motors.heard if each.at >= goes_on_at and each not in old]
    assert [each for each in after if each.at > screen.disarmed_at + BY_DDS] == []
    if seconds > LASTS:
        assert screen.disarmed_at < float("inf")
        assert after == []


@pytest.mark.parametrize("first", ["data", "control"])
@pytest.mark.parametrize("disarmed", [False, True], ids=["armed", "disarmed meanwhile"])
def test_nothing_old_is_published_when_a_network_lets_go_what_it_held(
    first: str, disarmed: bool, bridge: Bridge, relay: Relay, motors: Motors, joystick: Joystick, consoles: Consoles
) -> None:
    """It holds every stream for 4 s, and then lets one of them go before the other."""
    server, _ = bridge.both(Topic("/cmd", "receive", arm=True, deadman=0.0))
    eventually(lambda: route(server, "/cmd").state == "disarmed")
    consoles.arm(server)
    eventually(lambda: len(motors.heard) >= RATE)
    control, data = relay.connections[0], relay.connections[-1]
    assert control is not data
    screen = Screen(server)
    relay.stall()
    answered_at = float("inf")
    if disarmed:
        server.disarm(route(server, "/cmd").key).result(30)
        answered_at = time.monotonic()
    time.sleep(4.0)
    for connection in (data, control) if first == "data" else (control, data):
        connection.stall(False)
        time.sleep(0.3)
    relay.stall(False)
    eventually(lambda: linked(server) and route(server, "/cmd").state == "disarmed")
    screen.close()
    shown_at = min(screen.disarmed_at, answered_at)
    assert [each for each in motors.heard if each.age > LASTS + BY_DDS or each.at > shown_at + BY_DDS] == []
    ledger = eventually(lambda: ledger if not (ledger := route(server, "/cmd").ledger).in_flight else None)
    assert balance(ledger) == ledger.offered


def test_a_disarm_is_answered_at_once_where_the_other_side_answers(
    bridge: Bridge, motors: Motors, joystick: Joystick, consoles: Consoles
) -> None:
    """Within a second where it does not: then no sent message can be published any more."""
    server, _ = bridge.both(Topic("/cmd", "receive", arm=True, deadman=0.0))
    eventually(lambda: route(server, "/cmd").state == "disarmed")
    consoles.arm(server)
    eventually(lambda: len(motors.heard) >= RATE)
    began = time.monotonic()
    server.disarm(route(server, "/cmd").key).result(30)
    answered_at = time.monotonic()
    time.sleep(1.0)
    assert answered_at - began < LASTS
    assert [each for each in motors.heard if each.at > answered_at + BY_DDS] == []
