"""This side's end of the bridge, on the I/O thread: a client's one link, or a server with many."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import msgspec

from rsb_bridge import __version__
from rsb_bridge.config.keys import Key
from rsb_bridge.config.rights import rights_of_client
from rsb_bridge.installed_features import feature_names
from rsb_bridge.link.client_end import ClientEnd
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.link.link_server import Server
from rsb_bridge.link.reloading import ReloadStep, client_steps, server_steps
from rsb_bridge.link.server_end import ClientEntry
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import plural
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.tasks import Tasks, in_slices
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import Hello
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.model.snapshot import RefusedClient
    from rsb_bridge.route.route import Route

_RESTART_WITHIN = 5.0
"""s that a restart waits for the peers. A round figure."""
_LOOK_EVERY = 0.05  # s. A round figure: a restart takes so much longer at most
_FAREWELL = 0.5
"""s in which a peer can take the reason. A round figure: if a peer takes nothing, a bridge stops so much later."""
_RESTARTED_AFTER, _LONGEST_PAUSE = 1.0, 10.0
_BOUND_AFTER, _LONGEST_BIND_PAUSE = 0.5, 5.0
"""s. Round figures: nothing was measured."""

Keys = Mapping[str, tuple[Key, ...]]
"""Valid keys by the client's name, the next one last; an empty tuple means no encryption."""
ReportStep = Callable[[str], None]
"""Takes each step of a restart, as text for an operator."""


def _entries(session: Session, keys: Keys) -> list[ClientEntry]:
    return [
        ClientEntry(each, keys[each.name], each.is_prefixed(session), rights_of_client(each, session.name))
        for each in session.accepted_clients
    ]


def _own(keys: Keys, session: Session) -> Key | None:
    """Return the key of a client's session, or None."""
    return next(iter(keys[session.name]), None)


class ClientRole:
    """A client and its one link."""

    def __init__(self, context: Context, keys: Keys) -> None:
        session = context.session
        instance, host = context.ros.instance_id, socket.gethostname()
        hello = Hello(__version__, session.name, instance, context.domain_id, host, feature_names())
        self._context = context
        self._end = ClientEnd(context, hello, _own(keys, session), preferred_suite())
        self._link = self._end.link
        self._tasks = Tasks(context.loop, self._link.fail)

    async def start(self) -> None:
        await in_slices(self._context.session.topics, self._link.entries.add)
        self._tasks.keep(self._end.run, Backoff(_RESTARTED_AFTER, _LONGEST_PAUSE, self._context.random))

    async def stop(self) -> None:
        self._tasks.cancel()  # else it would connect again after its goodbye
        await _farewell(self.links(), "the client stops")
        self._link.destroy()

    @property
    def session(self) -> Session:
        armed = self._context.demands.written
        return msgspec.structs.replace(self._context.session, topics=self._link.entries.all(), armed=armed)

    @property
    def unsaved(self) -> bool:
        return self._context.in_file.differs(self.session)

    @property
    def keys(self) -> Keys:
        return {self._link.name: () if self._end.key is None else (self._end.key,)}

    def links(self) -> list[Link]:
        return [self._link]

    def refused(self) -> tuple[RefusedClient, ...]:
        return ()

    def tick(self) -> None:
        """Do nothing: the link has its own tick."""

    def add(self, topic: Topic, link: str) -> tuple[Link, str, Topic]:
        return self._link, self._link.entries.add(topic), topic

    def steps_to(self, session: Session, keys: Keys) -> Iterator[ReloadStep]:
        return client_steps(self._end, session, _own(keys, session))

    def retry(self, link: str) -> None:
        self._end.retry()

    def shut_down(self, who: str) -> None:
        self._end.stay_down(f"shut down by {who}")

    async def restart(self, step: ReportStep) -> None:
        if self._link.control is not None:
            step(f"closing the link with {self._end.address} on both sides")
            self._link.control.shut_down("restart", retry_after=0.0)
        step(f"connecting to {self._end.address}")
        self._end.retry()
        await _until(lambda: self._link.linked, lambda: self._link.status.reason)
        step("linked; opening topics and services")

        def listed() -> list[Route]:  # at each call, as an edit replaces a route; views are not listed
            return [route for route in self._link.routes.values() if route.purpose.in_graph]

        await _until(
            lambda: all(route.life.accepted or route.life.refusal for route in listed()),
            lambda: "the server has not answered for all topics and services yet",
        )
        routes = listed()
        refused = sum(1 for route in routes if route.life.refusal)
        step(f"{len(routes) - refused} of {len(routes)} topics and services accepted")


