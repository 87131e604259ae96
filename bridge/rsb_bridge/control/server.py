"""Serves an engine on a control socket, on a thread of its own: the bridge never waits for a console."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.control import protocol
from rsb_bridge.control.commands import CHANGING, ArmTopic
from rsb_bridge.control.folders import is_trusted, peer_of
from rsb_bridge.control.identity import identify
from rsb_bridge.control.performing import perform
from rsb_bridge.control.protocol import ProtocolError
from rsb_bridge.control.states import EncodedRoutes, Sender
from rsb_bridge.model.benchmark import Outcome
from rsb_bridge.model.consoles import on_console
from rsb_bridge.model.history import HistoryReport
from rsb_bridge.model.operators import acting
from rsb_bridge.model.reloaded import Reloaded
from rsb_bridge.tasks import Tasks

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.folders import Listener
    from rsb_bridge.control.performing import Answer
    from rsb_bridge.control.protocol import BridgeInfo, ToBridge, ToConsole

_TICK = 0.25
_HELLO_WITHIN = 5.0
_STALLED_FOR = 60.0
"""s for which a console may take nothing, until its connection is given up."""
_WAITING_BYTES = 4 << 20
"""Bytes that may wait for one console beyond a state: answers to commands only."""
_PAUSE = 0.0005
"""s of rest between two parts of a state, in which the bridge's threads run."""
_ANSWERED_WITHIN = 2.0
"""s after which a look is answered though nothing is new: the engine has stopped, the bridge's process has not."""
_TURNS_TO_ACCEPT = 10
"""Turns of the loop: what was accepted last has become a console then, which can be told of the end."""
_SAID_WITHIN = 0.25
_CLOSED_WITHIN = 2.0
"""s that `ControlServer.close` waits for its thread, which ends by itself as soon as it has said so: for a machine that
starves it, where the socket would be left behind."""
_READ_SIZE = 64 << 10


class ControlServer:
    """Serves one engine from `start` to `close`. Used once.

    Args:
        engine: which; it need not have been started.
        listener: where; closed with this.
        info: who serves.
        on_stop: called, on this server's thread, when a console asks for the end of the process.
    """

    def __init__(self, engine: EngineApi, listener: Listener, info: BridgeInfo, on_stop: Callable[[], None]) -> None:
        self.engine = engine
        self.info = info
        self.encoded = EncodedRoutes()
        self._listener = listener
        self._on_stop = on_stop
        self._consoles: dict[_Console, asyncio.Task[None]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending = ""
        self._ends = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="rsb-control", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        ready = threading.Event()
        self._ready = ready
        self._thread.start()
        ready.wait()

    def close(self, reason: str = "the bridge has ended") -> None:
        """Tell the consoles why, and stop serving; takes half a second where they do not listen.

        Args:
            reason: in words.
        """
        if not self._thread.is_alive():
            self._listener.close()
            return
        self._ending = reason
        assert self._loop is not None
        with contextlib.suppress(RuntimeError):  # it has ended by itself
            self._loop.call_soon_threadsafe(self._ends.set)
        self._thread.join(_CLOSED_WITHIN)

    def stop_process(self) -> None:
        """Do what `rsb_bridge.control.commands.Stop` asks for."""
        self._on_stop()

    # --- on the thread

    def _run(self) -> None:
        try:
            asyncio.run(self._main())
        finally:
            self._ready.set()
            self._listener.close()

    async def _main(self) -> None:
        self._loop = asyncio.get_running_loop()
        server = await asyncio.start_unix_server(self._connected, sock=self._listener.socket)
        self._ready.set()
        await self._ends.wait()
        self._loop.remove_reader(self._listener.socket)  # a server that is closed while it accepts leaves a socket open
        for _ in range(_TURNS_TO_ACCEPT):
            await asyncio.sleep(0)
        server.close()
        for console in tuple(self._consoles):
            console.end(self._ending)
        await self._consoles_gone()
        for console in tuple(self._consoles):
            console.abort()
        await self._consoles_gone()

    def _refusal(self, writer: asyncio.StreamWriter) -> str:
        """Why a connection is refused; empty: it is not."""
        if not is_trusted(writer.get_extra_info("socket")):
            return "this bridge is another user's"
        if len(self._consoles) >= protocol.CONSOLES:
            return f"{protocol.CONSOLES} consoles are attached already; close one of them"
        return ""

    async def _consoles_gone(self) -> None:
        if self._consoles:
            await asyncio.wait(self._consoles.values(), timeout=_SAID_WITHIN)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._consoles) >= 2 * protocol.CONSOLES:
            writer.transport.abort()
            return
        console = _Console(self, reader, writer, self._refusal(writer))
        task = self._consoles[console] = asyncio.create_task(console.run())
        try:
            await task
        except (OSError, ProtocolError):
            pass  # it is gone, or it is no console
        finally:
            del self._consoles[console]
            console.abort()


