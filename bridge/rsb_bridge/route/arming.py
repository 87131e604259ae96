"""The armed state of a topic that requires arming. In any doubt the topic is not armed.

Each side keeps this state by itself and never sends or publishes a message on the other side's word alone. An opening
of a route is armed at most once. Arming it again takes a new opening with another route id and other keys, so that no
message of an earlier arming can be published, wherever it waits (PROTOCOL.md, 7).
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.demands import NO_DEMAND, Demand
from rsb_bridge.model.snapshot import ArmingSnapshot
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.lease import SLOW
from rsb_bridge.wire.framing import LEASED
from rsb_bridge.wire.headers import with_number

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.model.by_hand import VelocityLimits
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.route.lease import LeaseHalf
    from rsb_bridge.wire.framing import Message

# In s.
ANSWERED_WITHIN = 5.0  # in which the other side has to agree (PROTOCOL.md, 7)
CONSOLE_SILENT_AFTER = 5.0  # without a sign of life of a console, which gives one every 2 s (`link.holder_questions`)
PEER_GRACE = 2.0  # beyond the deadman, if the other side armed it: keys are reported once a second
_QUESTION_LASTS = 2.0  # beyond its end, until a question counts for nothing: the other side has given up. Round


class Disarmed(StrEnum):
    """Reasons for a topic not being armed, also the cause of `EventCode.ROUTE_DISARMED`. Programs may rely on them.

    Attributes:
        text: the same in words.
    """

    text: str

    def __new__(cls, code: str, text: str = "") -> Disarmed:  # `Disarmed(code)` finds one
        member = str.__new__(cls, code)
        member._value_, member.text = code, text
        return member

    NOT_YET = "not_yet", "nobody has armed it"
    OPERATOR = "operator", "disarmed by an operator"
    DEADMAN = "deadman", "no key was pressed in time"
    # It was closed or killed, or has given no sign of life.
    CONSOLE_GONE = "console_gone", "the console that armed it is gone"
    LINK_LOST = "link_lost", "the link was lost"
    PAUSED = "paused", "it was paused"
    RELOADED = "reloaded", "the session file was read again"
    NO_ANSWER = "no_answer", "the other side has not agreed in time"
    # By the other side's operators: more often than people do.
    TOO_OFTEN = "too_often", "it was armed too often"
    REMOVED = "removed", "the topic is not bridged any more"
    EDITED = "edited", "the topic was edited"
    # This may be noticed before the end of the process at its other end.
    CHANNEL_LOST = "channel_lost", "its data connection ended"
    # Its type, its limits or its connection changed.
    REOPENED = "reopened", "the topic was reopened"
    LEASE = "lease", "a side or the link stood still"
    LINK_SLOW = "link_slow", f"the link is too slow: a round trip takes over {SLOW:g} s; use a faster link"


@dataclass(frozen=True, slots=True)
class Question:
    """The question to a holder whether another operator may hold the arming instead."""

    who: str  # asks, in words
    number: int  # among the questions of the asker's side
    until: float  # s, when it goes over without an answer
    answered: Callable[[bool | None], None]  # takes the answer, or None once the arming has ended otherwise
    from_peer: bool = False  # whether an operator of the other side asks


class ArmingPhase(Enum):
    """The phases of the one arming that an opening of a route may have."""

    FREE = auto()  # it may be armed
    ASKED = auto()  # an operator of this side has armed it; the other side has not agreed yet
    BEGINS = auto()  # both sides have agreed, and have not answered each other in time yet
    ARMED = auto()
    SPENT = auto()  # it has ended; the next one needs a new opening


class ArmingEvent(Enum):
    """Events in an arming."""

    OPEN = auto()  # the route has a new opening
    ASK = auto()  # an operator of this side arms it
    ARM_THERE = auto()  # an operator of the other side arms it
    AGREE = auto()  # the other side agrees in time
    LIVE = auto()  # the two sides hear each other, for the first time or again
    KEY = auto()  # its operator presses a key in time, on either side
    END = auto()  # it is disarmed, or refused


_ALWAYS = {ArmingEvent.OPEN: ArmingPhase.FREE, ArmingEvent.END: ArmingPhase.SPENT}

TRANSITIONS: dict[ArmingPhase, dict[ArmingEvent, ArmingPhase]] = {
    ArmingPhase.FREE: {ArmingEvent.ASK: ArmingPhase.ASKED, ArmingEvent.ARM_THERE: ArmingPhase.BEGINS, **_ALWAYS},
    ArmingPhase.ASKED: {ArmingEvent.AGREE: ArmingPhase.BEGINS, ArmingEvent.ARM_THERE: ArmingPhase.BEGINS, **_ALWAYS},
    ArmingPhase.BEGINS: {ArmingEvent.LIVE: ArmingPhase.ARMED, ArmingEvent.KEY: ArmingPhase.BEGINS, **_ALWAYS},
    ArmingPhase.ARMED: {ArmingEvent.LIVE: ArmingPhase.ARMED, ArmingEvent.KEY: ArmingPhase.ARMED, **_ALWAYS},
    ArmingPhase.SPENT: _ALWAYS,
}

# The phases in which an operator has armed it, and those in which both sides have agreed on that.
HELD = (ArmingPhase.ASKED, ArmingPhase.BEGINS, ArmingPhase.ARMED)
AGREED = (ArmingPhase.BEGINS, ArmingPhase.ARMED)

_CROSSING = {
    ArmingPhase.FREE: Crossing.DISARMED,
    ArmingPhase.ASKED: Crossing.ASKED,
    ArmingPhase.BEGINS: Crossing.BEGINS,
    ArmingPhase.SPENT: Crossing.DISARMED,
}
"""What crosses in the phases in which nothing does."""


class Arming:
    """The armed state of a route on one side."""

    def __init__(self) -> None:
        self.phase = ArmingPhase.FREE  # of the arming in the present opening
        self.required = False  # either side's session demands arming
        self.switched: Callable[[], None] = lambda: None  # called whenever `required` has changed
        self.deadman = 0.0  # s without a key after which it disarms, or 0 for no limit
        self.own: Demand = NO_DEMAND  # of this side's session
        self.peer_arm = False  # the other side's session demands arming
        self.peer_on_end = ""  # what that session wants when it ends, or empty if it does not say
        self.peer_limits: VelocityLimits | None = None  # of a hand in that session, or None for any velocity
        self.limits: VelocityLimits | None = None  # the smallest of both sessions, armed or not
        self.limited_by: tuple[str, ...] = ()  # the lines that have a number of `limits`, in words
        self.demanded_by: tuple[str, ...] = ()  # the lines that demand arming, in words
        self.why = Disarmed.NOT_YET
        self.reason = self.why.text
        self.lease: LeaseHalf | None = None  # of the link; None before the first opening, when nothing passes
        self.first = 0  # the lease's number when somebody armed it
        self.question: Question | None = None  # of another operator to the holder
        self._answered: Callable[[], None] | None = None
        self._clear()

    def _clear(self) -> None:
        # A command may wait for the other side: it ends, and reports that nothing is armed.
        self._answer()
        question, self.question = self.question, None
        if question is not None:
            question.answered(None)
        self.by = ""  # the operator who armed it, in words, or empty if it is not armed
        self.account = ""  # that operator's account on this side, or empty: nobody shares it
        self.console: Hashable | None = None  # that operator's on this side, or None if it was armed on the other side
        self.shared = False  # that operator's other consoles may publish by hand, too
        self._deadline = float("inf")
        self._seen_at = 0.0
        self._key_pressed = False

    # --- demands

    def demand(self, *, required: bool, deadman: float) -> None:
        """Add the demand of one side's session."""
        if not required:
            return
        if not self.required:
            self.required, self.deadman = True, deadman
            self.switched()
        else:
            self.deadman = min(filter(None, (self.deadman, deadman)), default=0.0)

    def opened(self, *, required: bool, deadman: float) -> None:
        """Begin a new opening, with the demand of its proposal in place of the demands before."""
        before, self.required, self.deadman = self.required, required, deadman
        if required != before:
            self.switched()
        self._handle(ArmingEvent.OPEN)
        self._clear()

    def follow(self, before: Arming) -> None:
        """Go on showing why the route is not armed in whose place this one's comes."""
        self.why, self.reason = before.why, before.reason

    # --- state

    def admits(self, event: ArmingEvent) -> bool:
        """Whether an event belongs into the present phase; another one changes nothing."""
        return event in TRANSITIONS[self.phase]

    def _handle(self, event: ArmingEvent) -> bool:
        """Move to the next phase; return whether the event belongs into this one."""
        if not self.admits(event):
            return False
        self.phase = TRANSITIONS[self.phase][event]
        return True

    @property
    def held(self) -> bool:
        """Whether an operator has armed it, even if the other side has not agreed yet."""
        return self.phase in HELD

    def crossing(self, now: float) -> Crossing:
        """Return whether messages may cross at `now` (s) as far as arming is concerned."""
        if not self.required:
            return Crossing.YES
        if self.phase is not ArmingPhase.ARMED:
            return _CROSSING[self.phase]
        if now >= self._deadline or self.lease is None:
            return Crossing.DISARMED
        return Crossing.YES if self.lease.alive else Crossing.UNHEARD

    def has_run_out(self, now: float) -> bool:
        """Whether it is armed, and its deadman has run out at `now` (s)."""
        return self.phase is ArmingPhase.ARMED and now >= self._deadline

    def why_at(self, now: float) -> tuple[Disarmed, str]:
        """Return the reason why it is not armed at `now` (s), also in words."""
        overdue = self.overdue(now)
        return (self.why, self.reason) if overdue is None else (overdue, overdue.text)

    @property
    def newest_number(self) -> int:
        """The lease's number for a message that an operator makes now."""
        return self.lease.newest_before(float("inf")) if self.lease is not None else 0

    def pack(self, message: Message, number: int) -> Message:
        """Return a message as it is sent, with the lease's number before it."""
        if not self.required:
            return message
        content, stamp, flags = message
        return with_number(number, content), stamp, flags | LEASED

    def question_at(self, now: float) -> Question | None:
        """Return the question that the holder has not answered yet at `now` (s), or None."""
        is_open = self.question is not None and now < self.question.until + _QUESTION_LASTS
        return self.question if is_open else None

    def snapshot(self, now: float, on_end: str = "", velocity: tuple[float, float] | None = None) -> ArmingSnapshot:
        """Return the state for user interfaces at `now` (s), of a topic that requires arming.

        Args:
            velocity: that the receiving side has published last.
        """
        armed, here = self.crossing(now).flows, self.console is not None
        why, reason = ("", "") if armed else self.why_at(now)
        grace = 0.0 if here else PEER_GRACE  # the other side's operator has that much less time
        left = max(0.0, self._deadline - grace - now) if armed and self.deadman else None
        question = self.question_at(now) if armed else None
        return ArmingSnapshot(
            armed,
            self.by if armed else "",
            here,
            left,
            self.deadman,
            self.demanded_by,
            why,
            reason,
            on_end,
            velocity,
            asked_by="" if question is None else question.who,
            goes_in=None if question is None else max(0.0, question.until - now),
        )

    # --- arming

    def ask(
        self,
        by: str,
        console: Hashable,
        now: float,
        answered: Callable[[], None],
        *,
        account: str = "",
        shared: bool = False,
    ) -> None:
        """Arm it for an operator of this side; nothing crosses before the other side agrees.

        Args:
            by: the operator, in words.
            answered: called once messages may cross, or it is clear that they will not.
            account: the operator's (`rsb_bridge.model.commands.Operator`).
            shared: whether that operator's other consoles may publish by hand, too.
        """
        if not self._hold(ArmingEvent.ASK, by, console):
            answered()
            return
        self.account, self.shared = account, shared
        self._answered = answered
        self._seen_at, self._deadline = now, now + ANSWERED_WITHIN

    def agreed(self, now: float) -> bool:
        """Take the other side's agreement at `now` (s). Return whether this side had asked."""
        # An agreement that comes too late arms nothing, even before the tick that gives it up.
        if now >= self._deadline or not self._handle(ArmingEvent.AGREE):
            return False
        self._begin_deadman(now, 0.0)
        return True

    def lives(self) -> bool:
        """Let messages cross, as the two sides hear each other; return whether both have agreed on that."""
        # Not before: a goal could overtake what shows the other side that it is heard, and be refused.
        if not self._handle(ArmingEvent.LIVE):
            return False
        self._answer()
        return True

    def arm_for_peer(self, by: str, now: float) -> None:
        if self._hold(ArmingEvent.ARM_THERE, by, None):
            # This side's operator may have asked at the same moment: that command ends, and names the other operator.
            self._answer()
            self._begin_deadman(now, PEER_GRACE)

    def pressed_there(self, by: str, now: float) -> None:
        """Note that the operator of the other side who has armed it has pressed a key at `now` (s)."""
        # A key after the deadline revives nothing, even before the tick that disarms.
        if self.console is None and now < self._deadline and self._handle(ArmingEvent.KEY):
            self.by = by
            self._begin_deadman(now, PEER_GRACE)

    def end(self, why: Disarmed, reason: str = "") -> None:
        """Disarm this opening for good; `reason` replaces the usual text of `why`."""
        self.why, self.reason = why, reason or why.text
        self._handle(ArmingEvent.END)
        self._clear()

    def _hold(self, event: ArmingEvent, by: str, console: Hashable | None) -> bool:
        was_held = self.held
        if not self._handle(event):
            return False
        if not was_held:
            self.first = self.lease.number if self.lease is not None else 0
        self.by, self.console = by, console
        return True

    def _answer(self) -> None:
        answered, self._answered = self._answered, None
        if answered is not None:
            answered()

    def _begin_deadman(self, now: float, grace: float) -> None:
        self._deadline = now + self.deadman + grace if self.deadman else float("inf")

    # --- the console

    def is_held_by(self, console: Hashable, account: str) -> bool:
        """Whether messages by hand of a console and its operator's account pass: one person drives at a time."""
        if self.console is None:
            return False
        return console == self.console or (self.shared and bool(account) and account == self.account)

    def seen(self, console: Hashable, now: float, *, pressed: bool) -> None:
        """Note a console's sign of life at `now` (s); `pressed` means that its operator pressed a key."""
        if self.console is None or console != self.console:
            return
        self._seen_at = now
        if pressed and now < self._deadline and self._handle(ArmingEvent.KEY):
            self._begin_deadman(now, 0.0)
            self._key_pressed = True

    def take_press(self) -> bool:
        """Whether a key was pressed here since the last call, to be reported to the other side."""
        pressed, self._key_pressed = self._key_pressed, False
        return pressed

    @property
    def due_at(self) -> float:
        """Time (s) from which on it is overdue, or infinite if it is not held or nothing limits it."""
        if not self.held:
            return float("inf")
        return min(self._deadline, float("inf") if self.console is None else self._seen_at + CONSOLE_SILENT_AFTER)

    def overdue(self, now: float) -> Disarmed | None:
        """Return the reason to disarm it at `now` (s), or None."""
        if now < self.due_at:
            return None
        if now < self._deadline:
            return Disarmed.CONSOLE_GONE
        return Disarmed.NO_ANSWER if self.phase is ArmingPhase.ASKED else Disarmed.DEADMAN


