"""An arming goes over to another driver: the robot stands in between, and only the new holder drives it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
from geometry_msgs.msg import Twist
from rclpy.serialization import deserialize_message
from tests.engine.test_publishing import can_be_armed, publish
from tests.support import constants
from tests.support.bridge import route
from tests.support.long import long_cases
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.engine.publishing import PublishProblem
from rsb_bridge.link.holder_questions import TakeOverText
from rsb_bridge.model.command_origin import acting, on_console
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine

pytestmark = pytest.mark.usefixtures("patient")

DRIVEN = Topic("/cmd", "receive", arm=True, deadman=0.0, type="geometry_msgs/msg/Twist")
ANNA, BERT = "anna", "bert"


class Drivers:
    """Consoles of several operators, by their names, which give signs of life for the length of a test."""

    def __init__(self) -> None:
        self._at: list[tuple[str, Engine]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def do(self, name: str, engine: Engine, work: Callable[[str], Future[None]]) -> Future[None]:
        """Have an operator give a command about the topic."""
        if (name, engine) not in self._at:
            self._at.append((name, engine))
        with on_console(name), acting(name):
            return work(route(engine, "/cmd").key)

    def _run(self) -> None:
        while not self._ended.wait(0.3):
            for name, engine in tuple(self._at):
                with on_console(name), acting(name):
                    engine.keep_armed(pressed=False)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture
def drivers() -> Iterator[Drivers]:
    made = Drivers()
    yield made
    made.close()


def speeds(listener: Listener) -> list[float]:
    found = [deserialize_message(each, Twist).linear.x for each in listener.payloads]
    return [each for each, before in zip(found, [None, *found], strict=False) if each != before]


def armed_by(engine: Engine) -> str:
    arming = route(engine, "/cmd").arming
    assert arming is not None
    return arming.by if arming.armed else ""


def asked_by(engine: Engine) -> str:
    arming = route(engine, "/cmd").arming
    assert arming is not None
    return arming.asked_by


def driven_by_anna(bridge: Bridge, robot: Domain, pc: Domain, drivers: Drivers) -> tuple[Engine, Engine, Listener]:
    """The control PC's bridge, on which anna drives, the robot's, and the robot's motors."""
    motors = robot.listener("/cmd", Twist)
    pc.publisher("/cmd", Twist)
    server, client = bridge.both(DRIVEN)
    eventually(lambda: can_be_armed(server, client))
    drivers.do(ANNA, server, server.arm).result(30)
    with on_console(ANNA), acting(ANNA):
        publish(server, "linear: {x: 0.1}")
    eventually(lambda: speeds(motors) == [0.1])
    return server, client, motors


@pytest.mark.parametrize(
    ("side", "how"),
    [
        ("beside the holder", "given"),
        ("on the robot's side", "not answered"),
        ("on the robot's side", "taken"),
        *long_cases(
            ("on the robot's side", "given"), ("beside the holder", "not answered"), ("beside the holder", "taken")
        ),
    ],
)
def test_it_goes_over_through_a_rest(
    bridge: Bridge,
    robot: Domain,
    pc: Domain,
    drivers: Drivers,
    side: str,
    how: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    constants.HOLDER_ASKED_FOR.set(monkeypatch, 0.5 if how == "not answered" else 60.0)
    server, client, motors = driven_by_anna(bridge, robot, pc, drivers)
    berts = server if side == "beside the holder" else client
    if how == "taken":
        drivers.do(BERT, berts, berts.take_arming).result(60)
    else:
        asked = drivers.do(BERT, berts, berts.ask_holder)
        if how == "given":
            eventually(lambda: BERT in asked_by(server))
            assert not asked.done()
            drivers.do(ANNA, server, lambda key: server.answer_asker(key, gives=True)).result(30)
        asked.result(60)
    assert armed_by(berts) == BERT
    eventually(lambda: BERT in armed_by(server))  # the side on which it was armed knows first that both agree
    with on_console(ANNA), acting(ANNA), pytest.raises(EngineError, match=pattern(PublishProblem.ANOTHER_DRIVES)):
        publish(server, "linear: {x: 0.9}")
    with on_console(BERT), acting(BERT):
        publish(berts, "linear: {x: 0.3}")
    eventually(lambda: speeds(motors)[-1:] == [0.3])
    assert speeds(motors) == [0.1, 0.0, 0.3]


def test_a_holder_who_keeps_it_drives_on(bridge: Bridge, robot: Domain, pc: Domain, drivers: Drivers) -> None:
    server, client, motors = driven_by_anna(bridge, robot, pc, drivers)
    asked = drivers.do(BERT, client, client.ask_holder)
    eventually(lambda: BERT in asked_by(server))
    with pytest.raises(EngineError, match=pattern(TakeOverText.NOT_YOURS)):
        drivers.do(BERT, server, lambda key: server.answer_asker(key, gives=True)).result(30)
    drivers.do(ANNA, server, lambda key: server.answer_asker(key, gives=False)).result(30)
    with pytest.raises(EngineError, match=pattern(TakeOverText.KEPT)):
        asked.result(60)
    assert armed_by(server) == ANNA
    with on_console(ANNA), acting(ANNA):
        publish(server, "linear: {x: 0.2}")
    eventually(lambda: 0.2 in speeds(motors))


def test_a_console_knows_what_it_holds_and_disarms_no_other_than_that(
    bridge: Bridge, robot: Domain, pc: Domain, drivers: Drivers
) -> None:
    """A drive screen that is left after the arming went over does not stop the next driver."""
    server, _, _ = driven_by_anna(bridge, robot, pc, drivers)
    key = route(server, "/cmd").key

    def held_by(name: str) -> tuple[str, ...]:
        with on_console(name):
            return server.keep_armed(pressed=False).result(30).keys

    assert (held_by(ANNA), held_by(BERT)) == ((key,), ())
    drivers.do(BERT, server, lambda key: server.disarm(key, own=True)).result(30)
    assert armed_by(server) == ANNA
    drivers.do(ANNA, server, lambda key: server.disarm(key, own=True)).result(30)
    assert armed_by(server) == ""
