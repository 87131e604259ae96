"""One session's bridge on an event loop: everything of the engine but its threads.

`rsb_bridge.engine.Engine` gives it a thread of its own; the simulation in the tests gives it a clock and a network of
its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec

from rsb_bridge.api import EngineError, InvalidRequestError, Unable
from rsb_bridge.cdr.known_types import STRING, STRING_HASH, string_bytes
from rsb_bridge.config.keys import shared_key_problem
from rsb_bridge.config.session_changes import changes
from rsb_bridge.config.validation import validate
from rsb_bridge.engine.inspector import RouteInspector
from rsb_bridge.engine.part import EnginePart, MovingPart
from rsb_bridge.engine.topic_commands import ArmingCommands, CommandLog, TopicCommands, named_in, route_in, undo_mark
from rsb_bridge.installed_features import added, feature_faults
from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.graph_watch import Follower, GraphWatch, NameWatch
from rsb_bridge.link.link import link_named, topics_of_peer
from rsb_bridge.link.reloading import ReloadStep
from rsb_bridge.link.roles import BridgeRole, ClientRole, Keys, ServerRole
from rsb_bridge.model import commands
from rsb_bridge.model.budgets import Backoff
from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import operator
from rsb_bridge.model.demands import DemandText, all_armed, as_armed, merged, sources_of_topics
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.snapshot import Level, LinkSnapshot, RouteSnapshot, TopicInfo
from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.ros_graph import CALLED, graph_of
from rsb_bridge.ros.ros_interface import RosError, RosProblem, TopicSpec
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.peeking import PeekError, Peeking
from rsb_bridge.tasks import Tasks, in_slices, in_thread
from rsb_bridge.telemetry.acknowledgements import find_faulty
from rsb_bridge.transport.transport import ListenError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.engine.part import Handlers
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.commands import Command, R
    from rsb_bridge.model.session import Session
    from rsb_bridge.ros.ros_interface import LostPort, OnFailure, RawMessage, Subscription
    from rsb_bridge.route.route import Route
    from rsb_bridge.telemetry.snapshot_publisher import SnapshotPublisher

_WORD = b"shutdown"
_ERROR_LOGGED_EVERY = 10.0
"""s until the same internal error is logged again. A round figure: an error on the path of messages would otherwise
write a traceback for each of them."""
_TICK, _LONGEST_PAUSE = 1.0, 10.0
"""s between two ticks, in which links and routes count; s at most until regular work that has failed starts again."""
_LISTENS_EVERY = 10
"""Ticks between two looks whether DDS hears all nodes here. It has this time to follow senders to a new port. Ticks, as
a process that was stopped has had no time. A round figure; a whole look, the first one or if a port has changed, takes
5 to 17 ms."""

_DISCOVERY_ASKED_EVERY, _DISCOVERY_ASKED_WITHIN = 10.0, 60.0
"""s between two questions to the discovery servers, and for their names to be looked up. Round figures."""

_OF_ONE_ROUTE = (
    commands.AnswerAsker,
    commands.ArmTopic,
    commands.AskHolder,
    commands.Call,
    commands.CallWhole,
    commands.DisarmTopic,
    commands.PauseTopics,
    commands.TakeArming,
)
"""Commands whose effect shows on no other route than that of their key."""
_EVERY_TOPIC = ""

_logger = logging.getLogger(__name__)


class Bridge:
    """Carries out a session: `start`, then `run`, which returns some time after `stop`. Used once.

    All of it belongs to the thread of the running loop.

    Args:
        snapshots: kept up to date for consoles.

    Attributes:
        folder: gives the folder of the session file.
        newest_snapshot: returns it; may be called on any thread.
        role: a server's or a client's part.
        graph_watch: reacts to changes of the ROS graph.
        handlers: execute commands, by the command's type. The engine adds handlers for commands that read files.
        log: of operators' commands.
        peeking: gives messages that pass.
    """

    def __init__(
        self, context: Context, keys: Keys, snapshots: SnapshotPublisher, folder: Callable[[], Path] = Path
    ) -> None:
        self.context = context
        self.folder = folder
        self.newest_snapshot = snapshots.newest
        self._snapshots = snapshots
        is_server = context.session.role == "server"
        self.role: BridgeRole = ServerRole(context, keys) if is_server else ClientRole(context, keys)
        self._names = NameWatch(context, self._followers)
        context.names_changed = self._names.changed
        context.is_unsaved = lambda: self.role.unsaved
        context.is_looked_at = lambda: self._snapshots.is_looked_at
        self.graph_watch = GraphWatch(context, self.role.links, self._names.changed)
        self.log = CommandLog(context.events)
        self._tasks = Tasks(context.loop, lambda: None)
        self.peeking = Peeking(context)
        self._arming = ArmingCommands(self)
        self.handlers: Handlers = {
            commands.Acknowledge: self._acknowledge,
            commands.Retry: self._retry,
            commands.ShutDownLinks: self._shut_down,
            commands.Topics: self._topics,
        }
        self._changing = asyncio.Lock()
        """Held by the command that changes the session, so that the next one sees all of its effect."""
        self._stopping = asyncio.Event()
        self._ending: Counter[str] = Counter()
        """How many commands end the motions on each topic; `_EVERY_TOPIC` for all."""
        self._shutdown_watch: LastingSubscription | None = None
        self._parts: list[EnginePart] = [TopicCommands(self), self._arming, RouteInspector(self)]
        self._parts += added("parts", self)
        self._ticking = [part for part in self._parts if type(part).tick is not EnginePart.tick]
        self._moving = [part for part in self._parts if isinstance(part, MovingPart)]
        for part in self._parts:
            self.handlers = part.handlers | self.handlers
        self._errors_logged: dict[str, float] = {}
        self._faults_told = 0

    def links(self) -> list[Link]:
        return self.role.links()

    def find(self, key: str) -> tuple[Link, Route]:
        """Return a route and its link by the route's key.

        Raises:
            LinkError: no route has this key.
        """
        link, _, route = named_in(self.role.links(), key)
        if route is None:
            raise LinkError("a pattern carries nothing itself: choose one of the topics that it matches")
        return link, route

    async def end_motions(self, topics: set[str] | None = None) -> bool:
        ending = Counter((_EVERY_TOPIC,) if topics is None else topics)
        self._ending += ending
        waited = False
        try:
            for part in self._moving:
                with self._part_may_fail(part):
                    waited |= await part.end_motions(topics)
        finally:
            # Until the caller waits for anything, by when it has disarmed them.
            self.context.loop.call_soon(self._ending.subtract, ending)
        return waited

    def may_move(self, topic: str) -> bool:
        """Whether a motion may begin on a topic: not while motions end there, or the bridge does."""
        return not self._ending[topic] and not self._ending[_EVERY_TOPIC]

    @property
    def session(self) -> Session:
        """The session as operators have left it. May be called from any thread."""
        return self.role.session

    # --- life

    async def start(self) -> None:
        """Bind, or begin to connect.

        Raises:
            EngineError: it cannot; nothing is left open.
        """
        started = False
        try:
            self.context.announcements.start(self._bridges_changed)
            self._shutdown_watch = self._watch_shutdown()
            self._set_pace()
            for part in self._parts:
                part.open()
            await self.role.start()
            started = True
        except (ListenError, RosError, LinkError, ValueError) as error:
            raise EngineError(str(error)) from None
        finally:
            # Also after an unexpected error: the next start needs the port.
            if not started:
                await self._close()
        self._snapshots.refresh_now(self.role)

    async def run(self) -> None:
        """Do the regular work until `stop` is called, then tell the peers and close everything."""
        context, graph_watch = self.context, self.graph_watch
        context.ros.watch(graph_watch.changed, lambda reason: context.call(lambda: self._ros_failed(reason)))
        try:
            if context.ros.discovery.servers:
                self._tasks.keep(self._ask_discovery_servers, Backoff(_TICK, _LONGEST_PAUSE))
            for work in (self._tick, graph_watch.run, self._names.run, lambda: self._snapshots.run(self.role)):
                self._tasks.keep(work, Backoff(_TICK, _LONGEST_PAUSE))
            await self._stopping.wait()
        finally:
            self._tasks.cancel()
            await self._close()

    def stop(self) -> None:
        """Have `run` return soon."""
        self._stopping.set()

    async def _tick(self) -> None:
        """Do the regular work once a second, for ever."""
        now, ros = self.context.now, self.context.ros
        lost: frozenset[LostPort] = frozenset()
        due = now()
        for number in itertools.count(1):
            due += _TICK
            if due <= now():  # ticks that were missed are not made up for
                due = now() + _TICK
            await asyncio.sleep(due - now())
            self.context.limited.tick()
            self.role.tick()
            self._tell_feature_faults()
            for link in self.role.links():
                await link.table.tick_routes()
                link.guarded(link.tick)
                await link.extensions.tick(link.guarded)
                await asyncio.sleep(0)  # no message waits until hundreds of links have had their turn
            for part in self._ticking:
                with self._part_may_fail(part):
                    part.tick(self._snapshots.latest)
            if number % _LISTENS_EVERY == 0:
                before, lost = lost, ros.lost_ports()
                if stuck := before & lost:
                    self._ros_failed(RosProblem.DEAF(port=min(stuck).path))

    def _tell_feature_faults(self) -> None:
        """Log what has been left out of features since the last time."""
        for each in feature_faults()[self._faults_told :]:
            self.context.events.add(Level.WARNING, EventCode.ENGINE_FEATURE_LEFT_OUT, str(each))
            self._faults_told += 1

    async def _ask_discovery_servers(self) -> None:
        """Ask whether they answer, for ever, and have the routes say so that miss a node."""
        discovery, events = self.context.ros.discovery, self.context.events
        was_broken: bool | None = None
        while True:
            with contextlib.suppress(TimeoutError):  # names are looked up for longer
                if await in_thread("discovery", discovery.look, _DISCOVERY_ASKED_WITHIN):
                    for route in (each for link in self.role.links() for each in link.routes.values()):
                        route.judge_again()
                    self.graph_watch.changed()  # what provides calls keeps its reason until then
            if discovery.is_broken is not was_broken:
                was_broken = discovery.is_broken
                level = Level.WARNING if was_broken else Level.INFO
                events.add(level, EventCode.ENGINE_DISCOVERY, discovery.found)
            await asyncio.sleep(_DISCOVERY_ASKED_EVERY)

    @contextlib.contextmanager
    def _part_may_fail(self, part: EnginePart) -> Iterator[None]:
        """Do work of a part; a failure of it is logged, and ends nothing else."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 -- of code that is not ours
            message = f"the part {type(part).__name__} of the engine failed"
            self.internal_error(self.context.loop, {"message": message, "exception": error})

    def _ros_failed(self, reason: str) -> None:
        """End because the ROS side is gone or deaf, so that a supervisor starts the process again."""
        self.context.events.add(Level.ERROR, EventCode.ENGINE_ROS_FAILED, f"{reason}: the engine stops; start it again")
        self.stop()

    async def _close(self) -> None:
        if self._shutdown_watch is not None:
            self._shutdown_watch.close()
        # Before anything else takes its time: the message that ends a motion has to cross the links. Then none begins.
        self._ending[_EVERY_TOPIC] += 1
        await self.end_motions()
        for part in self._parts:
            with self._part_may_fail(part):
                await part.close()
        self.context.descriptions.close()
        await self.role.stop()
        if self.context.rests:  # a publisher that closes at once may take its message with it
            await asyncio.wait(self.context.rests)
        self.context.announcements.stop()
        self.context.events.add(Level.INFO, EventCode.ENGINE_STOPPED, "stopped")
        self._snapshots.refresh_now(self.role, running=False)
        # Last: the loop stands still meanwhile, and while all this took its time, a scrape or a command could end.
        for part in self._parts:
            with self._part_may_fail(part):
                part.join()

    def _bridges_changed(self) -> None:
        for link in self.role.links():
            if link.linked:
                link.neighbourhood.tell()
        self.graph_watch.changed()

    def _watch_shutdown(self) -> LastingSubscription | None:
        context, topic = self.context, self.context.session.shutdown_topic
        if topic is None:
            return None
        message = f'"shutdown" on {topic} in domain {context.domain_id}'

        def act() -> None:
            context.events.add(
                Level.WARNING, EventCode.ENGINE_SHUTDOWN, f"{message}: closing the sockets on both sides"
            )
            self.role.shut_down(message)

        def sink(batch: Sequence[RawMessage]) -> None:
            if any(string_bytes(taken.payload) == _WORD for taken in batch):
                context.call(act)

        def subscribe(on_failure: OnFailure) -> Subscription:
            # A bridge needs no types: without std_msgs, the topic works nevertheless.
            type_hash = context.ros.installed_hash(STRING) or STRING_HASH
            return context.ros.subscribe(
                TopicSpec(topic, STRING, type_hash, Qos()), sink, None, on_failure, express=True
            )

        def changed() -> None:
            if watch.failure:
                text = f"{watch.failure}: the shutdown topic has no effect until the subscription is open again"
                context.events.add(Level.ERROR, EventCode.ENGINE_SUBSCRIBE_FAILED, text)

        watch = LastingSubscription(context.loop, subscribe, changed)
        return watch

    def internal_error(self, _: asyncio.AbstractEventLoop, details: dict[str, object]) -> None:
        """Log an uncaught exception; an event loop's exception handler."""
        error = details.get("exception")
        message = Unable.INTERNAL(problem=error or details.get("message"))
        now = self.context.now()
        if now - self._errors_logged.get(message, -_ERROR_LOGGED_EVERY) < _ERROR_LOGGED_EVERY:
            return
        # Only the newest one: the texts of errors differ without end.
        self._errors_logged = {message: now}
        exc_info = (type(error), error, error.__traceback__) if isinstance(error, BaseException) else None
        _logger.error("%s", message, exc_info=exc_info)
        self.context.events.add(Level.ERROR, EventCode.ENGINE_ERROR, message)

    # --- commands

    async def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> R:
        """Execute a command. Its errors become an `EngineError`, and the snapshot shows its effect.

        Args:
            step: called with each step of a restart, or None.
        """
        act: Callable[[Any], Coroutine[None, None, object]] = (
            partial(self._restart, step) if isinstance(command, commands.Restart) else self.handlers[type(command)]
        )
        given_at = self.context.now()
        async with self._changing if command.one_at_a_time else contextlib.nullcontext():
            if command.expires and self.context.now() - given_at > command.life:
                raise EngineError(Unable.TOO_LATE())
            try:
                return cast("R", await act(command))
            except FieldError as error:
                raise InvalidRequestError(str(error)) from None
            except (LinkError, ListenError, RosError, PeekError, CallError, ValueError) as error:
                raise EngineError(str(error)) from None
            finally:
                if command.refreshes and not self._stopping.is_set():  # the last snapshot shows the end, and stays
                    await self._show_effect(command)

    async def _show_effect(self, command: Command[Any]) -> None:
        if isinstance(command, _OF_ONE_ROUTE) and (found := route_in(self.role.links(), command.key)) is not None:
            self._snapshots.refresh_route(self.role, *found)
        else:  # the key may also be a pattern's, or of a route that is gone
            await self._snapshots.refresh_all(self.role)

    async def _acknowledge(self, command: commands.Acknowledge) -> None:
        await self._snapshots.refresh_all(self.role)
        # In the newest state: the fault that the operator has seen may be over.
        faulty = find_faulty(self._snapshots.latest, command.key, command.link, command.seen)
        acknowledgements = self._snapshots.acknowledged
        if command.acknowledged:
            acknowledgements.add(faulty, operator())
            code, what = EventCode.OPERATOR_ACKNOWLEDGED, f"{faulty.state.upper()} acknowledged"
        else:
            acknowledgements.remove(faulty)
            code, what = EventCode.OPERATOR_ACKNOWLEDGEMENT_UNDONE, "acknowledgement taken back"
        if isinstance(faulty, LinkSnapshot):
            self.log.add(code, what, link=faulty.name)
        else:
            name = faulty.topic if isinstance(faulty, RouteSnapshot) else faulty.spec.topic
            self.log.add(code, what, topic=name, link=faulty.link)
        self._snapshots.publish(self.role)

    async def change_clients(self, session: Session, keys: Keys) -> None:
        """Change to a server's session with other clients.

        Args:
            keys: of the clients that are new or have others.
        """
        for problem in validate(session):
            raise LinkError(str(problem))
        known = {**self.role.keys, **keys}
        keys = {client.name: known[client.name] for client in session.accepted_clients}
        if shared := shared_key_problem(session, keys):
            raise LinkError(shared)
        with self.context.demands.changing():
            _, failed = await self._reload(session, keys)
        if failed:
            raise LinkError("; ".join(failed))

    async def _retry(self, command: commands.Retry) -> None:
        if command.link:
            # For its error: a server would do nothing about a name that no link has, and report success.
            link_named(command.link, self.role.links())
        self.role.retry(command.link)
        self.log.add(EventCode.OPERATOR_RETRIED, "tried again", link=command.link)

    async def _shut_down(self, _: commands.ShutDownLinks) -> None:
        await self.end_motions()
        self._arming.end_all(Disarmed.REOPENED)
        self.log.add(EventCode.OPERATOR_SHUT_DOWN, "shut down on both sides")
        self.role.shut_down(operator())

    async def _restart(self, step: Callable[[str], None] | None, _: commands.Restart) -> None:
        def report(message: str) -> None:
            self.context.events.add(Level.INFO, EventCode.ENGINE_RESTARTING, f"restart: {message}")
            if step is not None:
                step(message)

        await self.end_motions()
        self._arming.end_all(Disarmed.REOPENED)
        self.log.add(EventCode.OPERATOR_RESTARTED, "restarted: all links are closed and opened again")
        await self.role.restart(report)

    async def reload(
        self, session: Session, keys: Keys, *, dry_run: bool, drop_arm: bool = False
    ) -> tuple[list[str], list[str]]:
        """Do what another session says.

        Args:
            session: differs from the present one in nothing that is fixed while the bridge runs.
            drop_arm: whether the demands to arm end that it does not make any more.

        Returns:
            What has changed, and what failed, in words.
        """
        demands = self.context.demands
        other = demands.ended_by(session)
        about = DemandText.DROPPED if drop_arm else DemandText.STAYS
        first = [ReloadStep(about(name=each.name, origin=demands.origin(each)), lambda: None) for each in other]
        if not drop_arm:
            # What the file demands no longer stays demanded until an operator drops it by name.
            armed = merged((*session.armed, *map(as_armed, other)))
            session, other = msgspec.structs.replace(session, armed=tuple(armed.values())), []
        if dry_run:
            return [step.text for step in (*first, *await self._steps_to(session, keys))], []
        await self.end_motions()
        self._arming.end_all(Disarmed.RELOADED)
        with demands.changing():
            demands.tell_end(other)
            outcome = await self._reload(session, keys, first)
            said = all_armed(session.armed, sources_of_topics(session))
            demands.end(other, said.values())
        return outcome

    async def _reload(
        self, session: Session, keys: Keys, first: Sequence[ReloadStep] | None = None
    ) -> tuple[list[str], list[str]]:
        """Change to another session, for a command about clients, or with the first steps of a reload."""
        steps = await self._steps_to(session, keys)
        code = EventCode.OPERATOR_CLIENTS if first is None else EventCode.OPERATOR_RELOADED
        done: list[str] = []
        failed: list[str] = []
        why = f"reload by {operator()}: " if first is not None else ""

        def take(step: ReloadStep) -> None:
            try:
                step.apply()
            except (LinkError, ListenError, RosError, ValueError) as error:
                # A step that fails keeps no other one from being done.
                failed.append(f"{step.text}: {error}")
                self.context.events.add(
                    Level.ERROR, EventCode.ENGINE_RELOAD_FAILED, f"{why}not done: {failed[-1]}", who=operator()
                )
            else:
                done.append(step.text)
                self.context.events.add(Level.INFO, code, f"{why}{step.text}{undo_mark()}", who=operator())

        self.context.demands.use(session)  # before the steps, which read it
        await in_slices([*(first or ()), *steps], take)
        return done, failed

    async def _steps_to(self, session: Session, keys: Keys) -> list[ReloadStep]:
        old = msgspec.structs.replace(self.context.session, armed=self.context.demands.written)
        in_place = (
            (("stale_after", "stale_warnings", "late_after", "check_messages"), self._configure_routes),
            (("pace",), self._set_pace),
            (("group", "ports", "shared_keys", "outlive"), lambda: None),  # they are read in the session when needed
            (("armed",), lambda: None),  # `RunningDemands.use` has read it
            (("shutdown_topic",), self._change_shutdown_topic),
            *(live for part in self._parts for live in part.by_key),
        )
        steps = [
            ReloadStep(", ".join(said), act) for names, act in in_place if (said := changes(old, session, only=names))
        ]
        await in_slices(self.role.steps_to(session, keys), steps.append)
        return steps

    def _set_pace(self) -> None:
        self.context.ros.turns.pacing.longest = self.context.session.pace

    def _configure_routes(self) -> None:
        for link in self.role.links():
            for route in link.routes.values():
                route.half.configure()

    def _change_shutdown_topic(self) -> None:
        # The new one first: if it cannot be opened, the old one is still there.
        before, self._shutdown_watch = self._shutdown_watch, self._watch_shutdown()
        if before is not None:
            before.close()

    def _followers(self) -> Iterator[Follower]:
        """Yield the parts that follow the names of this side's graph."""
        for link in self.role.links():
            yield link.patterns
            if (followed := link.patterns.followed) is not None:
                yield followed

    async def _topics(self, command: commands.Topics) -> tuple[TopicInfo, ...]:
        if command.link is None:
            return tuple(await asyncio.to_thread(graph_of, self.context.ros, CALLED))
        return tuple(await topics_of_peer(self.role.links(), command.link))