class ServerRole:
    """A server and its links."""

    def __init__(self, context: Context, keys: Keys) -> None:
        session = context.session
        self._context = context
        self._server = Server(context, _entries(session, keys), aes=preferred_suite() is CipherSuite.AESGCM)
        self._tasks = Tasks(context.loop, lambda: self._bind_later("internal error"))
        self._restarting = asyncio.Lock()
        self._binding: asyncio.Task[None] | None = None
        self._stopped = False

    async def start(self) -> None:
        """Bind; raise ListenError if a port of this machine cannot be bound."""
        for end in self._server.ends.values():
            await in_slices(end.entry.client.topics, end.link.entries.add)
        if failure := await self._bind():
            # An address of this machine that cannot be bound is a mistake; a router elsewhere may come later.
            if self._context.transports.of_link(self._context.session.host).local:
                raise ListenError(failure)
            self._bind_later(failure)

    async def stop(self) -> None:
        self._stopped = True
        self._tasks.cancel()
        await self._leave(self.links(), "the server stops")
        for link in self.links():
            link.destroy()

    @property
    def session(self) -> Session:
        ends = tuple(self._server.ends.values())
        clients = tuple(msgspec.structs.replace(each.entry.client, topics=each.link.entries.all()) for each in ends)
        session = msgspec.structs.replace(self._context.session, armed=self._context.demands.written)
        # The form of a session for one client has no place for topics that the server proposes; without any, it stays.
        if session.clients is None and not any(client.topics for client in clients):
            return session
        return session.with_clients(clients)

    @property
    def unsaved(self) -> bool:
        return self._context.in_file.differs(self.session)

    @property
    def keys(self) -> Keys:
        return {name: entry.keys for name, entry in self._server.entries.items()}

    def links(self) -> list[Link]:
        return [end.link for end in self._server.ends.values()]

    def refused(self) -> tuple[RefusedClient, ...]:
        return self._server.refused_clients.shown()

    def tick(self) -> None:
        self._server.tick()

    def add(self, topic: Topic, link: str) -> tuple[Link, str, Topic]:
        """Bridge one more topic, or follow a pattern; return its link, its key, and the topic with the client's names.

        Raises:
            LinkError: the topic has a mistake or exists already, or it is unclear which link is meant.
        """
        chosen = self._chosen(link, topic.topic)
        topic = chosen.end.client_names(topic)
        return chosen, chosen.entries.add(topic), topic

    def steps_to(self, session: Session, keys: Keys) -> Iterator[ReloadStep]:
        return server_steps(self._server, _entries(session, keys))

    def _chosen(self, name: str, topic: str) -> Link:
        """Return the named link; without a name, the only link, or the only one whose prefix the topic has."""
        links = {link.name: link for link in self.links()}
        if name in links:
            return links[name]
        found = list(links.values())
        if len(found) > 1:
            found = [link for link in found if link.end.use_name and client_topic(topic, link.name) is not None]
        if not name and len(found) == 1:
            return found[0]
        raise LinkError(Denied.WHICH_CLIENT(clients=", ".join(links)))

    def retry(self, link: str) -> None:
        for robot in self._server.ends.values():
            if link in ("", robot.link.name):
                robot.readmit()
                robot.link.table.retry()

    def shut_down(self, who: str) -> None:
        """Close every link on both sides until an operator restarts."""
        self._server.shut_down(who)

    async def restart(self, step: ReportStep) -> None:
        if self._restarting.locked():
            raise LinkError(Denied.RESTARTING())
        async with self._restarting:
            await self._restart(step)

    async def _restart(self, step: ReportStep) -> None:
        linked = [link for link in self.links() if link.linked]
        for robot in self._server.ends.values():
            robot.readmit()
        step(f"closing {len(linked)} {plural(len(linked), 'link')} on both sides")
        if self._binding is not None:
            self._binding.cancel()  # it would close the ports that are bound below
        await self._leave(linked, "restart")
        step(f"binding {self._context.session.host} port {self._context.session.server_port}")
        if self._stopped:  # during the farewell: a port that is bound now would stay bound
            raise LinkError(Denied.SERVER_STOPS())
        if failure := await self._bind():
            self._bind_later(failure)
            raise LinkError(Denied.RESTART_FAILED(failure=failure))
        step("waiting for the clients to come back")
        absent = "not every client is back yet; they keep trying"
        await _until(lambda: all(link.linked for link in linked), lambda: absent)
        step("1 client is back" if len(linked) == 1 else f"{len(linked)} clients are back")

    async def _leave(self, links: Iterable[Link], reason: str) -> None:
        """Stop listening, and say goodbye to clients, which would come back at once."""
        self._server.stop()
        await _farewell(links, reason)

    def _bind_later(self, reason: str) -> None:
        """Keep trying to bind; `reason` is the last failure."""
        if not self._stopped:
            self._binding = self._tasks.spawn(self._keep_binding(reason))

    async def _keep_binding(self, reason: str) -> None:
        backoff, said = Backoff(_BOUND_AFTER, _LONGEST_BIND_PAUSE, self._context.random), ""
        while reason:
            self._server.stop()  # releases the ports that it has bound
            for link in self.links():
                link.status.down(LinkCause.UNREACHABLE, f"the server is not listening: {reason}")
            level = Level.DEBUG if reason == said else Level.ERROR
            self._context.log(level, EventCode.ENGINE_NOT_LISTENING, f"not listening: {reason}; trying again")
            said = reason
            await asyncio.sleep(backoff.next())
            reason = await self._bind()
        for link in self.links():
            link.status.down(LinkCause.CLOSED, "not connected since the restart")

    async def _bind(self) -> str:
        """Bind the server's ports; return the failure, or an empty string."""
        try:
            await self._server.start()
        except ListenError as error:
            return str(error)
        return ""


