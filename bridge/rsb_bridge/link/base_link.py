"""The connection to one peer: it comes and goes, and the link's routes and features live on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from rsb_bridge.link.association import NEVER_HANDLED, Association
from rsb_bridge.link.control_channel import ControlChannel
from rsb_bridge.link.extension import Extension, Extensions
from rsb_bridge.link.keepalive import Keepalive
from rsb_bridge.link.route_ids import RouteIds
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
from rsb_bridge.model.transports import outlive_of
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.route.idling import Timetable
from rsb_bridge.route.lifecycle import Revisions
from rsb_bridge.route.peer_budget import PeerBudget
from rsb_bridge.tasks import Tasks
from rsb_bridge.transport.network_news import device_of
from rsb_bridge.wire.codec import encode
from rsb_bridge.wire.messages import Ping, Pong, Receipts
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence
    from enum import StrEnum

    from rsb_bridge.cdr.description import CompareTypes
    from rsb_bridge.context import Context
    from rsb_bridge.link.association import UnhandledMessage
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.link.data_channels import DataChannels
    from rsb_bridge.link.keepalive import ChannelCarrier
    from rsb_bridge.link.link_end import LinkEnd
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.model.verdict import Verdict
    from rsb_bridge.route.message_transform import FindTransforms
    from rsb_bridge.route.peer import LinkPath, LinkRates
    from rsb_bridge.route.route import Route
    from rsb_bridge.telemetry.event_log import About
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.connection import ClientConnection, ServerConnection
    from rsb_bridge.wire.events import Established
    from rsb_bridge.wire.messages import ControlMessageBase, Hello, UrgentMessage, Welcome
    from rsb_bridge.wire.sealing import Role

_E = TypeVar("_E", bound=Extension)


@dataclass(slots=True)
class LinkStatus:
    """Whether a link is up, since when, and why not."""

    since: float  # since when it is up or down, by the steady clock
    cause: LinkCause = LinkCause.NOT_YET  # of its being down, or `LinkCause.NONE`
    reason: str = "not connected yet"
    attempts: int = 0  # failed ones since it was last up
    retry_at: float | None = None  # time of the next attempt, or None if none is planned
    _lasting: tuple[LinkCause, str] | None = None  # what another cause and reason hide for now

    def up(self, since: float) -> None:
        self.since, self.cause, self._lasting = since, LinkCause.NONE, None
        self.attempts, self.retry_at = 0, None

    def down(self, cause: LinkCause, reason: str) -> None:
        self.cause, self.reason, self._lasting = cause, reason, None

    def down_for_now(self, cause: LinkCause, reason: str) -> None:
        """Record a reason that says less about the link than the one before, which `recall` shows again."""
        lasting = self._lasting or (self.cause, self.reason)
        self.down(cause, reason)
        self._lasting = lasting

    def recall(self) -> None:
        """Show the lasting reason again."""
        if self._lasting is not None:
            self.down(*self._lasting)

    def retry_in(self, now: float) -> float | None:
        return None if self.retry_at is None else max(0.0, self.retry_at - now)

    @property
    def state(self) -> State:
        """WAITING until the first attempt has ended, then OK or DOWN."""
        if self.cause is LinkCause.NONE:
            return State.OK
        return State.WAITING if self.cause is LinkCause.NOT_YET else State.DOWN


_CAUSES = {EventCode.LINK_LOST: LinkCause.LOST, EventCode.LINK_SHUT_DOWN: LinkCause.SHUT_DOWN}
"""Causes by the code of a connection's end; with any other code, `LinkCause.CLOSED`."""


