"""The interface that a `Route` calls on its half, and `Carried`, the state that every half keeps.

Halves are `sender.Sender` and `receiver.Receiver` of a topic, `calls.caller.Caller` and `calls.provider.Provider` of a
service, an action or a node's parameters. Only the route calls the verbs, in the order that its own methods say, unless
a verb names another caller. A half reads its route, logs by it, and asks it to `advance`, `judge_again`, `wake`,
`settle_age`, `refuse` or `request_reopen`. It writes the route's notices, life (`handle`), losses, meter, weight,
`rested`, age (`publishers.since`), rate limit (`set_profile_rate`) and the other side's verdict (`judged.receive`), has
its gates composed when arming, age or limit switch (`gates.compose_when_switched`), and writes nothing else of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

from rsb_bridge.channel.channel import DataChannel
from rsb_bridge.model.verdict import LASTING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from functools import partial

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.cdr.known_types import Velocity
    from rsb_bridge.model.fates import Fates
    from rsb_bridge.model.snapshot import RouteSnapshot, Stage
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.ros.ros_interface import EndPlace, Endpoint
    from rsb_bridge.route.crossing import Crossing
    from rsb_bridge.route.idling import Signs
    from rsb_bridge.route.notices import ChannelLosses
    from rsb_bridge.wire.codec import ReportEntry
    from rsb_bridge.wire.framing import Message

ChannelT = TypeVar("ChannelT", bound=DataChannel)


class Carried(Generic[ChannelT]):
    """The messages or calls that a half carries: their type, the nodes they are for or from, and their channel.

    Attributes:
        type_name, type_hash: of the messages, empty while unknown.
        endpoints: others' publishers of the topic on the sending side, their subscriptions on the receiving side; of
            calls, the clients and the servers.
        may_move: whether the messages may move a robot (`rsb_bridge.model.motion`).
        channel: of the present opening, or None until it has one.
    """

    type_name = type_hash = ""
    endpoints: Sequence[Endpoint] = ()
    may_move = False
    channel: ChannelT | None = None

    def end(self, reason: str) -> None:
        """Close the channel, as the opening ends."""
        if self.channel is not None:
            channel, self.channel = self.channel, None
            channel.close(reason)


class Facts(Protocol):
    """The knowledge of a half, for its route's verdict, stages and snapshot. What has a body is the usual answer."""

    route: Any

    def stages(self) -> tuple[Stage, ...]:
        """Return the steps of a message's or a call's path."""

    @property
    def came(self) -> bool:
        """Whether messages or calls came in this opening, or the receiving side keeps some of a latched topic."""

    @property
    def came_before(self) -> bool:
        """Whether messages or calls came in an earlier opening, and none in this one."""

    @property
    def owing(self) -> bool:
        """Whether messages or answers are on their way to the other side, or wait for the channel."""

    @property
    def nodes_there(self) -> tuple[str, ...]:
        """Some of the nodes on the other side that have it, as far as they are known."""
        return ()

    @property
    def large_vanish(self) -> bool:
        """Whether none of its last large datagrams has arrived, while smaller ones do."""
        return False

    @property
    def breaking(self) -> str:
        """The reason why its channel breaks before anything arrives, or an empty string."""
        losses: ChannelLosses = self.route.losses
        return losses.repeated if losses.reasons else ""  # nearly always it has none, which saves a call

    @property
    def on_end(self) -> str:
        """The message that the receiving side publishes once an arming ends, or an empty string until it names one."""

    @property
    def velocity(self) -> Velocity | None:
        """The velocity that the receiving side has published last, or None if it is unknown."""
        return None

    @property
    def message_types(self) -> tuple[TypeVersion, ...]:
        """The types of its messages; of calls, also the types of their requests and responses."""

    @property
    def fates(self) -> Fates:
        """The effect of each loss on the route, unless it has to be armed."""

    @property
    def lifespan(self) -> float:
        """Lifespan (s) of what it carries, or 0 for none."""

    @property
    def learns(self) -> bool:
        """Whether its rate and delays are typical now, so that the usual values are learned from them."""

    @property
    def may_not_be_late(self) -> bool:
        """Whether it carries messages that may move a robot, and that are not kept."""
        return False

    def waiting_text(self) -> str:
        """Return why it carries nothing while its link is away and the association goes on, perhaps with `LASTING`."""
        return f"waiting {LASTING} for the link"

    def snapshot_of(self, common: partial[RouteSnapshot]) -> RouteSnapshot:
        """Return the snapshot whose common part is given."""


