"""Operators' commands about single topics, about patterns, which make routes, and about arming."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import msgspec

from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.engine.part import EnginePart
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.model.by_hand import Held
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import (
    AddTopic,
    AnswerAsker,
    ArmTopic,
    AskHolder,
    DisarmTopic,
    EditTopic,
    KeepArmed,
    PauseTopics,
    ReleaseArmed,
    RemoveTopic,
    TakeArming,
    console,
    is_undo,
    operator,
)
from rsb_bridge.model.demands import PEER_DEMANDS, armed_line, local_name, sources_of_entries
from rsb_bridge.model.snapshot import Level
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.lifecycle import PAUSE_WORDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from enum import StrEnum

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link
    from rsb_bridge.link.roles import BridgeRole
    from rsb_bridge.model.demands import DemandSource, SourceKey
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.peeking import Peeking
    from rsb_bridge.route.route import Entry, Route
    from rsb_bridge.telemetry.event_log import EventLog

_INSTEAD = "remove the one, and add the other"


class CommandLog:
    """Records operators' commands in the event log."""

    def __init__(self, events: EventLog) -> None:
        self._events = events

    def add(
        self,
        code: StrEnum,
        what: str,
        *,
        level: Level = Level.INFO,
        topic: str = "",
        link: str = "",
        old: str = "",
        new: str = "",
    ) -> None:
        """Record a command; `topic` is its name on this side."""
        who = operator()
        text = f"{f'{topic}: ' if topic else ''}{what} by {who}{undo_mark()}"
        self._events.add(level, code, text, link=link, topic=topic, who=who, old=old, new=new)


def undo_mark() -> str:
    """Return the end of an event's text: a mark if the operator takes back an earlier change."""
    return " (undo)" if is_undo() else ""


class CommandedBridge(Protocol):
    """The bridge that commands act on (`rsb_bridge.engine.bridge.Bridge`).

    Attributes:
        log: of operators' commands.
        peeking: gives messages that pass.
    """

    context: Context
    role: BridgeRole
    log: CommandLog
    peeking: Peeking

    def find(self, key: str) -> tuple[Link, Route]:
        """Return a route and its link by the route's key.

        Raises:
            LinkError: nothing has this key.
        """

    async def end_motions(self, topics: set[str] | None = None) -> bool:
        """Stop the robots that operators move, on some topics or all, before that is no longer possible.

        Returns:
            Whether that took a while, in which the peer may have changed anything.
        """


class Named(NamedTuple):
    """The entry that a command's key names.

    Attributes:
        entry: the topic, or the pattern.
        route: of the topic, or None for a pattern.
    """

    link: Link
    entry: Topic
    route: Route | None

    @property
    def name(self) -> str:
        """Its name on this side."""
        if self.route is not None:
            return self.route.local_topic
        link, on_server = self.link, not self.link.is_client
        return local_name(self.entry, link.name, on_server=on_server, use_name=on_server and link.end.use_name)

    def routes(self) -> tuple[Route, ...]:
        """Return the topic's route, or the routes that the pattern has made by now."""
        if self.route is not None:
            return (self.route,)
        return self.link.patterns.made.routes_of(self.entry)


def route_in(links: Iterable[Link], key: str) -> tuple[Link, Route] | None:
    """Return the route of a key with its link, or None if no route has the key, or it is a pattern's."""
    for link in links:
        if (route := link.routes.get(key)) is not None:
            return link, route
    return None


def named_in(links: Sequence[Link], key: str) -> Named:
    """Return the entry of a key.

    Raises:
        LinkError: nothing has this key.
    """
    if (found := route_in(links, key)) is not None:
        link, route = found
        return Named(link, route.spec, route)
    for link in links:
        if (pattern := link.patterns.find(key)) is not None:
            return Named(link, pattern, None)
    raise LinkError(Denied.NO_ROUTE(key=key))


