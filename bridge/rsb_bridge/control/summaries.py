"""An engine in a few figures, for consoles that watch it: summed up, with the battery of its robot, and watched."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from typing import TYPE_CHECKING, Final

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import DescriptionError, read_description
from rsb_bridge.cdr.known_types import BATTERY_STATE
from rsb_bridge.control import protocol
from rsb_bridge.control.control_sockets import AttachProblem, ControlError
from rsb_bridge.control.protocol import ControlProtocolError, UnexpectedMessage
from rsb_bridge.model.robot_summary import SUMMARY_BYTES, Battery, LossWindow, encode, of_engine

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator
    from concurrent.futures import Future

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.remote_engine import Connection, Connector
    from rsb_bridge.model.robot_summary import LostMessages
    from rsb_bridge.model.snapshot import PeekedMessage, RouteSnapshot, Snapshot

_BATTERY_TOPIC: Final = "/battery_state"
_BATTERY_TYPES = 16
"""Descriptions that are kept: every robot should have the same one."""
BATTERY_EVERY = 30.0
"""s between two messages of one robot that are looked at. A round figure."""
BATTERIES_AT_ONCE = 4
"""Robots whose next message is waited for: other consoles look at messages, too. A round figure."""
ANSWERS_WITHIN = 5.0  # s, as `remote_engine.ANSWERS_WITHIN`
_HELD_FOR = 0.25
"""s for which an engine that does not answer keeps another one from being tried. A round figure."""
_SILENT_FOR = 3 * protocol.SIGN_OF_LIFE_EVERY


class Batteries:
    """Looks at a message of each robot's battery now and then; never waits.

    Args:
        of_own_robot: whether the engine runs on the robot and sends the messages, or receives them from robots.

    Attributes:
        known: the newest battery of each link, by the link's name.
    """

    def __init__(self, engine: EngineApi, *, of_own_robot: bool = False) -> None:
        self.known: dict[str, Battery] = {}
        self._engine = engine
        self._outgoing = of_own_robot
        self._looking: dict[str, Future[PeekedMessage | None]] = {}
        self._due: dict[str, float] = {}
        self._described: dict[str, Future[str]] = {}

    def update(self, shown: Snapshot) -> None:
        """Take the messages that have come, and look at the batteries that are due."""
        routes = {route.link: route for route in shown.routes if self._is_battery(route)}
        for link, future in list(self._looking.items()):
            if future.done() and (link not in routes or self._read(link, future, routes[link])):
                del self._looking[link]
        self.known = {link: battery for link, battery in self.known.items() if link in routes}
        self._due = {link: self._due.get(link, 0.0) for link in routes}
        waiting = sorted(
            (due, link)
            for link, due in self._due.items()
            # A due time later than that: the clock was set back.
            if not shown.time < due <= shown.time + BATTERY_EVERY and link not in self._looking
        )
        for _, link in waiting[: BATTERIES_AT_ONCE - len(self._looking)]:
            route = routes[link]
            self._due[link] = shown.time + BATTERY_EVERY
            self._looking[link] = self._engine.peek(route.key, kept=link not in self.known)

    def _is_battery(self, route: RouteSnapshot) -> bool:
        of_robot = route.outgoing == self._outgoing and route.type_name == BATTERY_STATE
        return of_robot and route.state.flows and route.spec.topic.endswith(_BATTERY_TOPIC)

    def _read(self, link: str, future: Future[PeekedMessage | None], route: RouteSnapshot) -> bool:
        """Read a message. Return False if the description of its type has to come first."""
        try:
            peeked = future.result()
            if peeked is None:
                return True
            description = self._described.get(peeked.type_hash)
            if description is None:
                if len(self._described) >= _BATTERY_TYPES:
                    self._described.clear()
                description = self._described[peeked.type_hash] = self._engine.describe(route.key)
            if not description.done():
                return False
            charge = charge_of(description.result(), peeked)
        except (EngineError, DescriptionError):  # asked again when it is due
            self._described.clear()
            return True
        if charge is not None:
            self.known[link] = Battery(charge, peeked.time)
        return True


def charge_of(description: str, peeked: PeekedMessage) -> float | None:
    """Return the charge in a message, from 0 to 1, or None if it has no charge.

    Raises:
        DescriptionError: the description is invalid.
    """
    read = decode(read_description(description, peeked.type_hash), peeked.payload, items=0)
    charge = read.message.get("percentage")
    if not isinstance(charge, float) or not math.isfinite(charge) or charge < 0:  # NaN means not measured
        return None
    return min(1.0, charge / 100 if charge > 1 else charge)  # some drivers publish 0 to 100


class SummaryBuilder:
    """Makes the summaries that a `rsb_bridge.control.control_server.ControlServer` sends."""

    def __init__(self, engine: EngineApi, version: str) -> None:
        self._engine = engine
        self._version = version
        self._host = socket.gethostname()
        self._losses = LossWindow()
        self._loss: dict[str, LostMessages] = {}
        self._batteries = Batteries(engine, of_own_robot=True)

    def __call__(self) -> bytes:
        """Return the engine as it is now, as `rsb_bridge.model.robot_summary.encode` has it."""
        snapshot = self._engine.snapshot()
        if snapshot.running:
            self._loss = self._losses.add(snapshot)
            self._batteries.update(snapshot)
        battery = min(self._batteries.known.values(), key=lambda each: each.charge, default=None)
        summary = of_engine(
            snapshot, self._engine.session, host=self._host, version=self._version, losses=self._loss, battery=battery
        )
        return encode(summary)


async def watch(connector: Connector, may_open: asyncio.Semaphore | None = None) -> AsyncGenerator[bytes, None]:
    """Yield an engine's figures as they change, on the running loop. Close the generator at the end (`aclose`).

    Args:
        may_open: held while the connection is made, for 0.25 s at most, or None.

    Yields:
        The content of each `rsb_bridge.control.protocol.Summary`. It is the engine's word, and not checked yet.

    Raises:
        ControlError: the engine cannot be watched, or not any longer; the text has the reason.
    """
    try:
        connection = await _open(connector, may_open)
        try:
            connection.write(protocol.encode(protocol.hello(read_only=True)))
            connection.write(protocol.encode(protocol.Watch()))
            frames = protocol.frames_to_console(protocol.TO_WATCHER_LIMIT)
            while True:
                async with asyncio.timeout(_SILENT_FOR):
                    data = await connection.read()
                if not data:
                    raise ControlError(AttachProblem.ON_SOCKET(where=connector.text, problem=AttachProblem.ENDED()))
                for message in frames.feed(data):
                    if isinstance(message, protocol.Summary) and len(message.content) <= SUMMARY_BYTES:
                        yield message.content
                    elif isinstance(message, (protocol.Goodbye, protocol.HelloRefused)):
                        raise ControlError(AttachProblem.ON_SOCKET(where=connector.text, problem=message.reason))
                    elif not isinstance(message, protocol.ConsoleWelcome):
                        raise ControlError(
                            AttachProblem.ON_SOCKET(where=connector.text, problem=UnexpectedMessage.UNASKED())
                        )
        finally:
            connection.abort()
    except TimeoutError:
        raise ControlError(AttachProblem.ON_SOCKET(where=connector.text, problem=AttachProblem.SILENT())) from None
    except ControlProtocolError as error:
        raise ControlError(AttachProblem.ON_SOCKET(where=connector.text, problem=error)) from None
    except OSError as error:
        raise ControlError(AttachProblem.ON_SOCKET(where=connector.text, problem=error.strerror or error)) from None


async def _open(connector: Connector, may_open: asyncio.Semaphore | None) -> Connection:
    """Connect; engines that do not answer, which strangers may announce, soon give place to others."""
    async with may_open or contextlib.nullcontext():
        opening = asyncio.create_task(connector.open(ANSWERS_WITHIN))
        try:
            # `wait` leaves its task running when it is cancelled.
            await asyncio.wait([opening], timeout=_HELD_FOR)
        except asyncio.CancelledError:
            opening.cancel()
            raise
    return await opening
