"""ROS refuses a service's server or client: both sides show it, and the bridge tries again until it succeeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support import replaced
from tests.support.bridge import find, happened, link, now, route
from tests.support.spun import Spun
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.ros.participant import Participant

NODE = Topic("/stock", "receive", kind="parameters")
OTHER = Topic("/chat", "receive")


@pytest.fixture
def stock(robot: Domain) -> Iterator[Spun]:
    """A node with parameters."""
    made = Spun(robot.id, "stock", start_parameter_services=True)
    yield made
    made.close()


@pytest.mark.usefixtures("stock")
@pytest.mark.parametrize("kind", ["server", "client"])
def test_failed_offer_is_told_twice_and_repeated(kind: str, bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """rcl has no room, say: the real thing cannot be had at will."""
    refuses, attempts = [True], []
    place = replaced.CREATE_SERVER if kind == "server" else replaced.CREATE_CLIENT
    make = place.value

    def made(self: Participant, service: str, *about: Any) -> Any:
        if refuses[0]:
            attempts.append(service)
            raise RosError(f"{service}: no room")
        return make(self, service, *about)

    place.set(monkeypatch, made)
    engines = bridge.both(NODE, OTHER)
    for engine in engines:
        eventually(lambda engine=engine: find(engine, NODE.topic) and says(engine) == (State.DOWN, Cause.OFFER_FAILED))
        found = route(engine, NODE.topic)
        assert "no room" in found.reason
        assert any(stage.name == "offered" and stage.done is False for stage in found.stages) or found.from_peer
    own = engines[kind == "client"]
    event = happened(own, EventCode.ROUTE_OFFER_FAILED)
    assert event is not None
    eventually(lambda: len(attempts) >= 3, what="it is tried again")
    assert all(link(engine).state is State.OK for engine in engines)
    assert all(happened(engine, EventCode.ROUTE_CLOSED) is None for engine in engines), "it stays open"
    refuses[0] = False
    for engine in engines:
        eventually(lambda engine=engine: says(engine) == (State.WAITING, Cause.NO_CALL))
        assert now(engine).running


def says(engine: Any) -> tuple[State, str]:
    found = route(engine, NODE.topic)
    return found.state, found.cause