class TopicCommands(EnginePart):
    """Executes commands about single topics and patterns."""

    def __init__(self, bridge: CommandedBridge) -> None:
        self._bridge = bridge
        self._log = bridge.log
        self._demands = bridge.context.demands
        self.handlers = {
            AddTopic: self.add,
            EditTopic: self.edit,
            PauseTopics: self.pause,
            RemoveTopic: self.remove,
        }

    async def _stopped(self, key: str) -> Named:
        """Return what a key names after the motions on its topics have ended."""
        named = named_in(self._bridge.role.links(), key)
        if await self._bridge.end_motions({route.local_topic for route in named.routes()}):
            # The peer may have removed or edited it while the robots came to rest.
            return named_in(self._bridge.role.links(), key)
        return named

    async def add(self, command: AddTopic) -> str:
        with self._demands.changing():
            link, key, topic = self._bridge.role.add(command.topic, command.link)
        route = link.routes.get(key)
        topic, name = (topic, topic.topic) if route is None else (route.spec, route.local_topic)
        self._log.add(EventCode.OPERATOR_ADDED, "added", topic=name, link=link.name, new=described(topic))
        return key

    async def edit(self, command: EditTopic) -> str:
        named = await self._stopped(command.key)
        link, old, route = named
        routes = named.routes()
        with self._demands.changing():
            # A form, a plan or an undo writes the whole topic: it would take back what another operator has changed.
            if command.seen is not None and (differences := changes(command.seen, old)):
                raise LinkError(Denied.CHANGED(topic=old.topic, differences=", ".join(differences)))
            topic, entry, ended = self._checked(named, command)
            there = None
            if route is None or entry is None:
                new_key, name = link.patterns.replace(old.identity, topic), topic.topic
            elif route.proposed_here:
                new = link.proposed.replace(route, entry)
                new_key, name = new.key, new.local_topic
            else:
                new_key, name = link.proposed.names(entry)
                there = link.proposed.demand(route, topic)
            self._demands.end(ended)
            if old.arm and topic.arm and (route is None or route.here is not None):
                self._demands.edited(_line(link, old), _line(link, topic))
        if route is not None and there is not None:
            await link.proposed.edit_there(route, there)
        what = f"changed ({', '.join(changes(old, topic)) or 'nothing differs'})"
        self._log.add(
            EventCode.OPERATOR_EDITED, what, topic=name, link=link.name, old=described(old), new=described(topic)
        )
        await _settled(routes)
        return new_key

    def _checked(self, named: Named, command: EditTopic) -> tuple[Topic, Entry | None, list[DemandSource]]:
        """Return what an edit puts there, with the client's names, and the demands that an operator ends by it.

        A pattern has no `Entry`.
        """
        topic, drop_arm = command.topic, command.drop_arm
        if drop_arm and topic.arm:
            raise LinkError(f"{topic.topic} would still have to be armed: set arm=false together with --drop-arm")
        link, old, route = named
        if (route is None) != topic.is_pattern:
            one, other = (topic.topic, old.topic) if route is not None else (old.topic, topic.topic)
            raise LinkError(f"{one} is a pattern, and {other} is none: {_INSTEAD}")
        entry = None
        if route is None:
            link.patterns.check_replace(old.identity, topic)
        else:
            # The present name is the client's already, and may look like one with the client's name before it.
            if topic.topic != old.topic:
                topic = link.end.client_names(topic)
            link.proposed.check_replace(route, entry := link.proposed.entry(topic))
        # Last, because nothing may refuse the edit after that.
        return topic, entry, self._ended(named, wanted=drop_arm, names_it=old.arm and not topic.arm)

    async def remove(self, command: RemoveTopic) -> str:
        # A pattern that matches the topic leaves it out from then on.
        named = await self._stopped(command.key)
        routes = named.routes()
        with self._demands.changing():
            self._remove(named, drop_arm=command.drop_arm)
        await _settled(routes)
        if named.route is None:
            sources = [each for each in self._demands.read().sources if each.arm and each.name == named.name]
        else:
            demand = named.link.table.arming.demand_on(named.route, self._demands.read())
            sources = [] if demand is None else [*demand.sources]
        return ", ".join(map(self._demands.origin, sources))

    def _remove(self, named: Named, *, drop_arm: bool) -> None:
        link, topic, route = named
        if route is None:
            name = topic.topic
            ended = self._ended(named, wanted=drop_arm)
            link.patterns.remove(topic.identity)
        else:
            if problem := link.patterns.brings_back(route):
                raise LinkError(problem)
            name = route.local_topic
            ended = self._ended(named, wanted=drop_arm)
            link.extensions.removed(route)
            link.table.remove(route, "removed by an operator")
            link.patterns.leave_out(route)
        self._demands.end(ended)
        self._log.add(EventCode.OPERATOR_REMOVED, "removed", topic=name, link=link.name, old=described(topic))

    def _ended(self, named: Named, *, wanted: bool, names_it: bool = False) -> list[DemandSource]:
        """Return the lines that demand arming of an entry's name, if an operator ends them.

        The peer hears of this at once, so call this only when the change itself can no longer be refused.

        Args:
            wanted: whether the operator has agreed.
            names_it: whether the change itself removes `arm` from the entry.

        Raises:
            LinkError: the operator has not agreed, or another line demands arming, too.
        """
        demands, name, (link, entry, route) = self._demands, named.name, named
        others_keys = self._others(named)
        own = [
            each
            for each in demands.read().sources
            if each.arm and each.name == name and each.kind in (None, entry.kind) and each.key not in others_keys
        ]
        if names_it and not wanted:
            lines = ", ".join(map(demands.origin, own)) or PEER_DEMANDS
            raise LinkError(f"{name} has to be armed ({lines}): --drop-arm ends that, too")
        if not wanted:
            return []
        demand = None if route is None else link.table.arming.demand_on(route, demands.read())
        others = [each for each in ([] if demand is None else demand.sources) if each not in own]
        if others or (not own and route is not None and route.arming.required):
            lines = ", ".join(map(demands.origin, others)) or PEER_DEMANDS
            raise LinkError(f"{name} still has to be armed: {lines} demands it, too; change that instead")
        demands.tell_end(own)
        # This side's entry stays as it was if the other side refuses the edit, and would bring the demand back.
        if route is not None and route.here is not None and route.there is not None:
            unarmed = msgspec.structs.replace(route.spec, arm=False, deadman=None, on_end=None)
            route.enter(route.here._replace(topic=unarmed), route.there)
        return own

    def _others(self, named: Named) -> set[SourceKey]:
        """Return the keys of the lines that other entries than this one add."""
        own = "" if named.link.is_client else named.link.name, named.entry.identity
        links = self._bridge.role.links()
        entries = (each for link in links for each in link.entries.demand_sources() if each.arm and each.key != own)
        return {armed_line(each).key for each in entries}

    async def pause(self, command: PauseTopics) -> None:
        paused = command.paused
        named = await self._stopped(command.key)
        link, entry, route = named
        stopped = routes = named.routes()
        code = EventCode.OPERATOR_PAUSED if paused else EventCode.OPERATOR_RESUMED
        if route is None:
            old, name = PAUSE_WORDS[entry.paused], entry.topic
            link.patterns.replace(entry.identity, msgspec.structs.replace(entry, paused=paused))
            routes = named.routes()
        else:
            old, name = PAUSE_WORDS[route.pausing.paused], route.local_topic
        for each in routes:
            link.table.pause(each, paused=paused)
        what, new = "paused" if paused else "resumed", PAUSE_WORDS[paused]
        self._log.add(code, what, topic=name, link=link.name, old=old, new=new)
        await _settled(stopped)


