"""The units of this side: their states, and one action at a time on them."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from math import inf
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakSet

from rsb_bridge.feature_api import Level, Wording, armed_of_nodes, in_thread, one_line, sanitize_text
from rsb_extras.units import MAY_ASK, UNITS
from rsb_extras.units.unit_process import CommandEnd, run_words, state_of
from rsb_extras.units.unit_records import ACTIONS, MOST_UNITS, UnitOutcome, UnitRecord, UnitState, UnitText

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import Asker, Context, Link
    from rsb_extras.units import ListedUnit
    from rsb_extras.units.unit_records import UnitAction

EVERY = 5.0
"""s between two looks at a unit's state, and only while somebody asks for it. A round figure."""
STARTS, STARTS_WITHIN = 6, 60.0
"""The most actions of the other sides together in so many s, and as many of this side's operators."""
_STATUS_WITHIN, _LOG_WITHIN = 5.0, 5.0  # s for the command. Round figures
_KNOWN_WITHIN = 2.0
"""s that one who asks waits for states that are being found; then those that are known are the answer."""
_POLL_EVERY = 0.5  # s between two looks whether the new state is reached
_ENDS_WITHIN = 5.0
"""s that the end of the bridge waits for a command: what ends by no signal is left alone before that."""
_REACHED = {"start": (UnitState.RUNNING,), "restart": (UnitState.RUNNING,), "stop": (UnitState.STOPPED,)}


class UnitCode(StrEnum):
    """Codes of the events that units log; they stay as they are, for programs that read the log."""

    BEGAN = "units.began"
    ENDED = "units.ended"
    FAILED = "units.failed"
    REFUSED = "units.refused"


class UnitProblem(Wording):
    """The reason why an action is refused or failed."""

    NO_UNIT = "{owner} lists no unit {name}: see rsb-console units"
    NO_ACTION = "unit {name} has no {action}: it has {actions}"
    BUSY = "a unit is being changed there already: wait until that is over"
    TOO_OFTEN = "units were changed {most} times within {seconds:g} s: wait"
    ARMED = "{what} is armed, and {nodes}: disarm it first, or ask an operator of that side"
    HEARS = "a node of unit {name} takes it"
    NO_NODES = "unit {name} lists no nodes, so that it may be concerned"
    STOPS = "the bridge stops"
    ENDED = "an operator of its side ended it, for another action"
    NOT_RUN = "its program cannot be run: {problem}; the log of its side names it"
    LATE = "it took longer than {seconds:g} s, and was ended"
    CODE = "{action} ended with {code}"
    NOT_REACHED = "{action} is done, but the unit is {state} after {seconds:.0f} s"


class _Found(NamedTuple):
    unit: ListedUnit
    state: UnitState
    at: float


@dataclass(slots=True, eq=False)
class _Doing:
    """The action that is under way.

    Attributes:
        stop: ends its commands.
        outcome: of its task, as soon as that is made.
    """

    name: str
    action: UnitAction
    asker: Asker
    stop: threading.Event = field(default_factory=threading.Event)
    outcome: asyncio.Task[UnitOutcome] | None = None