FactsT = TypeVar("FactsT", bound=Facts)
Rules: TypeAlias = "tuple[Callable[[FactsT, Crossing], Verdict | None], ...]"
"""Rules for what a route carries, over one half and whether messages may cross it, which takes a while to find out.
The order counts: of equally bad verdicts, the first does."""


class Half(Protocol):
    """One side's part in carrying what a route carries.

    Attributes:
        outgoing: whether messages or calls come from ROS here.
        duplex: whether both sides send.
        peer_report: type of the reports that the other side's half sends, or several.
        rules: of its verdict.
    """

    outgoing: ClassVar[bool]
    duplex: ClassVar[bool]
    peer_report: ClassVar[Any]
    rules: ClassVar[Rules[Any]]

    def __init__(self, route: Any) -> None: ...

    @property
    def carried(self) -> Carried[Any]: ...

    @property
    def rests(self) -> bool:
        """Whether nobody wants the messages of a lazy topic."""

    @property
    def facts(self) -> Facts: ...

    # --- events of its route

    def proceed(self) -> None:
        """Do what can be done next. Called by `Route.advance`, at any time and often: it may find nothing to do."""

    def open(self) -> None:
        """Begin a new opening."""

    def close(self, reason: str) -> None:
        """End the opening, while it still has its id and its channel."""

    def destroy(self) -> None:
        """Close what outlives openings."""

    def suspend(self) -> None:
        """Wait, as the link has no connection and its association goes on."""

    def resume(self) -> None:
        """Go on, as the association has another connection."""

    def disarm(self) -> None:
        """Stop what moves, before the other side and operators hear of it."""

    def lapse(self) -> None:
        """Publish the stop message, if there is one, as nothing passes for now.

        Called after `disarm`, by `LinkArming` when the sides do not hear each other, and by a `RestMessage` that no
        message follows.
        """

    def configure(self) -> None:
        """Take over new limits, or what a changed session says. Also called by `Bridge`, which has that session."""

    def restart_measuring(self) -> None:
        """Restart all measurements over time: messages may cross from now on, or no longer."""

    # --- its ends in ROS, where nodes of the other side are mirrored

    @property
    def places(self) -> Sequence[EndPlace]:
        """The endpoints here of what a node of the other side has there."""

    def move(self) -> bool:
        """Make its ends in ROS again, as they belong to other nodes now (`Mirroring.place`), where there are any.

        Returns:
            Whether it could: what callers wait for an answer of stays, and what nobody can repeat to late joiners.
        """

    # --- messages and reports

    def deliver(self, messages: Sequence[Message]) -> None:
        """Take whole, authentic messages. A half that only sends gets none: the peer does not even have its key."""

    def flush(self) -> None:
        """Send more, as the channel has room again. A half that sends nothing ignores it."""

    def news(self) -> Sequence[ReportEntry]:
        """Return what the peer does not know yet. Called by `RouteReports`."""

    def reported(self, report: Any) -> None:
        """Take a report of the peer, a `peer_report`. Called by `RouteReports`."""

    # --- time

    def measure(self, now: float, crossing: Crossing, *, learns: bool) -> None:
        """Update what the verdict follows from. Called first in a tick; must neither advance nor end the opening.

        Args:
            learns: as `Facts.learns`.
        """

    def goes_on(self, now: float) -> bool:
        """Whether its messages have gone on as before, as far as counts tell. Asked in place of a tick, once a second.

        It follows a tick that has found nothing, and messages have come at their usual rate.
        """

    def is_well(self, now: float) -> bool:
        """Whether `measure` has found nothing that one of its rules would name, as far as `signs` do not tell."""

    def is_calm(self, now: float) -> bool:
        """Whether it would be judged the same if nothing had come in the last seconds, and waits for nothing."""

    def act(self, now: float, crossing: Crossing) -> None:
        """Do what follows from the new verdict. Called last in a tick; may advance, or have the route opened again."""

    @property
    def passed(self) -> int:
        """A counter that grows with each message or call; only that it has changed counts."""

    def signs(self) -> Signs:
        """Return values that differ from those of the last tick if anything but a message or time has happened."""

    def next_change(self, now: float, crossing: Crossing) -> float:
        """Return when (s) something changes by itself next, `now` if it may at any moment, or infinity."""