class ArmingCommands(EnginePart):
    """Executes commands about arming, each for the console that gives it."""

    def __init__(self, bridge: CommandedBridge) -> None:
        self._bridge = bridge
        self.handlers = {
            AnswerAsker: self.answer,
            ArmTopic: self.arm,
            AskHolder: self.ask,
            DisarmTopic: self.disarm,
            KeepArmed: self.keep,
            ReleaseArmed: self.release,
            TakeArming: self.take,
        }

    async def arm(self, command: ArmTopic) -> None:
        link, route = self._bridge.find(command.key)
        # Raises at its end if the console has gone, which would leave the topic armed by nobody.
        with link.table.arming.waiting(route, console()) as waiting:
            await link.table.arming.load_type(route)
            link, route = self._bridge.find(command.key)  # it may have been edited meanwhile
            await link.table.arming.until_open(route, waiting)
        link, route = self._bridge.find(command.key)
        await link.table.arming.arm(route, console(), shared=command.shared)

    async def ask(self, command: AskHolder) -> None:
        link, route = self._bridge.find(command.key)
        opening = route.id
        with link.table.arming.waiting(route, console()):
            await link.table.questions.ask(route, console())
        await self._take(command, opening)

    async def take(self, command: TakeArming) -> None:
        _, route = self._bridge.find(command.key)
        await self._take(command, route.id)

    async def _take(self, command: AskHolder | TakeArming, opening: int) -> None:
        """Disarm a route if it is still held in an opening, and arm it. The robot stops in between."""
        link, route = self._bridge.find(command.key)
        with link.table.arming.waiting(route, console()):
            # The holder of a later opening was not asked.
            if route.id == opening and route.arming.held and route.arming.console != console():
                await self._disarm(link, route)
        await self.arm(ArmTopic(command.key, command.shared))

    async def answer(self, command: AnswerAsker) -> None:
        link, route = self._bridge.find(command.key)
        link.table.questions.answer(route, console(), gives=command.gives, who=command.who)

    async def disarm(self, command: DisarmTopic) -> None:
        link, route = self._bridge.find(command.key)
        # A command that is about to arm it would do so afterwards.
        link.table.arming.withdraw(route, console() if command.own else None)
        if not command.own or route.arming.console == console():
            await self._disarm(link, route)

    async def _disarm(self, link: Link, route: Route) -> None:
        await self._bridge.end_motions({route.local_topic})
        link.table.arming.disarm(route, Disarmed.OPERATOR)
        await _settled((route,))

    async def keep(self, command: KeepArmed) -> Held:
        for link in self._bridge.role.links():
            link.table.arming.seen(console(), pressed=command.pressed)
            link.table.questions.seen(console())
        routes = (route for link in self._bridge.role.links() for route in link.routes.values())
        held = (route.key for route in routes if route.arming.held and route.arming.console == console())
        return Held(tuple(held))

    async def release(self, _: ReleaseArmed) -> None:
        routes = (route for link in self._bridge.role.links() for route in link.routes.values())
        await self._bridge.end_motions({route.local_topic for route in routes if route.arming.console == console()})
        for link in self._bridge.role.links():
            link.table.arming.gone(console())

    def end_all(self, why: Disarmed) -> None:
        """Disarm everything, before a change of the whole bridge: that takes time, in which robots would go on."""
        for link in self._bridge.role.links():
            link.table.arming.disarm_all(why)


def _line(link: Link, entry: Topic) -> DemandSource:
    """Return the line of `armed` that an entry with `arm` adds."""
    on_server = not link.is_client
    (source,) = sources_of_entries((entry,), link.name, on_server=on_server, use_name=on_server and link.end.use_name)
    return armed_line(source)


async def _settled(routes: Iterable[Route]) -> None:
    """Wait until nothing can be published any more that was armed before a command."""
    for route in routes:
        await route.settling.wait()
