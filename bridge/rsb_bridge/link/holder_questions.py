"""Asks the holder of an arming, on either side, whether another operator may hold it instead (PROTOCOL.md, 7.5)."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.arming import Disarmed, Question
from rsb_bridge.tasks import NOT_TOO_EARLY
from rsb_bridge.wire.messages import AskEnded, AskForArming

if TYPE_CHECKING:
    from collections.abc import Hashable

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import HolderMessage, HowAsked

_AT_ONCE, _A_SECOND = 5.0, 1 / 30
"""Questions of one link's peer that holders see: further ones would only disturb those who drive."""
ASKER_SILENT_AFTER: Final = 3.0
"""s without a sign of life after which the console that asks counts as gone: it gives one at least every 2 s."""
_LOOK_EVERY = 0.05
"""s between looks for the sign of life that the arming waits for. A round figure."""


class TakeOverText(Wording):
    """Reasons why an arming is not taken over."""

    KEPT = "{topic} stays with its holder ({who})"
    DISARMED = "{topic} is armed no longer ({reason}): arm it if it is still wanted"
    HELD_HERE = "this console has armed {topic} already"
    ASKED_ALREADY = "{topic} is asked for already ({who}): wait for the answer"
    ASKER_SILENT = "this console stood still while it asked for {topic}: ask again"
    NOT_YOURS = "{topic} was armed on another console, which answers for it"


class QuestionText(Wording):
    """Texts of the events of a question; each names an operator of either side first."""

    ASKED = "{asker} asks {holder} for it"
    KEPT = "{holder} keeps it, which {asker} asked for"
    GIVEN = "{holder} gives it to {asker}"
    UNANSWERED = "{asker} gets it, as {holder} has not answered within {seconds:g} s"
    WITHDRAWN = "{asker} asks {holder} for it no longer, or stood still"


_HOLDER_LEFT: Final = frozenset({Disarmed.DEADMAN, Disarmed.CONSOLE_GONE})
"""Ends of an arming that are as good as no answer of its holder."""
_EVENTS: Final = {
    "asked": (EventCode.OPERATOR_ASKED, QuestionText.ASKED),
    "kept": (EventCode.OPERATOR_KEPT, QuestionText.KEPT),
    "given": (EventCode.OPERATOR_GAVE, QuestionText.GIVEN),
    "unanswered": (EventCode.OPERATOR_UNANSWERED, QuestionText.UNANSWERED),
    "withdrawn": (EventCode.OPERATOR_WITHDREW, QuestionText.WITHDRAWN),
}
_BY_HOLDER: Final = frozenset({"kept", "given"})
_BY_ASKER: Final = frozenset({"unanswered", "withdrawn"})


@dataclass(slots=True)
class _Asker:
    """A console of this side that asks."""

    console: Hashable
    seen_at: float  # when it gave its last sign of life