class BaseLink:
    """The connection to a peer with the routes that use it, and the features that have registered.

    `rsb_bridge.link.link.Link` is one with all its parts. Its `end` does what a client and a server do differently.
    Facts about a peer or a connection are of the present one, and while the link is down of the last one.
    """

    path: LinkPath
    fullness: LinkRates
    cause: Callable[[], LinkCause]
    """Returns the cause of the link's fault, up or down."""
    report_soon: Callable[[Route], None]
    """Sends a route's counts before the next regular report. May be called for every batch."""
    compare_types: CompareTypes

    def __init__(self, context: Context, name: str, end: LinkEnd, *, is_client: bool, encrypted: bool) -> None:
        self.context = context
        self.end, self.shared_port = end, end.shared_port
        self.transport = context.transports.of_link(context.session.host)  # of the control connection
        self.name = name  # of the client, on both sides
        self.is_client = is_client
        self.role: Role = "client" if is_client else "server"
        self.peer_name = "the server" if is_client else name
        self._peer_role = "the server" if is_client else "the client"
        self.encrypted = encrypted
        self.present: DataChannels | None = None  # of the present connection, if there is one
        self.association: Association | None = None  # while the link is up or suspended
        self._lost_at = 0.0
        self.outlive = 0.0  # s that the association outlives its connection: the smaller number of both sides
        self.peer: Hello | Welcome | None = None  # before the first connection
        self.instance = ""  # process of the peer
        self.connections = 0
        self.via = ""  # device of this machine that carries the last connection, or empty if it is unknown
        self.linked_at = 0.0
        self.looked_at_there = False  # figures of this link, all the time, on the other side
        self.status = LinkStatus(context.clock.steady())
        self.bridges: tuple[str, ...] = ()
        """Names of the bridge nodes in the peer's domain, its own first; empty as long as they are unknown."""
        self.routes: dict[str, Route] = {}  # by key
        self.timetable: Timetable[Route] = Timetable(context.now())
        self.awake: Collection[Route] = self.timetable.awake  # the routes that are not idle
        self.ids = RouteIds(is_client=is_client)
        self.budget = PeerBudget(context.now())  # of what the peer may have this side hold and do
        self.revisions = Revisions()
        self._tasks = Tasks(context.loop, self.fail)
        self.spawn = self._tasks.spawn  # a task that ends with the link; if it fails, the connection ends
        self.extensions = Extensions()
        self.route_fields, self.meter_of = self.extensions.route_fields, self.extensions.meter_of
        self.verdicts: Callable[[Route], Iterable[Verdict]] | None = None
        self.explain: Callable[[Route, Verdict], Verdict] | None = None
        self.transforms: Callable[[Route], FindTransforms | None] | None = None
        self.keepalive = Keepalive(self)
        self.clock, self.stamps = self.keepalive.clock, self.keepalive.stamps
        self.shortages_told: set[bool] = set()  # of kernel buffers, here or there
        self.handlers: dict[type, Callable[[Any], Slices | None]] = {
            Ping: self._on_ping,
            Pong: lambda pong: self.keepalive.answered(pong),  # noqa: PLW0108 -- each connection has another one
            Receipts: lambda receipts: self.channels.take_receipts(receipts),  # noqa: PLW0108 -- as has each association
        }

    def extend(self, extension: _E) -> _E:
        """Register a feature of this link, and return it."""
        self.extensions.add(extension)
        if self.extensions.judging:
            self.verdicts = self.extensions.verdicts
        if self.extensions.explaining:
            self.explain = self.extensions.explain
        if self.extensions.transforming:
            self.transforms = self.extensions.transforms
        self.handlers |= extension.messages
        return extension

    @property
    def is_looked_at(self) -> bool:
        """Whether somebody looks at the figures of its routes all the time, here or there."""
        return self.looked_at_there or self.context.is_looked_at()

    @property
    def changes(self) -> int:
        """How many routes have come or gone so far."""
        return self.timetable.changes

    @property
    def profile(self) -> LinkProfile:
        """The session's profile of the link's network."""
        return self.end.profile

    @property
    def own_outlive(self) -> float:
        """Seconds that an association outlives its connection, as far as this side goes."""
        return outlive_of(self.context.session.outlive, self.end.profile)

    # --- the present connection

    @property
    def channels(self) -> DataChannels:
        """The present connection's channels; the link has to be up."""
        assert self.present is not None
        return self.present

    @property
    def control(self) -> ControlChannel | None:
        return self.present.control if self.present is not None else None

    @property
    def linked(self) -> bool:
        return self.present is not None

    @property
    def suspended_since(self) -> float | None:
        """When (s) its connection was lost, if its association lives on without one, or None."""
        return self._lost_at if self.association is not None and self.present is None else None

    def carriers(self) -> set[ChannelCarrier]:
        return self.present.carriers() if self.present is not None else set()

    def derive_keys(self, route_id: int, *, proposed_here: bool) -> None:
        """Derive the keys of a route. Call it once for each proposal, in the order in which they cross."""
        if self.present is not None:
            self.present.connection_keys.proposed(route_id, "client" if self.is_client is proposed_here else "server")

    def closed(self, route_id: int) -> None:
        """Record that an opening of a route is over."""
        self.ids.closed(route_id)
        if self.present is not None:
            self.present.connection_keys.closed(route_id)

    def open_channel(self, route: Route) -> None:
        """Open the channel of a route, or begin to; while the link is suspended, its next connection does."""
        if self.suspended_since is None:
            self.channels.open(route)

    # --- up and down

    @property
    def down_reason(self) -> str:
        """The reason why it is not linked, for an operator, or an empty string."""
        return "" if self.present is not None else self.status.reason

    @property
    def peer_at(self) -> str:
        """The peer with its address, as the log names it."""
        return f"{self._peer_role} at {self.end.address}"

    def up(self, stream: Stream, connection: ClientConnection | ServerConnection, event: Established) -> ControlChannel:
        """Begin a connection on a stream whose peer is authenticated, and return what takes its further events.

        It resumes the association if both sides do, and begins a new one otherwise. While the link is up, it takes the
        place of the present connection.
        """
        control, moves = ControlChannel(stream, connection, self.handlers, self.lost, self._handled), self.linked
        self.keepalive.stop()
        try:
            again = self._join_association(control, event)
        except ProtocolError as error:
            self.protocol_error(str(error))
            self.end_association()
            control.broken(error)
            return control
        except BaseException:
            control.abort("internal error")  # `fail` does not know it, and its goodbye would end the next connection
            raise
        self.peer, self.instance = event.peer, event.peer.instance
        self.outlive = min(self.own_outlive, event.peer.outlive)
        self.connections += 1
        self.via = device_of(stream.own_address) if self.transport.ip_ports else ""
        before, self.keepalive = self.keepalive, Keepalive(self, stream)
        if again is not None:  # the same process, with the same clocks
            self.keepalive.clock, self.keepalive.stamps = before.clock, before.stamps
        self.clock, self.stamps = self.keepalive.clock, self.keepalive.stamps
        if not moves:
            self.linked_at = self.context.now()
            self.status.up(self.context.clock.steady())
        encryption = f"encrypted with {event.keys.suite.name}" if self.encrypted else "NOT ENCRYPTED"
        linked = "linked" if again is None else "goes on over another connection" if moves else "goes on"
        text = f"{linked} with {self._peer_role} at {stream.peer}, {encryption}, rsb-console {event.peer.version} there"
        self.log(Level.INFO, EventCode.LINK_UP, text, link_status=True)
        self.send(self.keepalive.ping(self.handled))  # the age of messages is unknown until it is answered
        if again is None:
            self.extensions.connected(event.peer.features)
        else:
            self._resume(again)
        return control

    def _join_association(self, control: ControlChannel, event: Established) -> Sequence[UnhandledMessage] | None:
        """Resume the association, and return what the peer lacks of it; or begin a new one, and return None."""
        association, again = self.association, None
        if association is not None and association.resumes(event):
            association.take_up(event.peer.handled)
            if (channels := self.present) is not None:
                self.present, reason = None, "there is another connection"
                channels.control.leave(reason)
                self.extensions.suspend()
                channels.suspend(reason)
            again = association.resume(control, event)
        else:
            self.end_association()
            channels = self.end.new_channels(control, event.keys)
            association = self.association = Association(event.keys.link_id, event.peer.instance, channels)
        self.present = association.channels
        return again

    def _resume(self, again: Sequence[UnhandledMessage]) -> None:
        """Send what the peer has not handled on the last connection, and have the link's parts resume."""
        for message in again:
            if message.proposes:
                self.derive_keys(message.proposes, proposed_here=True)
            self.channels.control.send_encoded(message.content)
        self.extensions.resume()
        self.channels.open_all()

    def _handled(self, message_type: type) -> None:
        if self.association is not None:
            self.association.handles(message_type)

    @property
    def handled(self) -> int:
        """How many control messages of the association this side has handled."""
        return 0 if self.association is None else self.association.handled

    def doubts(self) -> None:
        """Take note that the connection may be dead; called several times a second on a client meanwhile."""
        self.end.doubts()

    def silent(self) -> None:
        """End the connection: nothing has come for as long as the patience lasts."""
        self.channels.is_silent = True
        control, quiet, alone = self.channels.control, self.keepalive.quiet, self.keepalive.control_quiet
        if alone < 2 * quiet:
            text = f"the peer is silent: nothing came for {quiet:.0f} s"
            control.abort(f"{text}: check that it is on and does not hang, its cable or Wi-Fi, and firewalls")
        else:
            text = f"nothing came on the control connection for {alone:.0f} s, though other data does"
            control.abort(f"{text}: check firewalls, proxies and VPNs between the two sides")

    def lost(self, reason: str, code: EventCode) -> None:
        """End the connection."""
        self.keepalive.stop()
        # Before the extensions end: what they still send goes nowhere, and they find no link.
        channels, self.present = self.present, None
        if channels is not None:  # else `up` has failed, and there was no link
            self._down(channels, self.end.why_lost(reason) if code is EventCode.LINK_LOST else reason, code)
        self.end.lost()

    def _down(self, channels: DataChannels, reason: str, code: EventCode) -> None:
        """Show why the connection is over, and suspend the association, or end it."""
        cause = _CAUSES.get(code, LinkCause.CLOSED)
        # The most telling first: without its router a link is silent, too.
        if cause is LinkCause.LOST and self.transport.problem:
            cause, reason = LinkCause.ROUTER_LOST, self.transport.problem
        elif cause is LinkCause.LOST and channels.is_silent:
            cause = LinkCause.SILENT
        self.status.down(cause, reason)
        # `down` leaves the time as it is: each failed attempt calls it, but the link is down since now.
        self.status.since = self.context.clock.steady()
        self._lost_at = self.context.now()
        association, seconds = self.association, self.outlive
        is_broken = channels.control.is_fault or code is not EventCode.LINK_LOST
        if association is None or association.is_over or is_broken or not seconds:
            self.end_association()
        else:
            self.extensions.suspend()
            association.suspend(reason, self.context.loop.call_later(seconds, self._expire))
            reason = f"{reason}; its topics and calls wait for {seconds:g} s"
        level = Level.INFO if code is EventCode.LINK_CLOSED else Level.WARNING
        how = "lost" if code is EventCode.LINK_LOST else "closed"
        self.log(level, code, f"link with {self.peer_at} {how}: {reason}", link_status=True)

    def _expire(self) -> None:
        text = f"the link was away for {self.outlive:g} s: what waited for it is dropped"
        self.log(Level.WARNING, EventCode.LINK_CLOSED, text, link_status=True)
        self.end_association()

    def end_association(self) -> None:
        """End the association of a link without a connection: the next connection begins with nothing."""
        association, self.association = self.association, None
        if association is not None:
            self.extensions.disconnected()
            association.end()

    def destroy(self) -> None:
        """End routes and tasks for good."""
        self.end_association()
        self._tasks.cancel()
        self.destroy_routes()

    def destroy_routes(self) -> None:
        for route in self.routes.values():
            route.destroy()
        self.routes.clear()

    def guarded(self, work: Callable[[], None]) -> None:
        """Do regular work of this link. If it fails, this link's connection ends, and no other."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 -- any failure is this link's own
            self.context.loop.call_exception_handler({"message": f"link {self.name} failed", "exception": error})
            self.fail()

    def leave(self, reason: str, *, retry_after: float | None, code: EventCode = EventCode.LINK_CLOSED) -> None:
        """End the connection on purpose, and tell the peer; without one, at most an association ends."""
        if self.present is not None:
            self.extensions.leaving()
            self.present.control.shut_down(reason, retry_after=retry_after, code=code)
        else:
            self.end_association()

    def fail(self) -> None:
        """End the connection after an internal error, so that both sides start from the beginning."""
        if self.control is not None:
            self.control.is_fault = True
            self.control.abort("internal error")

    def protocol_error(self, reason: str) -> None:
        """End the connection: the peer broke the protocol."""
        if self.control is not None:
            self.control.broken(reason)

    # --- control messages

    def send(self, message: ControlMessageBase) -> bytes:
        """Send a control message; without a connection it waits if the link is suspended, and else nothing happens.

        Returns:
            The message as it is sent.
        """
        content = encode(message)
        if self.association is not None:
            self.association.sends(message, content)
        if self.present is not None:
            self.present.control.send_encoded(content)
            if self.association is not None and self.association.is_over:
                self.present.control.stream.abort(NEVER_HANDLED)  # `lost` comes later
        elif self.association is not None and self.association.is_over:
            self.end_association()
        return content

    def send_urgent(self, message: UrgentMessage) -> None:
        """Send a control message, and over the UDP channels besides: there it does not wait for what a stream lost."""
        content = self.send(message)
        if self.present is not None:
            self.present.send_urgent(content)

    def _on_ping(self, ping: Ping) -> None:
        if self.association is not None:
            try:
                self.association.acknowledge(ping.handled)
            except ProtocolError as error:
                self.protocol_error(str(error))
                return
        if (pong := self.keepalive.answer(ping)) is not None:
            self.send(pong)

    # --- time and figures

    def tick(self) -> None:
        """Do the link's own regular work once a second, after the routes' and before that of its extensions."""
        if self.present is not None:
            self.send(self.keepalive.tick(self.handled))
            self.present.tick()
        self.end.tick()

    def log_of_peer(self, level: Level, code: StrEnum, text: str, *, link_status: bool = False) -> None:
        """Add an event about this link that names the peer."""
        self.log(level, code, f"{self.peer_at}: {text}", link_status=link_status)

    def log(self, level: Level, code: StrEnum, text: str, *, topic: str = "", link_status: bool = False) -> None:
        """Add an event about this link; `link_status` means that it tells whether the link is up."""
        about: About = {"link": self.name, "topic": topic}
        if link_status:
            since = self.context.wall_of(self.status.since)
            about |= {"state": self.status.state, "since": since, "cause": self.cause()}
        self.context.log(level, code, text, link_status=link_status, **about)
