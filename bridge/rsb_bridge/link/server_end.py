"""The server's end of a client's link, and the session's entry of that client."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import msgspec

from rsb_bridge.config.keys import fingerprint
from rsb_bridge.link.link import Link
from rsb_bridge.link.refused_clients import ASKED_EVERY, FORGOTTEN_AFTER, LinkShutdown, name_taken
from rsb_bridge.link.server_channels import ServerChannels
from rsb_bridge.link.topic_ports import TopicPorts, check_topic_port
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.fingerprints import format_fingerprint
from rsb_bridge.model.names import client_topic, server_topic
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.transports import profile_of
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import Duplicate, Hello, Propose, Shutdown
from rsb_bridge.wire.sealed_stream import ReplayCache

if TYPE_CHECKING:
    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.context import Context
    from rsb_bridge.link.control_channel import ControlChannel
    from rsb_bridge.link.topic_ports import DescriptorShare
    from rsb_bridge.model.session import Client, Kind, Topic
    from rsb_bridge.model.snapshot import WaySnapshot
    from rsb_bridge.model.transports import LinkProfile
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.ports import Ports
    from rsb_bridge.transport.streams import Stream
    from rsb_bridge.wire.connection import ServerConnection
    from rsb_bridge.wire.events import Established
    from rsb_bridge.wire.sealing import ConnectionKeys

_SILENT = 1.5
"""s without a byte (pings come every second) after which another process may take a client's name over
(PROTOCOL.md, 1.1)."""


@dataclass(frozen=True, slots=True)
class ClientEntry:
    """A client that the server accepts."""

    client: Client
    keys: tuple[Key, ...]  # valid ones, the next one last; empty without encryption
    use_name: bool  # whether the server prefixes its topics with its name
    rights: Rights

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """Fingerprints of its keys, or one empty string without keys."""
        return tuple(map(fingerprint, self.keys)) or ("",)


@final
class ServerEnd:
    """The server's end of the link of one client, which it makes."""

    def __init__(self, context: Context, entry: ClientEntry, ports: Ports, descriptors: DescriptorShare) -> None:
        self._context = context
        self.entry = entry
        self.replays = ReplayCache()
        self.descriptors = descriptors
        self._ports = ports
        self._topic_ports = TopicPorts(entry.client.name)
        self._seen_at = self.seen_host = ""  # where the client last was
        self._seen_key = ""  # on the present connection
        self._refused_at: float | None = None
        self._told = Duplicate()  # on the present connection
        self.shut_down_by: LinkShutdown | None = None
        self.link = Link(context, entry.client.name, self, is_client=False, encrypted=bool(entry.keys))
        self.link.handlers |= {Duplicate: self._on_duplicate, Shutdown: self._on_shutdown}

    @property
    def address(self) -> str:
        return self.link.control.stream.peer if self.link.control else self._seen_at

    @property
    def profile(self) -> LinkProfile:
        return profile_of(self.entry.client.profile, self._context.session.profile)

    @property
    def fingerprints(self) -> tuple[str, str]:
        current, *following = self.entry.fingerprints
        return self._seen_key if self.link.linked else current, "".join(following)

    def accept(self, stream: Stream, connection: ServerConnection, event: Established) -> ControlChannel:
        """Link with the client; see `rsb_bridge.link.base_link.BaseLink.up`."""
        self._seen_at, self.seen_host = stream.peer, stream.host
        self._seen_key = format_fingerprint(connection.fingerprint)
        self._told = Duplicate()
        control = self.link.up(stream, connection, event)
        _, following = self.fingerprints
        if following:  # the log on disk has it when `client rekey --finish` looks for it
            which = "next" if self._seen_key == following else "old"
            text = f"linked with its {which} key, {self._seen_key}"
            self._context.log(Level.INFO, EventCode.KEY_USED, text, link=self.link.name, new=self._seen_key)
        return control

    def refused(self, stream: Stream, cause: LinkCause, message: str) -> None:
        """Record the refusal of a client by this name, while the link is down."""
        if self.shut_down_by is not None:  # the operator's shutdown stays the reason
            return
        # For now: anybody who knows the name may have asked, and the client that is missing stays missing.
        self.link.status.down_for_now(cause, f"refused {stream.host}: {message}")
        self._refused_at = self._context.now()

    # --- shut down by an operator

    def shut_down_for(self, who: str) -> None:
        """End the link, and refuse the client until `readmit`."""
        self.shut_down_by = LinkShutdown(who, self._context.wall())
        linked = self.link.linked
        self.link.leave(self.shut_down_by.refusal(), retry_after=None, code=EventCode.LINK_SHUT_DOWN)
        if linked:
            self._awaits_question()
        # After the link's end, which sets a reason of its own.
        self.link.status.down(LinkCause.SHUT_DOWN, self.shut_down_by.reason(self._context.session.name, self.link.name))
        self.link.status.since = self._context.clock.steady()

    def asked(self, stream: Stream) -> None:
        """Record that the client has asked for a link, and was refused."""
        self._seen_at, self.seen_host = stream.peer, stream.host
        self.link.status.attempts += 1
        self._awaits_question()

    def _awaits_question(self) -> None:
        self.link.status.retry_at = self._context.now() + ASKED_EVERY

    def readmit(self) -> None:
        """Accept the client again if an operator has shut its link down."""
        if self.shut_down_by is not None:
            self.shut_down_by = None
            self.link.status.down(LinkCause.CLOSED, "accepted again by an operator; the client has not asked yet")

    # --- two clients of one name

    def keeps_name_from(self, hello: Hello) -> bool:
        """Whether a client must not take the name over: another process has it, and is not silent."""
        if not self.link.linked or not isinstance(self.link.peer, Hello) or hello.instance == self.link.peer.instance:
            return False
        return self.link.keepalive.quiet < _SILENT

    def name_taken(self) -> str:
        """Return the text on a second client, for both sides."""
        first = self.link.peer.host if isinstance(self.link.peer, Hello) else ""
        return name_taken(self.link.name, self.address, first, self._context.wall_of(self.link.status.since))

    def duplicate_tried(self, address: str, host: str) -> None:
        """Record that a second client with a valid key was refused, unless the first one has gone meanwhile."""
        if self.link.linked:
            self.link.fault.duplicates.tried(address, host, self._context.now(), self._context.wall())

    def tick(self) -> None:
        now = self._context.now()
        if not self.link.linked:
            self._watch_router()
            if self._refused_at is not None and now - self._refused_at > FORGOTTEN_AFTER:
                self._refused_at = None
                self.link.status.recall()
        if self.link.status.retry_at is not None and now > self.link.status.retry_at + ASKED_EVERY:
            self.link.status.retry_at = None  # it does not ask any more
        duplicates = self.link.fault.duplicates
        news = duplicates.news(now)
        if self.link.linked and news != self._told:
            if not news.address:
                self.link.log(Level.INFO, EventCode.LINK_NAME_FREE, duplicates.ended_text(), link_status=True)
            self._told = news
            self.link.send(news)

    def _watch_router(self) -> None:
        """Show the link as down while its network's router is lost."""
        problem, cause = self.link.transport.problem, self.link.status.cause
        if problem and cause is not LinkCause.SHUT_DOWN:
            self.link.status.down_for_now(LinkCause.ROUTER_LOST, problem)
        elif not problem and cause is LinkCause.ROUTER_LOST:
            self.link.status.recall()
            if self.link.status.cause is LinkCause.ROUTER_LOST:  # it was the router that the link was lost with
                self.link.status.down(LinkCause.LOST, "the router is back; waiting for the client")

    def shared_port(self) -> int:
        return self._context.session.server_port

    def new_channels(self, control: ControlChannel, keys: ConnectionKeys) -> ServerChannels:
        return ServerChannels(self.link, self.descriptors, control, keys)

    @property
    def channels(self) -> ServerChannels:
        channels = self.link.present
        assert isinstance(channels, ServerChannels)
        return channels

    def has_id(self, link_id: bytes) -> bool:
        """Whether its present connection has an id; all links are asked for each datagram of a stranger."""
        channels = self.link.present
        return channels is not None and channels.connection_keys.link_id == link_id

    @property
    def use_name(self) -> bool:
        return self.entry.use_name

    @property
    def prefixed(self) -> bool:
        return self.entry.use_name

    @property
    def shut_down(self) -> bool:
        return False  # it is the client that waits for its operator

    def ways_shown(self) -> tuple[WaySnapshot, ...]:
        return ()

    def doubts(self) -> None:
        return

    def why_lost(self, reason: str) -> str:
        return reason

    def lost(self) -> None:
        return

    def _on_shutdown(self, message: Shutdown) -> None:
        reason = f"the client left: {message.reason}"
        if message.retry_after is None:
            command = f"rsb-console retry {shlex.quote(self.link.name)}"
            reason += f"; press r in its console or run `{command}` on its machine to connect it again"
        self.link.reports.peer_leaves()
        self.link.channels.control.abort(reason, EventCode.LINK_CLOSED_BY_PEER)

    def client_names(self, topic: Topic) -> Topic:
        # Where `use_name` is set, ``/robot1/scan`` is robot1's ``/scan``. A topic with a `remote_topic` has both names.
        name = client_topic(topic.topic, self.link.name) if self.use_name and topic.remote_topic is None else None
        return topic if name is None else msgspec.structs.replace(topic, topic=name)

    def _on_duplicate(self, _: Duplicate) -> None:
        self.link.protocol_error("a client says that there is a second client")

    @property
    def rights(self) -> Rights:
        return self.entry.rights

    def with_local_name(self, proposal: Propose) -> Propose:
        field = "remote_topic" if proposal.from_client else "topic"
        name = getattr(proposal, field)
        if not self.use_name or client_topic(name, self.link.name) is not None:  # it has the client's prefix already
            return proposal
        return msgspec.structs.replace(proposal, **{field: server_topic(name, self.link.name)})

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        entry = self.entry  # read once: it may be replaced while another thread asks
        reachable = not entry.use_name or client_topic(topic, self.link.name) is not None
        return reachable and entry.rights.shows(topic, kind)

    def change_entry(self, entry: ClientEntry) -> None:
        """Use another entry of the session.

        The link ends if the client's key is no longer valid, or if the names of topics change.
        """
        old, self.entry = self.entry, entry
        self._context.demands.changed()
        self.link.encrypted = bool(entry.keys)
        if not self.stays_valid(entry):
            self.link.leave(f"the server has another key for {self.link.name} now", retry_after=0.0)
        if old.use_name != entry.use_name:  # all routes have other names on this side
            self.link.leave("use_name was changed on the server", retry_after=0.0)
            own = self.link.entries.all()
            self.link.destroy_routes()
            for topic in own:
                if not topic.is_pattern:
                    self.link.proposed.add(topic)
        self.link.table.rights_changed()
        self.link.patterns.renew()

    def stays_valid(self, entry: ClientEntry) -> bool:
        """Whether the key that the linked client has is valid with another entry of it."""
        return self._seen_key in entry.fingerprints

    async def prepare_port(self, route: Route) -> None:
        port, route_id, transport = route.proposal.port, route.id, route.transport
        same_numbers = transport.port_kind == self.link.transport.port_kind  # channel 5 is not port 5
        if not port or (same_numbers and port == self.shared_port()):
            return
        check_topic_port(self._context.domain_id, transport, port)
        if refusal := self.descriptors.refusal:
            raise ListenError(refusal)
        with ExitStack() as taken:  # gives all of it back if the port cannot be bound, or is not used any more
            taken.callback(self.descriptors.take())
            if not route.proposed_here:  # ports in this side's own session are not the client's wish
                taken.callback(self._topic_ports.reserve(self._context.session, transport, port))
            taken.callback(await self._ports.open(transport.name, port))
            if route.id == route_id and route.release_port is None:  # else it was closed while the port was being bound
                route.release_port = taken.pop_all().close
