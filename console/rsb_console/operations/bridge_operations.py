"""Changes of the bridge: each action of the registry's `Group.OPERATE` is a command to the engine."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast
from weakref import WeakSet

from textual.events import Key

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.look.formats import PatternRow
from rsb_console.session.changes import (
    Added,
    CannotUndoError,
    Edited,
    Paused,
    Removed,
    find_entry,
    named_by_client,
    patterns_of,
)
from rsb_console.widgets.topics import is_armed

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from concurrent.futures import Future

    from textual.events import Event
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.by_hand import Held
    from rsb_bridge.model.session import Topic
    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.console_api import Console
    from rsb_console.look.formats import Row
    from rsb_console.screens.main import MainScreen
    from rsb_console.screens.topic_form import TopicDraft

R = TypeVar("R", bound="Row")
_LINES_SHOWN = 12
"""Lines of a question about a reload; the others are counted. A round figure."""


class OperationText(Wording):
    """Questions and notes about changes of the bridge."""

    NO_CLIENT = "this server has no client yet: add one first, with a in the links (c)"
    NOTHING_TO_UNDO = "nothing to undo: nothing was changed on this console"
    NOTHING_MORE_TO_UNDO = "nothing more to undo"
    AS_IN_FILE = "the bridge already runs as in the session file"
    RELOAD = "Reload the session file?"
    RESUME = "Resume {topic}?"
    RESUME_MEANS = "The key may have come late, so it is asked for. Messages cross again at once{arming}."
    IS_ALREADY = "{topic} was paused or resumed meanwhile: look, and press the key again"
    AFTER_ALL = "{topic}: done after its form was left (u undoes it)"


_RETRIED_ON_SERVER = "topics that were refused are opened again; clients whose links were shut down may come back"


def _removal(route: Row) -> str:
    if isinstance(route, PatternRow):
        return f"All that it has brought ({route.routes}) stop crossing at once"
    return "It stops crossing at once"


def _dropping(route: Row) -> tuple[str, str]:
    """Return the title and the message of the question whether to end a demand to be armed."""
    lines = () if route.arming is None else route.arming.demanded_by
    crosses = "From then on it crosses without being armed, on both sides."
    by = f"\nIt has to be armed now: {', '.join(lines)}." if lines else ""
    return f"No longer arm {route.topic}?", f"{crosses}{by}"


def _last_event(engine: EngineApi) -> int:
    events = engine.events()
    return events[-1].number if events else 0


def _name_here(engine: EngineApi, key: str, name: str) -> str:
    """Return the name of a new route on this side, or the given name while the route is not seen yet."""
    found = find_entry(engine.snapshot(), key)
    return name if found is None else found.topic


class BridgeOperations:
    """Methods named after their actions, each run as a worker.

    Args:
        screen: gives the screen that shows the topics.
    """

    def __init__(self, console: Console, screen: Callable[[], MainScreen]) -> None:
        self._console = console
        self._screen = screen
        self._undoing = False

    def _selected(self) -> Row | None:
        return self._screen().topics.selected

    @property
    def _route(self) -> RouteSnapshot | None:
        """The route under the cursor, or None if that is a pattern."""
        row = self._selected()
        return None if isinstance(row, PatternRow) else row

    def _now(self, row: R) -> R:
        """Return the present state of a row: a frozen list shows an old one, and one that a picture has hidden."""
        return cast("R", find_entry(self._console.snapshot(), row.key) or row)

    async def pause(self) -> None:
        """Pause the topic under the cursor, or resume it, after a question if the key may have come late."""
        engine, route = self._console.engine, self._selected()
        if engine is None or route is None:
            return
        paused = route.state is not State.PAUSED
        if (self._now(route).state is not State.PAUSED) is not paused:
            self._console.notify(OperationText.IS_ALREADY(topic=route.topic), severity="warning", markup=False)
            return
        # Only resuming can move something: a key that a hung terminal delivers late may pause.
        if not paused and not await self._resumes(route):
            return
        mixed = isinstance(route, PatternRow) and any(
            each.spec.paused is paused
            for each in self._console.snapshot().routes
            if each.pattern == route.spec.topic
            and (each.link, each.spec.kind, each.spec.direction) == (route.link, route.spec.kind, route.spec.direction)
        )
        change = Paused(route.link, route.topic, _last_event(engine), key=route.key, paused=paused, mixed=mixed)
        if await self._console.command(engine.pause(route.key, paused)) and route.spec.paused is not paused:
            self._console.changes.add(change)

    async def _resumes(self, route: Row) -> bool:
        """Whether the operator resumes a topic, after a question if the key may have come late."""
        from rsb_console.screens.dialog import is_meant  # noqa: PLC0415 -- keeps the start short

        arming = "" if route.arming is None else ", once it is armed"
        title, means = OperationText.RESUME(topic=route.topic), OperationText.RESUME_MEANS(arming=arming)
        return await is_meant(self._console, self._screen().app, title, means, "Resume")

    async def acknowledge(self) -> None:
        """Acknowledge the fault of the topic under the cursor, or take that back."""
        engine, route = self._console.engine, self._selected()
        if engine is not None and route is not None:
            seen = None if isinstance(route, PatternRow) else (route.state, route.cause)
            await self._console.command(engine.acknowledge(route.key, route.acknowledged is None, seen=seen))

    async def arm(self) -> None:
        """Arm the topic under the cursor, after a question; disarm it at once, even if another operator armed it.

        On a topic that is never armed, disarm what this console holds, if that is one topic.
        """
        from rsb_console.screens.dialog import ArmScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._route
        if engine is None:
            return
        if route is None or route.arming is None:
            held = [each for each in self._console.snapshot().routes if each.key in self._console.deadman.held]
            names = sorted({each.topic for each in held})
            if len(names) == 1:
                await self._disarm(engine, held[0])
            elif names:
                text = f"go to the topic to disarm: {', '.join(names)}"
                self._console.notify(text, title="Not done", severity="warning", markup=False)
        elif is_armed(now := self._now(route)) or is_armed(route):
            # This key stops a robot: it asks nobody, even if another operator holds the topic.
            await self._disarm(engine, route)
        elif now.state is State.PAUSED:
            text = f"{route.topic} cannot be armed: it is paused; resume it first"
            self._console.notify(text, title="Not done", severity="warning", markup=False)
        elif await self._console.ask(ArmScreen(now)):
            self._console.deadman.armed_on(self._screen())
            await self._console.command(engine.arm(route.key))

    async def _disarm(self, engine: EngineApi, route: RouteSnapshot) -> None:
        """Disarm all routes of a name, on all links."""
        armed = [
            each.key
            for each in self._console.snapshot().routes
            if (each.topic, each.spec.kind) == (route.topic, route.spec.kind) and each.key != route.key
            if each.arming is not None and each.arming.armed
        ]
        # All commands are sent before the first answer: a slow one must not keep the others armed.
        for future in [engine.disarm(key) for key in (route.key, *armed)]:
            await self._console.command(future)
        if armed:
            self._console.notify(
                f"{route.topic}: all its {len(armed) + 1} routes are disarmed", markup=False, timeout=5
            )

    async def call(self) -> None:
        """Call what is under the cursor by hand."""
        from rsb_console.screens.call_screen import CallScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._route
        if engine is not None and route is not None and route.lanes:
            await self._console.ask(CallScreen(self._console, route))

    async def retry(self) -> None:
        from rsb_console.screens.links_screen import lets_back  # noqa: PLC0415 -- keeps the start short

        engine, now = self._console.engine, self._console.snapshot()
        if engine is not None and await lets_back(self._console, self._screen().app, now.links):
            done = _RETRIED_ON_SERVER if now.role == "server" else "trying again"
            await self._console.command(engine.retry(), done)

    async def add_topic(self) -> None:
        from rsb_console.screens.topic_form import TopicScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return
        if not engine.snapshot().links:
            self._console.notify(OperationText.NO_CLIENT(), severity="warning", markup=False, timeout=8)
            return

        key = ""

        async def act(draft: TopicDraft) -> None:
            nonlocal key
            now, since = engine.snapshot(), _last_event(engine)
            key = await asyncio.wrap_future(engine.add_topic(draft.topic, draft.link))
            link = draft.link or now.links[0].name
            spec = named_by_client(draft.topic, now, link)
            self._console.changes.add(
                Added(link, _name_here(engine, key, draft.topic.topic), since, key=key, spec=spec)
            )

        async def add(draft: TopicDraft) -> None:
            await self._to_the_end(act(draft), draft.topic.topic)

        draft = await self._console.ask(TopicScreen(engine, add))
        if draft is not None:
            self._console.notify(f"{draft.topic.topic}: added", markup=False, timeout=3)
            self._console.pull()
            self._screen().topics.select(key)

    async def edit_topic(self) -> None:
        from rsb_console.screens.dialog import ConfirmScreen  # noqa: PLC0415 -- keeps the start short
        from rsb_console.screens.topic_form import TopicScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if route is None or engine is None:
            return
        route = self._now(route)

        async def act(new: Topic, *, drops: bool) -> None:
            now, since = engine.snapshot(), _last_event(engine)
            key = await asyncio.wrap_future(engine.edit_topic(route.key, new, drop_arm=drops, seen=route.spec))
            if new.topic != route.spec.topic and not new.is_pattern:
                new = named_by_client(new, now, route.link)
            name = _name_here(engine, key, route.topic)
            self._console.changes.add(
                Edited(route.link, name, since, key=key, old=route.spec, new=new, pattern=route.pattern)
            )

        async def edit(draft: TopicDraft) -> None:
            old, new = route.spec, draft.topic
            if new == old:
                return
            drops = old.arm and not new.arm
            if drops and not await self._console.ask(ConfirmScreen(*_dropping(route), "Drop", Effect.MOVES)):
                raise EngineError("not changed: it still has to be armed")
            if old.paused and not new.paused and not drops and not await self._resumes(route):
                raise EngineError("not changed: it stays paused")
            await self._to_the_end(act(new, drops=drops), route.topic)

        if await self._console.ask(TopicScreen(engine, edit, route)) is not None:
            self._console.pull()

    async def _to_the_end(self, act: Coroutine[Any, Any, None], topic: str) -> None:
        """Do what a form has begun, even if the form is left meanwhile: then tell how it ended."""
        going = asyncio.ensure_future(act)
        try:
            await asyncio.shield(going)
        except asyncio.CancelledError:
            going.add_done_callback(partial(self._tell_end, topic))
            raise

    def _tell_end(self, topic: str, going: asyncio.Future[None]) -> None:
        if going.cancelled():
            return
        if (error := going.exception()) is not None:
            self._console.notify(str(error), title="Not done", severity="error", markup=False, timeout=10)
        else:
            self._console.notify(OperationText.AFTER_ALL(topic=topic), markup=False, timeout=10)
            self._console.pull()

    async def remove_topic(self) -> None:
        """Remove the topic under the cursor, after a question."""
        from rsb_console.screens.dialog import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine, route = self._console.engine, self._selected()
        if route is None or engine is None:
            return
        message = f"{_removal(route)}, on both sides of the link with {self._console.peer_of(route)}."
        if route.arming is not None or route.spec.arm:
            message += " Its name still has to be armed (armed in the session)."
        if route.pattern:
            message += f" {route.pattern} leaves it out from then on (except)."
        question = ConfirmScreen(f"Remove {route.topic}?", message, "Remove", Effect.LOSES)
        if not await self._console.ask(question):
            return
        now, since = self._console.snapshot(), _last_event(engine)
        patterns = tuple((row.key, row.spec) for row in patterns_of(now, route.link, route.spec))
        route = find_entry(now, route.key) or route  # as it was when the operator agreed
        change = Removed(
            route.link, route.topic, since, key=route.key, spec=route.spec, pattern=route.pattern, patterns=patterns
        )
        if await self._console.command(engine.remove_topic(route.key)):
            self._console.changes.add(change)

    async def undo(self) -> None:
        """Undo the last change of this console, after a question that shows the effect."""
        from rsb_console.screens.dialog import UndoScreen  # noqa: PLC0415 -- keeps the start short

        engine, changes = self._console.engine, self._console.changes
        change = changes.last
        # A second u while the question is open would ask about the same change again.
        if engine is None or self._undoing:
            return
        if change is None:
            nothing = OperationText.NOTHING_MORE_TO_UNDO if changes.dropped else OperationText.NOTHING_TO_UNDO
            self._console.notify(nothing(), timeout=4)
            return
        self._undoing = True
        try:
            agreed: tuple[str, ...] | None = None
            # Again if it would do something else by then.
            while (undo := change.undo(self._console.snapshot(), engine.events())).lines != agreed:
                agreed = undo.lines
                if not await self._console.ask(UndoScreen(undo)):
                    return
            await undo.act(engine)
        except CannotUndoError as problem:
            changes.drop(change)
            self._console.notify(str(problem), title="Not undone", severity="warning", markup=False, timeout=15)
        except EngineError as error:
            self._console.notify(str(error), title="Not undone", severity="error", markup=False, timeout=15)
        else:
            changes.drop(change)
            self._console.pull()
        finally:
            self._undoing = False

    async def reload(self) -> None:
        """Have the session file read again, after showing what differs."""
        from rsb_console.screens.dialog import ConfirmScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return
        try:
            differs = await asyncio.wrap_future(engine.reload(dry_run=True, drop_arm=True))
        except EngineError as error:
            self._console.notify(str(error), title="Not reloaded", severity="error", markup=False, timeout=15)
            return
        if not differs.changed and not differs.left:
            self._console.notify(OperationText.AS_IN_FILE(), timeout=3)
        elif not differs.changed:
            self._console.notify("\n".join(differs.left), title="Not in place", markup=False, timeout=15)
        else:
            lines = [*differs.changed, *differs.left]
            more = [f"… and {len(lines) - _LINES_SHOWN} more"] if len(lines) > _LINES_SHOWN else []
            message = "\n".join(lines[:_LINES_SHOWN] + more)
            effect = Effect.MOVES | Effect.LOSES
            agreed = await self._console.ask(ConfirmScreen(OperationText.RELOAD(), message, "Reload", effect))
            reloading = engine.reload(drop_arm=True, seen=differs.digest) if agreed else None
            if reloading is None or not await self._console.command(reloading):
                return
            if failed := reloading.result().failed:
                self._console.notify("\n".join(failed), title="Not done", severity="error", markup=False, timeout=15)
                return
            self._console.notify("reloaded", timeout=3)
            if (path := self._console.path) is not None:
                self._console.saved_to(engine.session, path)

    async def restart(self) -> None:
        """Close all links on both sides and open them again, after a question; start an engine that has ended."""
        from rsb_console.screens.dialog import ConfirmScreen, RestartScreen  # noqa: PLC0415 -- keeps the start short

        engine = self._console.engine
        if engine is None:
            return
        if not self._console.snapshot().running and self._console.attached_to:
            self._console.notify("the bridge has ended in its own process: start it there", severity="warning")
            return
        if not self._console.snapshot().running:
            await self._console.start_again()
            return
        effect = Effect.MOVES | Effect.LOSES  # also of armings; and clients that were shut down may come back
        means = "All links are closed on both sides and opened again. Nothing crosses for a few seconds."
        if await self._console.ask(ConfirmScreen("Restart the bridge?", means, "Restart", effect)):
            await self._console.ask(RestartScreen(engine))


class Deadman:
    """Tells the engine, at each refresh, that the console is there, and of keys since the last one.

    Only keys on a screen on which a topic was armed count: who reads the help does not watch the robot.

    Attributes:
        held: keys of the routes that this console holds, as the engine answers.
    """

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()
        self._pressed = False
        self._screens: WeakSet[Screen[Any]] = WeakSet()

    def armed_on(self, screen: Screen[Any]) -> None:
        """Note that a topic is armed on a screen."""
        self._screens.add(screen)

    def saw(self, event: Event, screen: Screen[Any]) -> None:
        """Note a key press on a screen."""
        self._pressed |= isinstance(event, Key) and screen in self._screens

    def keep(self, engine: EngineApi | None, snapshot: Snapshot) -> None:
        """Keep armed what is, and a question open; the engine knows what this console has armed, or asks for."""
        pressed, self._pressed = self._pressed, False
        armings = [route.arming for route in snapshot.routes if route.arming is not None]
        if engine is not None and any(each.here or each.asked_by for each in armings):
            engine.keep_armed(pressed=pressed).add_done_callback(self._note)
        else:
            self.held = frozenset()

    def _note(self, kept: Future[Held]) -> None:
        """Note what this console holds. Called on any thread."""
        if not kept.cancelled() and kept.exception() is None:
            self.held = frozenset(kept.result().keys)
