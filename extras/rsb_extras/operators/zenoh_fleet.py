"""A fleet over Zenoh: engines announce themselves; operators' consoles find them, and attach sealed from end to end."""

from __future__ import annotations

import asyncio
import os
import time
from functools import partial
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.control.control_sockets import ControlError, UnclearError
from rsb_bridge.control.sealed import OperatorConnector, SealedAcceptor
from rsb_bridge.control.summaries import SummaryBuilder
from rsb_bridge.feature_api import Engine, EventCode, Level, Wording, join_first
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.limits import NAME_BYTES
from rsb_bridge.transport.trials import Trials, UnprovenError
from rsb_extras.zenoh import ZENOH_HOST
from rsb_extras.zenoh.endpoint import ROUTER_LOST
from rsb_extras.zenoh.network import Network
from rsb_extras.zenoh.outbox import LINK_RANK
from rsb_extras.zenoh.pipe import Pipe
from rsb_extras.zenoh.zenoh_transport import ZenohTransport

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import Connection
    from rsb_bridge.engine.access import Access
    from rsb_bridge.feature_api import ControlServer
    from rsb_extras.operators.fleet_file import FleetFile
    from rsb_extras.zenoh.endpoint import Seen, ZenohEndpoint
    from rsb_extras.zenoh.sample_header import Header

ENGINE, CONSOLE = "engine", "console"
"""The services by which engines and consoles announce themselves."""

_NAMES = 20
"""That a message names."""
_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 10.0


class EngineChoice(Wording):
    """Reasons why a console finds no engine of a fleet, or not one alone."""

    NONE = "no engine is in the fleet {fleet}"
    UNKNOWN = "no engine {engine!r} is in the fleet {fleet}{known}"
    SAME_NAME = "{count} engines of the fleet {fleet} are named {engine!r}: give each its own name"
    NONE_PROVEN = (
        "none of {count} engines named {engine!r} has proven the key: "
        "set access control on the router; one says: {answer}"
    )
    ONE_UNPROVEN = "{count} other engine of this name has not proven the key: set access control on the router"
    SEVERAL_UNPROVEN = "{count} other engines of this name have not proven the key: set access control on the router"


class Member(NamedTuple):
    """An engine's announcement in a fleet. It is not authenticated: anybody may use any name.

    Attributes:
        address: of its endpoint, new in each of its lives.
    """

    name: str
    role: str
    version: str
    address: str


def announce(server: ControlServer) -> None:
    """Announce an engine to the fleet of its session, and let its operators in, until its server closes.

    Nothing happens unless the engine runs in this process, in a Zenoh network.
    """
    engine = server.engine
    transport = engine.transports.find("zenoh") if isinstance(engine, Engine) else None
    if isinstance(engine, Engine) and isinstance(transport, ZenohTransport):
        EngineAnnouncement(server, engine.access, transport.network)


class EngineAnnouncement:
    """Announces an engine, and lets its operators in, until its server closes.

    Args:
        server: serves the engine; it has been started.
    """

    def __init__(self, server: ControlServer, access: Access, network: Network) -> None:
        self._says_so = server.engine.session.host != ZENOH_HOST  # else the links do
        self._events = access.events
        server.summarize = SummaryBuilder(server.engine, server.info.program)
        self._acceptor = SealedAcceptor(server, access)
        self._network = network
        self._backoff = Backoff(_FIRST_PAUSE, _LONGEST_PAUSE, Random())  # noqa: S311 -- jitter, no secret
        info = server.info
        self._label = f"{info.role} {info.program} {info.name}"
        self._endpoint: ZenohEndpoint | None = None
        self._task: asyncio.Task[None]
        server.at_end(self._close)
        server.loop.call_soon_threadsafe(self._begin)

    def _begin(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._announce())

    async def _announce(self) -> None:
        """Join the network, however long it is not reached."""
        fleet, told = self._network.settings.fleet, ""
        while self._endpoint is None:
            try:
                self._endpoint = await self._network.endpoint(ENGINE, self._label, (CONSOLE,))
            except OSError as error:
                if told != (told := str(error)):
                    self._tell(Level.WARNING, f"not announced to the fleet {fleet}: {told}; trying again")
                await asyncio.sleep(self._backoff.next())
        self._endpoint.on_stream = partial(self._accept, self._endpoint)
        self._endpoint.when_retired = self._begin_again
        if told:
            self._tell(Level.INFO, f"announced to the fleet {fleet}")

    def _begin_again(self) -> None:
        """Announce it in the new session of the network; consoles that are attached go on in the old one."""
        self._endpoint = None
        self._begin()

    def _tell(self, level: Level, text: str) -> None:
        if self._says_so:
            self._events.add(level, EventCode.ENGINE_FLEET, text)

    def _accept(self, endpoint: ZenohEndpoint, sender: str, stream: str, header: Header) -> Pipe:
        console = self._acceptor.protocol()
        pipe = Pipe(endpoint, sender, stream, header.rank, console, stranger=True)
        console.when_attached = pipe.trust
        return pipe

    def _close(self) -> None:
        self._task.cancel()
        if self._endpoint is not None:
            self._endpoint.close()