BridgeRole: TypeAlias = ClientRole | ServerRole
"""This side's end of the bridge."""


async def _farewell(links: Iterable[Link], reason: str) -> None:
    """Close links, and wait up to 0.5 s until their peers have been sent the reason."""
    links = [*links]
    streams = [link.control.stream for link in links if link.control is not None]
    for link in links:
        link.leave(reason, retry_after=0.0)
    loop = asyncio.get_running_loop()
    deadline = loop.time() + _FAREWELL
    while any(not stream.gone for stream in streams) and loop.time() < deadline:  # noqa: ASYNC110 -- plain state, polled for a moment
        await asyncio.sleep(0.01)
    for stream in streams:
        stream.abort(reason)


async def _until(condition: Callable[[], bool], otherwise: Callable[[], str]) -> None:
    """Wait until a condition holds; after 5 s, raise `LinkError` with the message that `otherwise` gives."""
    try:
        async with asyncio.timeout(_RESTART_WITHIN):
            while not condition():  # noqa: ASYNC110 -- plain state, polled for a moment
                await asyncio.sleep(_LOOK_EVERY)
    except TimeoutError:
        raise LinkError(otherwise()) from None


def preferred_suite() -> CipherSuite:
    """Return AES-GCM if the processor has AES instructions (a flag in /proc/cpuinfo), else ChaCha20-Poly1305."""
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").split()
    except OSError:
        return CipherSuite.CHACHAPOLY
    # ns a byte with AES instructions: AES-GCM 0.35, ChaCha20-Poly1305 1.0; without them 5.4 and 1.5 (bench/README).
    return CipherSuite.AESGCM if "aes" in flags else CipherSuite.CHACHAPOLY
