"""Changes of topics and calls, each a command to the engine, and how to undo them."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.api import EngineError
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.actions.action import FooterEntry
from rsb_console.notation.formats import PatternRow
from rsb_console.screens.dialog import ConfirmScreen, UndoScreen, is_meant
from rsb_console.session.changes import (
    Added,
    CannotUndoError,
    Edited,
    Paused,
    Removed,
    find_entry,
    named_by_client,
    patterns_of,
    present,
)

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Topic
    from rsb_console.console_api import Console
    from rsb_console.notation.formats import Row
    from rsb_console.screens.main import MainScreen
    from rsb_console.screens.topic_form import TopicDraft


class OperationText(Wording):
    """Questions and notes about changes of topics."""

    NO_CLIENT = "this server has no client yet: add one first, with a in the links (c)"
    NOTHING_TO_UNDO = "nothing to undo: nothing was changed on this console"
    NOTHING_MORE_TO_UNDO = "nothing more to undo"
    RESUME = "Resume {topic}?"
    RESUME_MEANS = "The key may have come late, so it is asked for. Messages cross again at once{arming}."
    IS_ALREADY = "{topic} was paused or resumed meanwhile: look, and press the key again"
    AFTER_ALL = "{topic}: done after its form was left (u undoes it)"


_WITHOUT_DEMAND = (
    "It is removed either way. Without the demand, an entry of this name that comes later crosses without being armed."
)


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


async def pause(screen: MainScreen) -> None:
    """Pause the topic under the cursor, or resume it, after a question if the key may have come late."""
    console = screen.console
    engine, route = console.engine, screen.topics.selected
    if engine is None or route is None:
        return
    paused = route.state is not State.PAUSED
    if (present(route, console.snapshot()).state is not State.PAUSED) is not paused:
        console.notify(OperationText.IS_ALREADY(topic=route.topic), severity="warning", markup=False)
        return
    # Only resuming can move something: a key that a hung terminal delivers late may pause.
    if not paused and not await _resumes(screen, route):
        return
    mixed = isinstance(route, PatternRow) and any(
        each.spec.paused is paused
        for each in console.snapshot().routes
        if each.pattern == route.spec.topic
        and (each.link, each.spec.kind, each.spec.direction) == (route.link, route.spec.kind, route.spec.direction)
    )
    change = Paused(route.link, route.topic, _last_event(engine), key=route.key, paused=paused, mixed=mixed)
    if await console.command(engine.pause(route.key, paused)) and route.spec.paused is not paused:
        console.changes.add(change)


async def _resumes(screen: MainScreen, route: Row) -> bool:
    """Whether the operator resumes a topic, after a question if the key may have come late."""
    arming = "" if route.arming is None else ", once it is armed"
    title, means = OperationText.RESUME(topic=route.topic), OperationText.RESUME_MEANS(arming=arming)
    return await is_meant(screen.console, screen.app, title, means, "Resume")


async def acknowledge(screen: MainScreen) -> None:
    """Acknowledge the fault of the topic under the cursor, or take that back."""
    console = screen.console
    engine, route = console.engine, screen.topics.selected
    if engine is not None and route is not None:
        seen = None if isinstance(route, PatternRow) else (route.state, route.cause)
        await console.command(engine.acknowledge(route.key, route.acknowledged is None, seen=seen))


async def call(screen: MainScreen) -> None:
    """Call what is under the cursor by hand."""
    from rsb_console.screens.call_screen import CallScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    engine, route = console.engine, screen.topics.route
    if engine is not None and route is not None and route.lanes:
        await console.ask(CallScreen(console, route))


async def add_topic(screen: MainScreen) -> None:
    from rsb_console.screens.topic_form import TopicScreen  # noqa: PLC0415 -- keeps the start short

    console, engine = screen.console, screen.console.engine
    if engine is None:
        return
    if not engine.snapshot().links:
        console.notify(OperationText.NO_CLIENT(), severity="warning", markup=False, timeout=8)
        return

    key = ""

    async def act(draft: TopicDraft) -> None:
        nonlocal key
        now, since = engine.snapshot(), _last_event(engine)
        key = await asyncio.wrap_future(engine.add_topic(draft.topic, draft.link))
        link = draft.link or now.links[0].name
        spec = named_by_client(draft.topic, now, link)
        console.changes.add(Added(link, _name_here(engine, key, draft.topic.topic), since, key=key, spec=spec))

    async def add(draft: TopicDraft) -> None:
        await _to_the_end(console, act(draft), draft.topic.topic)

    draft = await console.ask(TopicScreen(engine, add))
    if draft is not None:
        console.notify(f"{draft.topic.topic}: added", markup=False, timeout=3)
        console.pull()
        screen.topics.select(key)


async def edit_topic(screen: MainScreen) -> None:
    from rsb_console.screens.topic_form import TopicScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    engine, route = console.engine, screen.topics.selected
    if route is None or engine is None:
        return
    route = present(route, console.snapshot())

    async def act(new: Topic, *, drops: bool) -> None:
        now, since = engine.snapshot(), _last_event(engine)
        key = await asyncio.wrap_future(engine.edit_topic(route.key, new, drop_arm=drops, seen=route.spec))
        if new.topic != route.spec.topic and not new.is_pattern:
            new = named_by_client(new, now, route.link)
        name = _name_here(engine, key, route.topic)
        console.changes.add(Edited(route.link, name, since, key=key, old=route.spec, new=new, pattern=route.pattern))

    async def edit(draft: TopicDraft) -> None:
        old, new = route.spec, draft.topic
        if new == old:
            return
        drops = old.arm and not new.arm
        if drops and not await console.ask(ConfirmScreen(*_dropping(route), "Drop", Effect.MOVES)):
            raise EngineError("not changed: it still has to be armed")
        if old.paused and not new.paused and not drops and not await _resumes(screen, route):
            raise EngineError("not changed: it stays paused")
        await _to_the_end(console, act(new, drops=drops), route.topic)

    if await console.ask(TopicScreen(engine, edit, route)) is not None:
        console.pull()


async def _to_the_end(console: Console, act: Coroutine[Any, Any, None], topic: str) -> None:
    """Do what a form has begun, even if the form is left meanwhile: then tell how it ended."""
    going = asyncio.ensure_future(act)
    try:
        await asyncio.shield(going)
    except asyncio.CancelledError:
        going.add_done_callback(partial(_tell_end, console, topic))
        raise


def _tell_end(console: Console, topic: str, going: asyncio.Future[None]) -> None:
    if going.cancelled():
        return
    if (error := going.exception()) is not None:
        console.notify(str(error), title="Not done", severity="error", markup=False, timeout=10)
    else:
        console.notify(OperationText.AFTER_ALL(topic=topic), markup=False, timeout=10)
        console.pull()


async def remove_topic(screen: MainScreen) -> None:
    """Remove the topic under the cursor, after a question."""
    console = screen.console
    engine, route = console.engine, screen.topics.selected
    if route is None or engine is None:
        return
    message = f"{_removal(route)}, on both sides of the link with {console.peer_of(route)}."
    entry = engine.session.entry(route.link, route.spec.identity)
    has_demand = entry is not None and entry.arm and not (route.arming is not None and route.arming.is_demanded_twice)
    if route.arming is not None and not has_demand:
        message += " Its name still has to be armed (armed in the session)."
    if route.pattern:
        message += f" {route.pattern} leaves it out from then on (except)."
    question = ConfirmScreen(f"Remove {route.topic}?", message, "Remove", Effect.LOSES)
    if not await console.ask(question):
        return
    drops = False
    if has_demand:
        title = f"Drop the demand to arm {route.topic}, too?"
        drops = await console.ask(ConfirmScreen(title, _WITHOUT_DEMAND, "Drop", Effect.MOVES)) is True
    now, since = console.snapshot(), _last_event(engine)
    patterns = tuple((row.key, row.spec) for row in patterns_of(now, route.link, route.spec))
    route = find_entry(now, route.key) or route  # as it was when the operator agreed
    change = Removed(
        route.link, route.topic, since, key=route.key, spec=route.spec, pattern=route.pattern, patterns=patterns
    )
    if await console.command(engine.remove_topic(route.key, drop_arm=drops)):
        console.changes.add(change)


async def undo(screen: MainScreen) -> None:
    """Undo the last change of this console, after a question that shows the effect."""
    console, engine, changes = screen.console, screen.console.engine, screen.console.changes
    change = changes.last
    # A second u while the question is open would ask about the same change again.
    if engine is None or changes.is_undoing:
        return
    if change is None:
        nothing = OperationText.NOTHING_MORE_TO_UNDO if changes.dropped else OperationText.NOTHING_TO_UNDO
        console.notify(nothing(), timeout=4)
        return
    changes.is_undoing = True
    try:
        agreed: tuple[str, ...] | None = None
        # Again if it would do something else by then.
        while (step := change.undo(console.snapshot(), engine.events())).lines != agreed:
            agreed = step.lines
            if not await console.ask(UndoScreen(step)):
                return
        await step.act(engine)
    except CannotUndoError as problem:
        changes.drop(change)
        console.notify(str(problem), title="Not undone", severity="warning", markup=False, timeout=15)
    except EngineError as error:
        console.notify(str(error), title="Not undone", severity="error", markup=False, timeout=15)
    else:
        changes.drop(change)
        console.pull()
    finally:
        changes.is_undoing = False


def has_calls(screen: MainScreen) -> bool:
    """Whether what is under the cursor can be called."""
    return screen.topics.route is not None and bool(screen.topics.route.lanes)


def undo_in_footer(screen: MainScreen) -> FooterEntry | None:
    return FooterEntry("undo") if len(screen.console.changes) else None
