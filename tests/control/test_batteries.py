"""Batteries, read from the messages of topics that are bridged anyway; never more of them than is allowed at once."""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.scripted import NOW, route
from tests.support.fleet import ServerEngine

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.known_types import BATTERY_STATE
from rsb_bridge.control.summaries import BATTERIES_AT_ONCE, BATTERY_EVERY, Batteries
from rsb_bridge.model.robot_summary import Battery
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PeekedMessage, State

pytest.importorskip("rclpy", reason="needs ROS 2")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState

from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.ros.native.typesupport import hash_of

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot

DESCRIPTION = installed_description(BATTERY_STATE)


def battery(charge: float, at: float = NOW) -> PeekedMessage:
    payload = serialize_message(BatteryState(percentage=charge))
    return PeekedMessage(payload, len(payload), BATTERY_STATE, hash_of(BatteryState), at, outgoing=False)


def topic_of(robot: str, name: str = "/battery_state", **changes: Any) -> RouteSnapshot:
    changes = {"type_name": BATTERY_STATE, **changes}
    return route(f"/{robot}{name}", link=robot, spec=Topic(name, "transmit"), **changes)


class LookedAt(ServerEngine):
    """A server whose messages a test hands out."""

    def __init__(self) -> None:
        super().__init__("robot1")
        self.waiting: dict[str, Future[PeekedMessage | None]] = {}
        self.asked: list[tuple[str, bool]] = []
        self.descriptions: list[Future[str]] = []
        self.batteries = Batteries(self)

    def peek(self, key: str, *, kept: bool = False) -> Future[PeekedMessage | None]:
        self.asked.append((key, kept))
        self.waiting[key] = Future()
        return self.waiting[key]

    def describe(self, key: str) -> Future[str]:
        self.descriptions.append(Future())
        return self.descriptions[-1]

    def tick(self, *routes: RouteSnapshot, at: float = 0.0) -> dict[str, Battery]:
        self.batteries.update(replace(self.now, time=NOW + at, routes=routes))
        return self.batteries.known

    def describes(self) -> None:
        assert DESCRIPTION is not None
        self.descriptions[-1].set_result(DESCRIPTION)


def test_battery_is_read_and_looked_at_again_later() -> None:
    engine, one = LookedAt(), topic_of("robot1")
    assert engine.tick(one) == {}
    engine.waiting[one.key].set_result(battery(0.75))
    assert engine.tick(one, at=1) == {}  # its type is asked for first
    engine.describes()
    assert engine.tick(one, at=2) == {"robot1": Battery(0.75, NOW)}
    engine.tick(one, at=BATTERY_EVERY - 1)
    assert engine.asked == [(one.key, True)]  # a late joiner wants the kept messages
    engine.tick(one, at=BATTERY_EVERY)
    assert engine.asked[1:] == [(one.key, False)]
    engine.waiting[one.key].set_result(battery(0.5, NOW + BATTERY_EVERY))
    assert engine.tick(one, at=BATTERY_EVERY + 1) == {"robot1": Battery(0.5, NOW + BATTERY_EVERY)}
    assert len(engine.descriptions) == 1


@pytest.mark.parametrize(
    ("published", "charge"), [(0.0, 0.0), (1.0, 1.0), (80.0, 0.8), (140.0, 1.0), (math.nan, None), (-1.0, None)]
)
def test_what_drivers_publish(published: float, charge: float | None) -> None:
    engine, one = LookedAt(), topic_of("robot1")
    engine.tick(one)
    engine.waiting[one.key].set_result(battery(published))
    engine.tick(one)
    engine.describes()
    known = {name: each.charge for name, each in engine.tick(one).items()}
    assert known == ({} if charge is None else {"robot1": pytest.approx(charge)})


@pytest.mark.parametrize(
    "other",
    [
        topic_of("robot1", "/battery"),
        topic_of("robot1", type_name="std_msgs/msg/Float32"),
        topic_of("robot1", outgoing=True),
        topic_of("robot1", state=State.STALE),
    ],
)
def test_what_is_no_battery(other: RouteSnapshot) -> None:
    engine = LookedAt()
    engine.tick(other)
    assert engine.asked == []


def test_a_battery_among_other_names() -> None:
    engine = LookedAt()
    engine.tick(topic_of("robot1", "/base/battery_state"))
    assert len(engine.asked) == 1


def test_not_all_robots_at_once() -> None:
    engine = LookedAt()
    routes = [topic_of(f"robot{number}") for number in range(BATTERIES_AT_ONCE + 3)]
    engine.tick(*routes)
    assert len(engine.asked) == BATTERIES_AT_ONCE
    for future in engine.waiting.values():
        future.set_result(None)  # nothing was published
    engine.tick(*routes, at=1)
    assert len(engine.asked) == BATTERIES_AT_ONCE + 3
    assert len({key for key, _ in engine.asked}) == BATTERIES_AT_ONCE + 3


def test_no_answer_harms_nobody() -> None:
    engine, one = LookedAt(), topic_of("robot1")
    engine.tick(one)
    engine.waiting[one.key].set_exception(EngineError("32 look already"))
    assert engine.tick(one, at=1) == {}
    engine.tick(one, at=BATTERY_EVERY)
    engine.waiting[one.key].set_result(battery(0.5))
    engine.tick(one, at=BATTERY_EVERY + 1)
    engine.descriptions[-1].set_exception(EngineError("type unknown"))
    assert engine.tick(one, at=BATTERY_EVERY + 2) == {}
    engine.tick(one, at=2 * BATTERY_EVERY)
    engine.waiting[one.key].set_result(battery(0.5))
    engine.tick(one, at=2 * BATTERY_EVERY + 1)
    engine.descriptions[-1].set_result("no description")
    assert engine.tick(one, at=2 * BATTERY_EVERY + 2) == {}


def test_a_battery_that_is_gone_has_no_figure() -> None:
    engine, one = LookedAt(), topic_of("robot1")
    engine.tick(one)
    engine.waiting[one.key].set_result(battery(0.5))
    engine.tick(one)
    engine.describes()
    assert engine.tick(one)
    assert engine.tick(replace(one, state=State.DOWN)) == {}


def test_clock_that_is_set_back_delays_no_look() -> None:
    engine, one = LookedAt(), topic_of("robot1")
    engine.tick(one)
    engine.waiting[one.key].set_result(None)
    engine.tick(one, at=-3600.0)
    assert len(engine.asked) == 2
    engine.waiting[one.key].set_result(None)
    engine.tick(one, at=BATTERY_EVERY - 3601.0)
    assert len(engine.asked) == 2