class HolderQuestions:
    """Puts the questions of both sides' operators to the holders of a link's armings.

    Both sides record each question and how it ended. A peer's budget of questions bounds these events.
    """

    def __init__(self, link: BaseLink, peer_operators: PeerOperators) -> None:
        self._context = link.context
        self._link = link
        self._peer_operators = peer_operators
        self._budget = TokenBucket(_AT_ONCE, _A_SECOND, self._context.now())
        self._askers: list[_Asker] = []
        self._numbers = itertools.count(1)

    async def ask(self, route: Route, console: Hashable) -> None:
        """Ask a route's holder for a console; return once this console may arm the route, after a disarm if need be.

        A holder who does not answer within `ASKED_FOR` gives it, at the console's next sign of life.

        Raises:
            LinkError: the holder keeps it, or cannot be asked; the console is silent; or the arming ended meanwhile
                for another reason than the holder's absence.
        """
        arming, topic = route.arming, route.local_topic
        if not arming.held:
            return
        if arming.console == console:
            raise LinkError(TakeOverText.HELD_HERE(topic=topic))
        if (before := arming.question_at(self._context.now())) is not None:
            raise LinkError(TakeOverText.ASKED_ALREADY(who=before.who, topic=topic))
        holder = arming.by
        now, answer = self._context.now(), self._context.loop.create_future()
        question = Question(acting_operator(), next(self._numbers), now + ASKED_FOR, answer.set_result)
        asker = _Asker(console, now)
        self._begin(route, question)
        self._link.send(AskForArming(route.id, question.number, question.who))
        self._askers.append(asker)
        try:
            await self._answered(answer, asker, question.until)
        except asyncio.CancelledError:  # the console that asked is gone
            self._end(route, question, "withdrawn")
            raise
        finally:
            self._askers.remove(asker)
        # First: a console that stands still must not get it, even if the holder gives it.
        if self._context.now() - asker.seen_at >= ASKER_SILENT_AFTER:
            self._end(route, question, "withdrawn")
            raise LinkError(TakeOverText.ASKER_SILENT(topic=topic))
        if not answer.done():
            self._end(route, question, "unanswered")
        elif answer.result() is False:
            raise LinkError(TakeOverText.KEPT(who=holder, topic=topic))
        # A disarm that somebody wanted, or a fault, must last until an operator arms it again.
        elif answer.result() is None and arming.why not in _HOLDER_LEFT:
            raise LinkError(TakeOverText.DISARMED(topic=topic, reason=arming.reason))

    def seen(self, console: Hashable) -> None:
        """Note a sign of life of a console of this side."""
        for asker in self._askers:
            if asker.console == console:
                asker.seen_at = self._context.now()

    def answer(self, route: Route, console: Hashable, *, gives: bool, who: str = "") -> None:
        """Take the holder's answer to an operator, or to whoever asks if `who` is empty.

        Raises:
            LinkError: there is no question of that operator, or the console is not the holder's.
        """
        arming, topic = route.arming, route.local_topic
        question = arming.question_at(self._context.now())
        if question is None or who not in ("", question.who):
            raise LinkError(f"the question for {topic} is over")
        if arming.console != console:
            raise LinkError(TakeOverText.NOT_YOURS(topic=topic))
        self._end(route, question, "given" if gives else "kept")
        question.answered(gives)

    def handle(self, route: Route, message: HolderMessage) -> None:
        """Act on the peer's question, or on the end of one, about an open route."""
        arming, now = route.arming, self._context.now()
        question, is_here = arming.question, arming.console is not None
        match message:
            case AskForArming():
                if not arming.held:  # it has just been disarmed, as that side will hear
                    return
                if arming.question_at(now) is None and self._budget.take(1, now):
                    who = self._peer_operators.says(message.who)
                    # The asker's side counts from when it sent this to when it has the answer.
                    until = now + ASKED_FOR - (arming.lease.round_trip if arming.lease is not None else 0.0)
                    self._begin(route, Question(who, message.number, until, _ignored, from_peer=True))
                elif is_here:  # the side of the holder answers, and the other one only shows the question
                    self._link.send(AskEnded(route.id, message.number, "kept"))
            case AskEnded():
                if question is None or (question.from_peer, question.number) != (message.own, message.number):
                    return  # it has ended otherwise, or was not to be heard
                # The peer answers for holders of its own only: it must not give away an arming of this side.
                by_holder = message.how in _BY_HOLDER and not is_here
                if by_holder or (message.how in _BY_ASKER and message.own):
                    self._record(route, question, message.how)
                    arming.question = None
                    if by_holder:
                        question.answered(message.how == "given")

    async def _answered(self, answer: asyncio.Future[bool | None], asker: _Asker, until: float) -> None:
        """Wait for an answer, for a sign of life of the asker once the time is over, or until the asker is silent."""
        while not answer.done() and asker.seen_at < until:
            now = self._context.now()
            if now - asker.seen_at >= ASKER_SILENT_AFTER:
                return
            left = min(until, asker.seen_at + ASKER_SILENT_AFTER) - now
            await asyncio.wait((answer,), timeout=left + NOT_TOO_EARLY if left > 0 else _LOOK_EVERY)

    # --- records, and the other side

    def _begin(self, route: Route, question: Question) -> None:
        route.arming.question = question
        self._record(route, question, "asked")

    def _end(self, route: Route, question: Question, how: HowAsked) -> None:
        """End a question on both sides, as an operator of this side has it, if it is still open."""
        if route.arming.question is question:
            self._record(route, question, how)
            route.arming.question = None
            self._link.send(AskEnded(route.id, question.number, how, own=not question.from_peer))

    def _record(self, route: Route, question: Question, how: str) -> None:
        """Record a question's beginning or end; the other side's operators are its claims."""
        code, text = _EVENTS[how]
        holder, asker = route.arming.by, question.who
        by_holder = how in _BY_HOLDER
        route.log(
            Level.INFO,
            code,
            text(holder=holder, asker=asker, seconds=ASKED_FOR),
            who=holder if by_holder else asker,
            from_peer=route.arming.console is None if by_holder else question.from_peer,
        )


def _ignored(_: bool | None) -> None:
    """Ignore an answer that the asker's side hears of by itself."""