def without_history(qos: Qos) -> Qos:
    """Return a QoS without history for late joiners: a command from before the arming must not reach anybody."""
    return msgspec.structs.replace(qos, durability="volatile") if qos.latched else qos


class Settling:
    """The moment between a disarm and its effect on the other side; it outlives the opening that was disarmed.

    A sending half stops at once, but the other side may still publish earlier messages. That ends when the other side
    answers that it has disarmed, too, and at the latest when the lease of the last message has run out.

    Args:
        changed: called when it begins and ends.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, changed: Callable[[], None]) -> None:
        self._loop = loop
        self._changed = changed
        self._route_id = 0
        self._timer: asyncio.TimerHandle | None = None
        self._then: list[Callable[[], None]] = []

    @property
    def under_way(self) -> bool:
        """Whether messages already sent may still be published."""
        return self._timer is not None

    def begin(self, route_id: int, seconds: float) -> None:
        # The lease of the last message has run out already.
        if seconds <= 0:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._route_id = route_id
        self._timer = self._loop.call_later(seconds, self._end)
        self._changed()

    def answered(self, route_id: int) -> None:
        """Note that the other side publishes nothing more of an opening."""
        if self._timer is not None and route_id == self._route_id:
            self._timer.cancel()
            self._end()

    def then(self, work: Callable[[], None]) -> None:
        """Do something once nothing can be published any more, which may be now."""
        if self._timer is None:
            work()
        else:
            self._then.append(work)

    async def wait(self) -> None:
        """Return once nothing can be published any more."""
        if self._timer is not None:
            over = asyncio.Event()
            self._then.append(over.set)
            await over.wait()

    def _end(self) -> None:
        self._timer = None
        then, self._then = self._then, []
        self._changed()
        for work in then:
            work()