class FleetPresence:
    """A console's place in a fleet, on the loop that runs when it is made. Joined once.

    Args:
        file: names the fleet, and the operator.

    Attributes:
        members: the engines that are there, by address; from `join` on.
        changed: called when one comes (True) or goes.
    """

    def __init__(self, file: FleetFile) -> None:
        self.members: dict[str, Member] = {}
        self.changed: Callable[[Member, bool], None] = _nobody
        self._file = file
        self._network = Network(file.zenoh, file.path.parent)
        self._endpoint: ZenohEndpoint | None = None

    async def join(self) -> None:
        """Be in the network, and know who is there.

        Raises:
            OSError: it is not reached; the message says why.
        """
        endpoint = self._endpoint = await self._network.endpoint(CONSOLE, self._file.operator, (ENGINE,))
        endpoint.on_seen = lambda seen, comes: self._seen(seen, comes=comes)
        for seen in tuple(endpoint.seen.values()):
            self._seen(seen, comes=True)

    @property
    def problem(self) -> str:
        """The reason the network is not reached, or an empty string."""
        return "" if self._network.connected else f"{self._network.place}: {ROUTER_LOST}; trying again"

    def sealed(self, member: Member) -> OperatorConnector:
        """Return a connector to an engine, with the operator's key; usable until this leaves the network."""

        async def connect(protocol: asyncio.Protocol) -> None:
            assert self._endpoint is not None
            Pipe(self._endpoint, member.address, os.urandom(8).hex(), LINK_RANK, protocol)

        return OperatorConnector(connect, self._file.operator, self._file.key, member.name, member.address)

    def close(self) -> None:
        """Leave the network."""
        if self._endpoint is not None:
            self._endpoint.close()
            self._endpoint = None
        self._network.close()

    def _seen(self, seen: Seen, *, comes: bool) -> None:
        role, _, rest = seen.label.partition(" ")
        version, _, name = rest.partition(" ")
        if not name or len(name.encode()) > NAME_BYTES:  # no engine's: the handshake has no room for it
            return
        member = Member(name, role, version, seen.address)
        if not comes:
            self.members.pop(seen.address, None)
        elif seen.address not in self.members:
            self.members[seen.address] = member
        else:
            return
        self.changed(member, comes)


class FleetConnector:
    """Connects to a fleet's engine by its name. Each connection joins the network by itself.

    Args:
        file: names the fleet, and the operator.
        engine: the name of its session, or empty for the only engine of the fleet.

    Attributes:
        unproven: engines of the name that did not prove the key when the last connection was made.
    """

    uid = None

    def __init__(self, file: FleetFile, engine: str) -> None:
        self.unproven = 0
        self._file = file
        self._engine = engine
        self._trials: Trials[Connection] = Trials(time.monotonic)

    @property
    def text(self) -> str:
        return self._engine or f"the fleet {self._file.zenoh.fleet}"

    @property
    def warning(self) -> str:
        """The warning that engines of the name did not prove the key, or an empty string."""
        if not self.unproven:
            return ""
        text = EngineChoice.ONE_UNPROVEN if self.unproven == 1 else EngineChoice.SEVERAL_UNPROVEN
        return text(count=self.unproven)

    async def open(self, within: float) -> Connection:
        """Find it, and connect."""
        presence = FleetPresence(self._file)
        try:
            try:
                await presence.join()
            except OSError as error:
                raise ControlError(str(error)) from None
            connection = await self._proven(presence, self._meant(presence), within)
        except BaseException:
            presence.close()
            raise
        return _Leaving(connection, presence)

    def _meant(self, presence: FleetPresence) -> list[Member]:
        """Return the engines of the name.

        Raises:
            ControlError: no engine has it.
            UnclearError: no name was given, and there are several engines.
        """
        fleet, engine = self._file.zenoh.fleet, self._engine
        names = sorted(member.name for member in presence.members.values())
        known = f"; there are {join_first(names, _NAMES)}" if names else "; the fleet is empty"
        found = [member for member in presence.members.values() if engine in ("", member.name)]
        if not found:
            problem = EngineChoice.UNKNOWN if engine else EngineChoice.NONE
            raise ControlError(problem(engine=engine, fleet=fleet, known=known))
        if len({member.name for member in found}) > 1 and not engine:
            raise UnclearError(f"several engines are in the fleet {fleet}: name one{known}")
        return found

    async def _proven(self, presence: FleetPresence, members: list[Member], within: float) -> Connection:
        """Connect to the one that proves the key, as anybody may announce an engine of any name.

        Raises:
            UnclearError: several do.
            ControlError: none does.
        """
        by_address = {member.address: member for member in members}

        async def attempt(address: str) -> Connection:
            try:
                return await presence.sealed(by_address[address]).open(within)
            except (ControlError, OSError) as error:
                raise UnprovenError(error) from None

        results = await self._trials.search(by_address, attempt, lambda late: late.abort())
        connections = list(results.proven.values())
        self.unproven = results.others if connections else 0
        if len(connections) == 1:
            return connections[0]
        for connection in connections:
            connection.abort()
        if connections:
            raise UnclearError(
                EngineChoice.SAME_NAME(count=len(connections), fleet=self._file.zenoh.fleet, engine=self._engine)
            )
        failures = [failure.args[0] for failure in results.failures] or [TimeoutError()]
        if len(members) == 1:
            # Alone it has a reason of its own, which says more than that none has proven the key.
            raise failures[0]
        said = next((str(each) for each in failures if isinstance(each, ControlError)), "no answer")
        raise ControlError(EngineChoice.NONE_PROVEN(count=len(members), engine=members[0].name, answer=said))


class _Leaving:
    """A connection that leaves the network when it is over."""

    def __init__(self, connection: Connection, presence: FleetPresence) -> None:
        self._connection = connection
        self._presence = presence

    async def read(self) -> bytes:
        return await self._connection.read()

    def write(self, data: bytes) -> None:
        self._connection.write(data)

    def abort(self) -> None:
        self._connection.abort()
        self._presence.close()


def _nobody(_: Member, __: bool) -> None:
    """Nobody watches."""