class UnitRunner:
    """Finds the states of this side's units, and carries out actions, for its operators and for other sides.

    Attributes:
        links: of the engine; what is armed on any of them counts.
    """

    def __init__(self, context: Context) -> None:
        self.links: WeakSet[Link] = WeakSet()
        self._context = context
        self._found: dict[str, _Found] = {}
        self._looking: asyncio.Task[None] | None = None
        self._doing: _Doing | None = None
        self._starts: dict[bool, deque[float]] = {is_own: deque(maxlen=STARTS) for is_own in (False, True)}
        self._stop = threading.Event()

    @property
    def _units(self) -> dict[str, ListedUnit]:
        return UNITS.of(self._context.session)

    # --- states

    async def records(self, asker: Asker) -> tuple[UnitRecord, ...]:
        """Return the units with their states, which are a few seconds old at most if their commands answer."""
        if (self._looking is None or self._looking.done()) and any(map(self._is_due, self._units.items())):
            self._looking = self._context.loop.create_task(self._look())
        if self._looking is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_KNOWN_WITHIN):
                    await asyncio.shield(self._looking)
        return tuple(self._record(name, unit, asker) for name, unit in self._units.items())[:MOST_UNITS]

    def _record(self, name: str, unit: ListedUnit, asker: Asker) -> UnitRecord:
        found = self._found.get(name)
        known = found is not None and found.unit == unit
        return UnitRecord(
            name,
            tuple(each for each in ACTIONS if getattr(unit, each)),
            _may(asker, name),
            found.state if found is not None and known else UnitState.UNKNOWN,
            self._context.now() - found.at if found is not None and known else None,
            self._doing.action if self._doing is not None and self._doing.name == name else None,
        )

    def _is_due(self, item: tuple[str, ListedUnit]) -> bool:
        name, unit = item
        found = self._found.get(name)
        is_new = found is None or found.unit != unit or self._context.now() - found.at >= EVERY
        return bool(unit.status) and is_new

    async def _look(self) -> None:
        """Find the states that are due, one after the other: a machine has other things to do."""
        self._found = {name: found for name, found in self._found.items() if name in self._units}
        for name, unit in self._units.items():
            if self._is_due((name, unit)) and not self._stop.is_set():
                await self._find(name, unit, self._stop)

    async def _find(self, name: str, unit: ListedUnit, stop: threading.Event) -> UnitState:
        state = state_of(await self._execute(unit.status, _STATUS_WITHIN, stop))
        self._found[name] = _Found(unit, state, self._context.now())
        return state

    # --- actions

    async def run(self, name: str, action: UnitAction, asker: Asker) -> UnitOutcome:
        """Carry out an action, or refuse it. It goes on if nobody waits for it any more.

        An operator of this side does not wait for a peer's action, but ends it.
        """
        what = f"unit {name}: {action}"
        while not (refusal := self._refusal(name, action, asker)) and (peers := self._doing) is not None:
            assert peers.outcome is not None
            peers.stop.set()
            await asyncio.wait((peers.outcome,))
        if refusal:
            asker.log(self._context, Level.WARNING, UnitCode.REFUSED, f"{what} refused: {refusal}")
            return UnitOutcome(refused=True, reason=sanitize_text(refusal))
        self._starts[asker.link is None].append(self._context.now())
        asker.log(self._context, Level.INFO, UnitCode.BEGAN, what)
        self._doing = doing = _Doing(name, action, asker)
        doing.outcome = self._context.loop.create_task(self._carry_out(doing, self._units[name]))
        return await asyncio.shield(doing.outcome)

    def _refusal(self, name: str, action: UnitAction, asker: Asker) -> str:
        unit, now = self._units.get(name), self._context.now()
        if not _may(asker, name):
            assert asker.link is not None
            return str(asker.link.end.rights.lacks(f"{action} unit {name}", MAY_ASK.entry(f"[{name}]")))
        if unit is None:
            return UnitProblem.NO_UNIT(owner=f"the session of {self._context.session.name}", name=name)
        if not getattr(unit, action):
            actions = ", ".join(each for each in ACTIONS if getattr(unit, each)) or "no actions"
            return UnitProblem.NO_ACTION(name=name, action=action, actions=actions)
        if self._stop.is_set():
            return UnitProblem.STOPS()
        if self._doing is not None and (asker.link is not None or self._doing.asker.link is None):
            return UnitProblem.BUSY()
        if sum(now - each < STARTS_WITHIN for each in self._starts[asker.link is None]) >= STARTS:
            return UnitProblem.TOO_OFTEN(most=STARTS, seconds=STARTS_WITHIN)
        # The robot's own operator knows what is driven there, and may have no other way to stop it.
        return "" if asker.link is None else self._armed(name, unit, asker.link)

    def _armed(self, name: str, unit: ListedUnit, asker: Link) -> str:
        """Return what is armed and may be of a unit's nodes, in words, or an empty string."""
        if not (what := armed_of_nodes(self.links, unit.nodes, self._context.ros, asker)):
            return ""
        nodes = (UnitProblem.HEARS if unit.nodes else UnitProblem.NO_NODES)(name=name)
        return UnitProblem.ARMED(what=what, nodes=nodes)

    async def _carry_out(self, doing: _Doing, unit: ListedUnit) -> UnitOutcome:
        began, words = self._context.now(), getattr(unit, doing.action)
        try:
            ended = await self._execute(words, unit.timeout, doing.stop)
            outcome = await self._outcome(doing, unit, ended, began)
        finally:
            self._doing = None
        level, code = (Level.INFO, UnitCode.ENDED) if outcome.done else (Level.WARNING, UnitCode.FAILED)
        # Only this side's log has the program's name: the outcome crosses.
        named = f" ({one_line(words[0])})" if ended.problem else ""
        text = f"unit {doing.name}: {doing.action}: {UnitText.of(doing.action, outcome)}{named}"
        doing.asker.log(self._context, level, code, text)
        return outcome

    async def _outcome(self, doing: _Doing, unit: ListedUnit, ended: CommandEnd, began: float) -> UnitOutcome:
        action, state, reason = doing.action, UnitState.UNKNOWN, self._failure(ended, doing, unit)
        if not reason and unit.status:
            state = await self._reached(doing, unit, began + unit.timeout)
            if state not in _REACHED[action]:
                seconds = self._context.now() - began
                reason = self._stopped(doing)
                reason = reason or UnitProblem.NOT_REACHED(action=action, state=state, seconds=seconds)
        seconds = self._context.now() - began
        has_log = reason and unit.log and not doing.stop.is_set()
        log = await self._execute(unit.log, _LOG_WITHIN, doing.stop) if has_log else CommandEnd()
        return UnitOutcome(False, sanitize_text(reason), seconds, state, ended.lines, log.lines)

    async def _reached(self, doing: _Doing, unit: ListedUnit, deadline: float) -> UnitState:
        """Return the state after an action, once it is the right one, a failure, or the time is over."""
        while True:
            state = await self._find(doing.name, unit, doing.stop)
            left = deadline - self._context.now()
            if state in (*_REACHED[doing.action], UnitState.FAILED) or left <= 0 or doing.stop.is_set():
                return state
            await asyncio.sleep(min(_POLL_EVERY, left))

    def _stopped(self, doing: _Doing) -> str:
        """Return why an action had to end before its time, or an empty string."""
        if self._stop.is_set():
            return UnitProblem.STOPS()
        return UnitProblem.ENDED() if doing.stop.is_set() else ""

    def _failure(self, ended: CommandEnd, doing: _Doing, unit: ListedUnit) -> str:
        """Return why a command is not done, or an empty string."""
        if ended.problem:
            return UnitProblem.NOT_RUN(problem=ended.problem)
        if reason := self._stopped(doing):
            return reason
        if ended.was_late:
            return UnitProblem.LATE(seconds=unit.timeout)
        if ended.code:
            code = f"exit code {ended.code}" if ended.code > 0 else f"signal {-ended.code}"
            return UnitProblem.CODE(action=doing.action, code=code)
        return ""

    async def _execute(self, words: Sequence[str], seconds: float, stop: threading.Event) -> CommandEnd:
        return await in_thread("unit", partial(run_words, words, seconds, self._context.clock, stop), inf)

    async def close(self) -> None:
        """End what runs."""
        self._stop.set()
        running = None
        if self._doing is not None:
            self._doing.stop.set()
            running = self._doing.outcome
        tasks = [each for each in (running, self._looking) if each is not None and not each.done()]
        if tasks:
            await asyncio.wait(tasks, timeout=_ENDS_WITHIN)


def _may(asker: Asker, name: str) -> bool:
    return asker.link is None or name in MAY_ASK.of(asker.link.end.rights)
