"""The engine: one session's bridge, on threads of its own. Nothing in here waits for a user interface."""

from __future__ import annotations

import asyncio
import dataclasses
import logging
import os
import threading
from concurrent.futures import Future
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, TypeVar

import msgspec

from rsb_bridge.api import EngineApi, EngineError
from rsb_bridge.config.keys import KeyFileError, key_path, read_key
from rsb_bridge.context import Context
from rsb_bridge.link.negotiation import LinkError
from rsb_bridge.link.roles import BridgeRole, ClientRole, Keys, ServerRole, clients_of
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level, Snapshot, TopicInfo
from rsb_bridge.ros.api import RosError, RosInterface, Subscription
from rsb_bridge.ros.graph import topics_of
from rsb_bridge.ros.queue import RosToLoopQueue
from rsb_bridge.ros.shutdown_topic import watch_shutdown_topic
from rsb_bridge.telemetry.event_log import EventLog
from rsb_bridge.telemetry.snapshots import SnapshotPublisher, in_slices
from rsb_bridge.transport.registry import Transports, default_transports
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.route.route import Route

_ERROR_SAID_EVERY = 10.0
_POLL = 0.25
_POLLS_PER_TICK = 4

_logger = logging.getLogger(__name__)
T = TypeVar("T")


class Engine(EngineApi):
    """Bridges what a session says, from `start` to `stop`. Used once.

    All state belongs to the I/O thread; commands go there and return a future, whose exception is an `EngineError`.

    Args:
        session: what to bridge.
        base: the folder that its key files are relative to.
        ros: the ROS side; None: `rsb_bridge.ros.node.RosNode` in the session's domain.
        clock: the wall clock; None: the machine's.
        random: for jitter; None: seeded by the system.
        transports: what the links run over; None: the kernel's sockets.
    """

    def __init__(
        self,
        session: Session,
        *,
        base: Path = Path(),
        ros: RosInterface | None = None,
        clock: Clock | None = None,
        random: Random | None = None,
        transports: Transports | None = None,
    ) -> None:
        self._session = session
        self._base = base
        self._ros = ros
        self._clock = clock or Clock()
        self._random = random or Random()  # noqa: S311 — jitter, no secret
        self._transports = transports or default_transports()
        self._events = EventLog(self._clock)
        self._stopping = asyncio.Event()
        self._errors_said: dict[str, float] = {}
        self._thread: threading.Thread | None = None
        self._context: Context | None = None
        self._end: BridgeRole | None = None
        transport = self._transports.of_link(session.server_ip)
        address = transport.format_address((session.server_ip, session.server_port))
        started = self._clock.time_ns() / 1e9
        blank = Snapshot(started, session.name, session.role, address, session.domain_id or 0, running=False)
        self._observer = SnapshotPublisher(blank, self._events, self._clock)

    # --- from any thread

    @property
    def session(self) -> Session:
        if self._session.role == "server" or self._end is None:
            return self._session
        (link,) = self._end.links()
        topics = tuple(route.spec for route in tuple(link.routes.values()) if route.proposed_here)
        return msgspec.structs.replace(self._session, topics=topics)

    @property
    def waits_for_operator(self) -> bool:
        return any(link.shut_down for link in self._end.links()) if self._end is not None else False

    def start(self) -> None:
        domain = _domain_of(self._session)
        self._observer.latest = dataclasses.replace(self._observer.latest, domain_id=domain)
        keys = self._load_keys()
        ros = self._ros or _ros_node(domain, self._session.name)
        try:
            ros.start()
        except RosError as error:
            raise EngineError(str(error)) from None
        started: Future[None] = Future()
        self._thread = threading.Thread(
            target=self._run_thread, args=(ros, domain, keys, started), name="rsb-io", daemon=True
        )
        self._thread.start()
        try:
            started.result()
        except EngineError:
            self._thread.join()
            self._thread = None
            ros.stop()
            raise

    def stop(self, timeout: float = 5.0) -> None:
        thread, context = self._thread, self._context
        if thread is None or context is None:
            return
        context.call(self._stopping.set)
        thread.join(timeout - 1.0)
        context.ros.stop()
        self._thread = None

    def snapshot(self) -> Snapshot:
        """The engine as it was at most a quarter of a second ago (right after a pause in asking: a second)."""
        return self._observer.look()

    def events(self, after: int = 0) -> list[Event]:
        return self._events.after(after)

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        return self._events.wait(after, timeout)

    # --- commands

    def add_topic(self, topic: Topic, link: str = "") -> Future[str]:
        async def work(end: BridgeRole) -> str:
            return end.add(topic, link).key

        return self._command(work)

    def edit_topic(self, key: str, topic: Topic) -> Future[str]:
        async def work(end: BridgeRole) -> str:
            link, route = _find(end, key)
            link.remove(route, "edited")
            try:
                return end.add(topic, link.name).key
            except (LinkError, ValueError):
                end.add(route.spec, link.name)
                raise

        return self._command(work)

    def remove_topic(self, key: str) -> Future[None]:
        async def work(end: BridgeRole) -> None:
            link, route = _find(end, key)
            link.remove(route, "removed by an operator")

        return self._command(work)

    def pause(self, key: str, paused: bool) -> Future[None]:
        async def work(end: BridgeRole) -> None:
            link, route = _find(end, key)
            link.pause(route, paused)

        return self._command(work)

    def retry(self, link: str = "") -> Future[None]:
        async def work(end: BridgeRole) -> None:
            end.retry(link)

        return self._command(work)

    def shut_down(self) -> Future[None]:
        async def work(end: BridgeRole) -> None:
            end.shut_down("an operator shut it down")

        return self._command(work)

    def restart(self, step: Callable[[str], None] | None = None) -> Future[None]:
        async def work(end: BridgeRole) -> None:
            def say(words: str) -> None:
                self._events.add(Level.INFO, EventCode.ENGINE_RESTARTING, f"restart: {words}")
                if step is not None:
                    step(words)

            await end.restart(say)

        return self._command(work)

    def topics(self, link: str | None = None) -> Future[list[TopicInfo]]:
        async def work(end: BridgeRole) -> list[TopicInfo]:
            if link is None:
                assert self._context is not None
                return await asyncio.to_thread(topics_of, self._context.ros)
            for candidate in end.links():
                if candidate.name == link:
                    return await candidate.negotiation.remote_topics()
            raise LinkError(f"there is no link {link!r}")

        return self._command(work)

    def _command(self, work: Callable[[BridgeRole], Coroutine[None, None, T]]) -> Future[T]:
        """Run on the I/O thread; what is wrong with the request comes as an `EngineError` through the future."""
        end, context = self._end, self._context

        async def guarded() -> T:
            assert end is not None
            try:
                return await work(end)
            except (LinkError, ListenError, RosError, ValueError) as error:
                raise EngineError(str(error)) from None
            finally:
                self._observer.refresh_now(end)

        if end is not None and context is not None and self._thread is not None:
            coroutine = guarded()
            try:
                return asyncio.run_coroutine_threadsafe(coroutine, context.loop)
            except RuntimeError:
                coroutine.close()
        failed: Future[T] = Future()
        failed.set_exception(EngineError("the engine is not running"))
        return failed

    # --- on the I/O thread

    def _run_thread(self, ros: RosInterface, domain: int, keys: Keys, started: Future[None]) -> None:
        try:
            asyncio.run(self._main(ros, domain, keys, started))
        except Exception as error:
            _logger.exception("the engine failed inside")
            words = f"the engine failed inside, please report it: {error}"
            self._events.add(Level.ERROR, EventCode.ENGINE_ERROR, words)
            if not started.done():
                started.set_exception(EngineError(words))

    async def _main(self, ros: RosInterface, domain: int, keys: Keys, started: Future[None]) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(self._internal_error)
        context = self._context = Context(
            self._session,
            domain,
            ros,
            self._events,
            RosToLoopQueue(loop),
            loop,
            self._clock,
            self._random,
            self._transports,
        )
        end = self._end = (ServerRole if self._session.role == "server" else ClientRole)(context, keys)
        watch: Subscription | None = None
        try:
            watch = self._watch_shutdown(context, end)
            await end.start()
        except (ListenError, RosError, LinkError, ValueError) as error:
            started.set_exception(EngineError(str(error)))
        else:
            self._observer.refresh_now(end)
            started.set_result(None)
            await self._run(context, end)
        finally:
            if watch is not None:
                watch.close()
            await end.stop()
            self._events.add(Level.INFO, EventCode.ENGINE_STOPPED, "stopped")
            self._observer.refresh_now(end, running=False)

    async def _run(self, context: Context, end: BridgeRole) -> None:
        polls = 0
        while not self._stopping.is_set():
            polls += 1
            for link in end.links():
                self._guarded(link, link.poll)
            tick = polls % _POLLS_PER_TICK == 0
            if tick:
                context.limited.tick()
                end.tick()
                for link in end.links():
                    await self._tick(link)
            if tick or self._observer.looked_at(context.now()):
                await self._observer.refresh(end)
            try:
                async with asyncio.timeout_at(context.loop.time() + _POLL):
                    await self._stopping.wait()
            except TimeoutError:
                pass

    def _watch_shutdown(self, context: Context, end: BridgeRole) -> Subscription | None:
        topic = self._session.shutdown_topic
        if topic is None:
            return None
        words = f'"shutdown" on {topic} in domain {context.domain_id}'

        def act() -> None:
            self._events.add(Level.WARNING, EventCode.ENGINE_SHUTDOWN, f"{words}: closing the sockets on both sides")
            end.shut_down(words)

        return watch_shutdown_topic(context.ros, topic, lambda: context.call(act))

    async def _tick(self, link: Link) -> None:
        def each(route: Route) -> None:
            self._guarded(link, route.tick)

        await in_slices(tuple(link.routes.values()), each)
        self._guarded(link, link.tick)

    def _guarded(self, link: Link, work: Callable[[], None]) -> None:
        """Do a link's regular work; what fails in it ends that link's connection, not the others'."""
        try:
            work()
        except Exception as error:  # noqa: BLE001 — whatever it is, it is one link's
            self._internal_error(link.context.loop, {"exception": error})
            link.fail()

    def _internal_error(self, loop: asyncio.AbstractEventLoop, details: dict[str, object]) -> None:
        error = details.get("exception")
        words = f"internal error, please report it: {error or details.get('message')}"
        now = loop.time()
        if now - self._errors_said.get(words, -_ERROR_SAID_EVERY) < _ERROR_SAID_EVERY:
            return
        self._errors_said = {words: now}
        exc_info = (type(error), error, error.__traceback__) if isinstance(error, BaseException) else None
        _logger.error("%s", words, exc_info=exc_info)
        self._events.add(Level.ERROR, EventCode.ENGINE_ERROR, words)

    # --- before starting

    def _load_keys(self) -> Keys:
        session = self._session
        clients = clients_of(session) if session.role == "server" else ()
        files = {client.name: client.key_file or session.key_file for client in clients} or {
            session.name: session.key_file
        }
        if not session.use_encryption:
            self._events.add(
                Level.WARNING, EventCode.KEY_UNENCRYPTED, "encryption is off: everything crosses in the clear"
            )
            return dict.fromkeys(files)
        keys = {}
        for name, file in files.items():
            if file is None:
                raise EngineError(
                    f"no key_file for {name}: make one with `rsb-console keygen`, and copy it to the other side"
                )
            try:
                keys[name] = read_key(key_path(self._base, file))
            except KeyFileError as error:
                raise EngineError(str(error)) from None
            for warning in keys[name].warnings:
                self._events.add(Level.WARNING, EventCode.KEY_WARNING, warning)
        return keys


def _find(end: BridgeRole, key: str) -> tuple[Link, Route]:
    for link in end.links():
        if key in link.routes:
            return link, link.routes[key]
    raise LinkError(f"there is no route {key!r} any more")


def _domain_of(session: Session) -> int:
    if session.domain_id is not None:
        return session.domain_id
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdecimal() or int(text) > 232:
        raise EngineError(f"ROS_DOMAIN_ID is {text!r}: it is a number from 0 to 232")
    return int(text)


def _ros_node(domain: int, name: str) -> RosInterface:
    from rsb_bridge.ros.node import RosNode  # noqa: PLC0415 — only a running engine needs ROS

    return RosNode(domain, name)
