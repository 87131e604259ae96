"""Serves an engine to consoles, on a thread of its own: the bridge never waits for a console.

Consoles of this machine come through a control socket, operators over a network through `rsb_bridge.control.sealed`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.control import protocol
from rsb_bridge.control.attached_console import AttachedConsole
from rsb_bridge.control.control_sockets import (
    AttachProblem,
    close_lingering,
    identify,
    may_control,
    peer_of,
    run_as,
    user_name,
)
from rsb_bridge.control.protocol import ControlProtocolError
from rsb_bridge.control.states import EncodedRoutes
from rsb_bridge.model.clock import Clock

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.control_sockets import ControlSocket
    from rsb_bridge.control.protocol import BridgeInfo
    from rsb_bridge.model.commands import ActingOperator

_TURNS = 10
"""Turns of the loop after which the last accepted connection is a console, and aborted connections are closed.
A round figure."""
_SAID_WITHIN = 0.25
"""Seconds a console has to read the goodbye. A deaf console delays the shutdown by twice this."""
_CLOSED_WITHIN = 2.0
"""s that `ControlServer.close` waits for its thread, so that no socket remains. The thread needs only `_SAID_WITHIN`,
unless the machine starves it."""
_READ_SIZE = 64 << 10


class ControlServer:
    """Serves one engine from `start` to `close`. Used once.

    Args:
        engine: to be served, started or not.
        listener: the socket; closed with this.
        on_stop: called, on this server's thread, when a console asks for the end of the process.

    Attributes:
        summarize: makes the engine's figures for consoles that watch (`rsb_bridge.control.protocol.Summary`), on this
            server's thread, or None to send none.
        encoded: the parts of the engine's state that are encoded already, for all consoles.
        loop: of the server's thread, from `start` on.
    """

    def __init__(
        self, engine: EngineApi, listener: ControlSocket, info: BridgeInfo, on_stop: Callable[[], None]
    ) -> None:
        self.engine = engine
        self._clock = Clock()
        self._info, self._began = info, self._clock.steady()
        self.encoded = EncodedRoutes()
        self.summarize: Callable[[], bytes] | None = None
        self.loop: asyncio.AbstractEventLoop
        self._listener = listener
        self.stop_process = on_stop
        self._consoles: set[AttachedConsole] = set()
        self._summary, self._summed_at = b"", float("-inf")
        self._one_less = asyncio.Event()
        self._at_end: list[Callable[[], None]] = []
        self._ending = ""
        self._ready = threading.Event()
        self._ends = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="rsb-control", daemon=True)

    def start(self) -> None:
        self._thread.start()
        self._ready.wait()

    def close(self, reason: str = "the bridge has ended") -> None:
        """Tell the consoles why, and stop serving; takes half a second where they do not listen."""
        if not self._thread.is_alive():
            self._listener.close()
            return
        self._ending = reason
        with contextlib.suppress(RuntimeError):  # it has ended by itself
            self.loop.call_soon_threadsafe(self._ends.set)
        self._thread.join(_CLOSED_WITHIN)

    # --- on the thread

    @property
    def info(self) -> BridgeInfo:
        """The description, with the start by the wall clock as it is set now: many a robot boots without the date."""
        started = self._clock.time_ns() / 1e9 - (self._clock.steady() - self._began)
        return msgspec.structs.replace(self._info, started=round(started, 1))

    def summary(self) -> bytes:
        """Return the engine in a few figures, made once for all consoles, or empty bytes."""
        now = self.loop.time()
        if self.summarize is not None and now - self._summed_at >= protocol.SUMMARY_EVERY:
            self._summary, self._summed_at = self.summarize(), now
        return self._summary

    @property
    def ending(self) -> str:
        """The reason consoles are not served any more, or an empty string."""
        return self._ending if self._ends.is_set() else ""

    def at_end(self, work: Callable[[], None]) -> None:
        """Have `work` called once all consoles have received the end. From any thread, before the end."""
        self._at_end.append(work)

    def attached(self) -> int:
        """Return the number of consoles, over all kinds of connection."""
        return len(self._consoles)

    def add(self, console: AttachedConsole) -> None:
        """Count a console, and tell it of the end."""
        self._consoles.add(console)

    def remove(self, console: AttachedConsole) -> None:
        """Forget a console whose connection has ended."""
        self._consoles.discard(console)
        self._one_less.set()
        console.gone()

    def full(self, places: int = protocol.CONSOLES) -> str:
        """Return the reason to refuse one more console if all places are taken, or an empty string."""
        if self.attached() < places:
            return ""
        return AttachProblem.OTHER_CONSOLES(count=self.attached())

    def _run(self) -> None:
        try:
            asyncio.run(self._main())
        finally:
            # `start` waits for this without a limit, also if `_main` has failed.
            self._ready.set()
            self._listener.close()

    async def _main(self) -> None:
        self.loop = asyncio.get_running_loop()
        # Not start_unix_server, which looks at the path that the socket was bound to from Python 3.13 on: the path led
        # through a descriptor that is closed (`control_sockets.ControlSocket`).
        server = await asyncio.start_server(self._connected, sock=self._listener.socket)
        self._ready.set()
        await self._ends.wait()
        self.loop.remove_reader(self._listener.socket)  # a server that is closed while it accepts leaves a socket open
        for _ in range(_TURNS):
            await asyncio.sleep(0)
        server.close()
        for console in tuple(self._consoles):
            console.end(self._ending)
        await self._consoles_gone()
        for console in tuple(self._consoles):
            console.abort()
        for work in self._at_end:
            work()
        await self._consoles_gone()
        for _ in range(_TURNS):
            await asyncio.sleep(0)

    async def _consoles_gone(self) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_SAID_WITHIN):
                while self._consoles:
                    self._one_less.clear()
                    await self._one_less.wait()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # A console beyond `CONSOLES` gets the reason. That takes a connection, too, so there is a second limit.
        if self.attached() >= 2 * protocol.CONSOLES:
            writer.transport.abort()
            return
        _, uid, _ = peer_of(writer.get_extra_info("socket"))
        refusal = self.full()
        if not may_control(uid):
            own = os.geteuid()
            refusal = f"this bridge runs as {user_name(own)}; only that user and root may control it: {run_as(own)}"
        console = AttachedConsole(self, _OfThisMachine(writer), refusal)
        self.add(console)
        try:
            while data := await reader.read(_READ_SIZE):
                console.received(data)
        except (OSError, ControlProtocolError):
            pass  # it is gone, or it is no console
        finally:
            self.remove(console)
            console.abort()


class _OfThisMachine:
    """A console's connection through the control socket, of whose other end the kernel knows who it is."""

    read_only_reason = never_takes_reason = ""
    of_this_machine = True

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer

    @property
    def operator(self) -> ActingOperator:
        pid, uid, _ = peer_of(self._writer.get_extra_info("socket"))
        return identify(pid, uid)

    @property
    def buffered(self) -> int:
        return self._writer.transport.get_write_buffer_size()

    @property
    def closing(self) -> bool:
        return self._writer.is_closing()

    def write(self, data: bytes) -> None:
        self._writer.write(data)

    def close(self) -> None:
        self._writer.close()

    def close_lingering(self) -> None:
        close_lingering(self._writer.transport, _SAID_WITHIN)

    def abort(self) -> None:
        self._writer.transport.abort()
