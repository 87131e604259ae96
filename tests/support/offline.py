"""A context on virtual time, without ROS and without a network."""

from __future__ import annotations

from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import pytest
from tests.support.virtual_time import VirtualClock, VirtualLoop, virtual_loop

from rsb_bridge.context import Context
from rsb_bridge.link.proposals import proposal_of
from rsb_bridge.model.purposes import TOPIC as ORDINARY
from rsb_bridge.model.session import Session
from rsb_bridge.model.transports import NO_PROFILE
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_thread import RosToLoopQueue
from rsb_bridge.route.half import Half
from rsb_bridge.route.idling import Timetable
from rsb_bridge.route.lifecycle import Revisions
from rsb_bridge.route.peer_budget import PeerBudget
from rsb_bridge.route.route import Entry, Route
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.meters import ClockOffset
from rsb_bridge.transport.registry import Transports, default_transports

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.session import Topic
    from rsb_bridge.wire.messages import ControlMessageBase, Propose

HalfT = TypeVar("HalfT", bound=Half)


@pytest.fixture
def loop() -> Iterator[VirtualLoop]:
    with virtual_loop() as made:
        yield made


@pytest.fixture
def make_context(loop: VirtualLoop) -> Callable[..., Context]:
    def make(ros: Any = None, transports: Transports | None = None, **fields: Any) -> Context:
        session = Session(**{"name": "robot1", "role": "client", "server_ip": "127.0.0.1", "server_port": 1, **fields})
        clock = VirtualClock(loop)
        return Context(
            session,
            0,
            ros or NoRos(),
            EventLog(clock),
            RosToLoopQueue(loop),
            loop,
            clock,
            Random(1),
            transports or default_transports(),
        )

    return make


@pytest.fixture
def context(make_context: Callable[..., Context]) -> Context:
    return make_context()


class FakePeer:
    """A peer that a route alone is tested with.

    Attributes:
        sent: the control messages that the route has sent.
        reported: routes whose reports were to be sent soon.
        instance: which process of the peer it is.
    """

    name = "robot1"
    is_client = True
    linked = True
    keepalive: Any = SimpleNamespace(ping_delay=0.0, ping_wait=0.0, quiet=0.0, in_doubt=False)
    down_reason = ""
    suspended_since = None
    verdicts: Any = None
    explain: Any = None
    transforms: Any = None
    connections = 1
    is_looked_at = False

    def __init__(self) -> None:
        self.sent: list[ControlMessageBase] = []
        self.reported: list[Route] = []
        self.instance = "first"
        self.fullness: Any = SimpleNamespace(out=None, into=None, undecided=False)
        self.path: Any = SimpleNamespace(fault=None)
        self.revisions = Revisions()
        self.bridges: tuple[str, ...] = ("_rsb_robot1_fedcba98",)
        self.budget = PeerBudget(0.0)
        self.timetable: Timetable[Route] = Timetable(0.0)
        self.profile = NO_PROFILE
        self.clock, self.stamps = ClockOffset(), ClockOffset()
        for clock in (self.clock, self.stamps):
            clock.offset, clock.uncertainty = 0.0, 0.001

    @property
    def awake(self) -> Collection[Route]:
        return self.timetable.awake

    def send(self, message: ControlMessageBase) -> None:
        self.sent.append(message)

    def report_soon(self, route: Route) -> None:
        self.reported.append(route)

    def open_channel(self, route: Route) -> None:
        pass

    def compare_types(self, route_id: int, types: Sequence[TypeVersion], tell: Callable[[str], None]) -> None:
        """Tell at once that nobody can be asked."""
        tell("")

    def shared_port(self) -> int:
        return 1

    def route_fields(self, route: Route) -> dict[str, Any]:
        return {}

    def closed(self, route_id: int) -> None:
        pass


def proposal_for(topic: Topic, context: Context, purpose: Purpose = ORDINARY) -> Propose:
    transport = context.transports[topic.protocol or "tcp"]
    return proposal_of(topic, transport, client_name="robot1", use_name=False, purpose=purpose)


def half_of(
    kind: type[HalfT], context: Context, topic: Topic, peer: FakePeer | None = None, *, here: bool = True
) -> HalfT:
    """Make a half of a route that is not open yet.

    Args:
        kind: `Sender` or another class of halves.
        here: whether this side has proposed it.
    """
    entry = Entry(topic, proposal_for(topic, context))
    half = Route(kind, context, peer or FakePeer(), entry, proposed_here=here).half
    assert isinstance(half, kind)
    return half