class _Console:
    """One connection.

    Args:
        server: whose.
        reader: of the connection.
        writer: of the connection.
        refusal: why it is refused as soon as it says hello; empty: it is not.
    """

    def __init__(
        self, server: ControlServer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, refusal: str
    ) -> None:
        self._server = server
        self._refusal = refusal
        self._engine = server.engine
        self._reader, self._writer = reader, writer
        self._frames = protocol.frames_to_bridge()
        self._loop = asyncio.get_running_loop()
        self._sender = Sender()
        self._sending = asyncio.Lock()
        self._looking = False
        self._looked_at = 0.0
        self._after: int | None = None
        self._read_only = False
        self._operator = ""
        self._welcomed = False
        self._tasks = Tasks(self._loop, self.abort)
        self._requests = 0
        self._has_armed = False
        self._born = self._taken_at = self._loop.time()
        self._waiting = 0

    async def run(self) -> None:
        """Serve it until it goes.

        Raises:
            OSError: the connection broke.
            ProtocolError: it does not keep to the protocol.
        """
        self._tasks.spawn(self._tick())
        try:
            while data := await self._reader.read(_READ_SIZE):
                for message in self._frames.feed(data):
                    self._handle(message)
        finally:
            self._tasks.cancel()
            if self._has_armed:
                with acting(self._operator), on_console(self):
                    self._engine.arming.release()

    def send(self, message: ToConsole) -> None:
        """Hand a message to the kernel, or keep it until that takes it."""
        if self._writer.is_closing():
            return
        self._writer.write(protocol.encode(message))
        if self._buffered > _WAITING_BYTES + protocol.TO_CONSOLE_LIMIT:
            self.abort()

    def abort(self) -> None:
        """Close the connection, and forget what waits for it."""
        self._writer.transport.abort()

    def end(self, reason: str) -> None:
        """Say the last events, and why this is the end; then close."""
        self._send_events()
        self.send(protocol.Goodbye(reason))
        self._writer.close()

    @property
    def _buffered(self) -> int:
        return self._writer.transport.get_write_buffer_size()

    # --- what it says

    def _handle(self, message: ToBridge) -> None:
        if isinstance(message, protocol.Hello):
            self._greet(message)
        elif not self._welcomed:
            raise ProtocolError("no hello")
        elif isinstance(message, protocol.Look):
            self._looking = True
            self._looked_at = self._loop.time()
            self._tasks.spawn(self._show())
        elif isinstance(message, protocol.Follow):
            self._after = message.after
            self._send_events()
        else:
            self._request(message)

    def _greet(self, hello: protocol.Hello) -> None:
        info = self._server.info
        versions = protocol.version_problem((protocol.VERSION, info.program), (hello.version, hello.program))
        if problem := self._refusal or versions:
            self.send(protocol.Refused(problem))
            self._writer.close()
            return
        self._welcomed = True
        pid, uid, _ = peer_of(self._writer.get_extra_info("socket"))
        self._operator = identify(pid, uid)
        self._read_only = hello.read_only
        self.send(protocol.Welcome(info, hello.read_only))

    def _request(self, request: protocol.Request) -> None:
        if self._read_only and isinstance(request.command, CHANGING):
            self.send(protocol.Failed(request.id, "attached read-only: nothing can be changed"))
        elif self._requests >= protocol.REQUESTS_WAITING:
            self.send(protocol.Failed(request.id, f"{protocol.REQUESTS_WAITING} requests wait for an answer already"))
        else:
            self._requests += 1
            self._has_armed |= isinstance(request.command, ArmTopic)
            self._tasks.spawn(self._answer(request))

    async def _answer(self, request: protocol.Request) -> None:
        try:
            with acting(self._operator), on_console(self):
                answer = await perform(
                    request.command,
                    self._engine,
                    step=lambda text: self._step(request.id, text),
                    stop_process=self._server.stop_process,
                )
            reply: ToConsole = _reply(request.id, answer)
        except EngineError as error:
            reply = protocol.Failed(request.id, str(error))
        finally:
            self._requests -= 1
        if isinstance(request.command, CHANGING) and self._sender.sent is not None and self._buffered == 0:
            await self._send_state()  # whoever waits for the command wants to see its effect
        self.send(reply)

    def _step(self, request: int, text: str) -> None:
        """Tell a step of a restart; called on the engine's thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self.send, protocol.Step(request, text))

    # --- what it is told

    async def _tick(self) -> None:
        """Send what is new, four times a second, for ever."""
        while True:
            await asyncio.sleep(_TICK)
            await self._send_news()

    async def _send_news(self) -> None:
        """Unless something still waits to be taken; give up on a console that takes nothing."""
        now = self._loop.time()
        if not self._welcomed:
            if now - self._born > _HELLO_WITHIN:
                self.abort()
            return
        waiting = self._buffered
        if waiting == 0 or waiting != self._waiting:
            self._taken_at = now
        self._waiting = waiting
        if now - self._taken_at > _STALLED_FOR:
            self.abort()
        elif waiting == 0:
            self._send_events()
            await self._show()

    def _send_events(self) -> None:
        """Send as many events as are taken at once."""
        while self._after is not None and self._buffered == 0:
            events = self._engine.events(self._after)[: protocol.EVENTS_AT_ONCE]
            if not events:
                return
            self._after = events[-1].number
            self.send(protocol.Events(tuple(events)))

    async def _show(self) -> None:
        """Send the state if it is a new one; or if it has been looked for long enough to wonder what is wrong."""
        is_new = self._engine.snapshot() is not self._sender.sent
        if self._looking and self._buffered == 0 and (is_new or self._loop.time() - self._looked_at > _ANSWERED_WITHIN):
            self._looking = False
            await self._send_state()

    async def _send_state(self) -> None:
        async with self._sending:
            engine, encoded = self._engine, self._server.encoded
            snapshot = engine.snapshot()
            for state in self._sender.differences(
                snapshot, engine.session, waits_for_operator=engine.waits_for_operator, encoded=encoded
            ):
                self.send(state)
                if state.more:
                    await asyncio.sleep(_PAUSE)
            encoded.keep_only(snapshot)


def _reply(request: int, answer: Answer) -> protocol.Reply:
    if isinstance(answer, Reloaded):
        return protocol.Reply(request, reloaded=answer)
    if isinstance(answer, HistoryReport):
        return protocol.Reply(request, history=answer)
    if isinstance(answer, Outcome):
        return protocol.Reply(request, bench=answer)
    return protocol.Reply(request, answer)
