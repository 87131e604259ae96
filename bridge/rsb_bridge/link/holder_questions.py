"""Asks the holder of an arming, on either side, whether another operator may hold it instead (PROTOCOL.md, 7.5)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.arming import Question
from rsb_bridge.wire.messages import AskForArming, HolderSays

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.context import Context
    from rsb_bridge.link.peer_operators import PeerOperators
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import HolderMessage

_AT_ONCE, _A_SECOND = 5.0, 1 / 30
"""Questions of one link's peer that holders see: further ones would only disturb those who drive."""


class TakeOverText(Wording):
    """Reasons why an arming is not taken over."""

    KEPT = "{topic} stays with its holder ({who})"
    HELD_HERE = "this console has armed {topic} already"
    ASKED_ALREADY = "{topic} is asked for already ({who}): wait for the answer"
    NOT_ASKED = "nobody asks for {topic} any more"
    NOT_YOURS = "{topic} was armed on another console, which answers for it"


class HolderQuestions:
    """Puts the questions of both sides' operators to the holders of a link's armings.

    Args:
        peer_operators: names the other side's operators.
    """

    def __init__(self, context: Context, peer: Peer, peer_operators: PeerOperators) -> None:
        self._context = context
        self._peer = peer
        self._peer_operators = peer_operators
        self._budget = TokenBucket(_AT_ONCE, _A_SECOND, context.now())

    async def ask(self, route: Route, console: Hashable) -> None:
        """Ask a route's holder for a console; return once this console may arm the route, after a disarm if need be.

        A holder who does not answer within `ASKED_FOR` gives it.

        Raises:
            LinkError: the holder keeps it, or cannot be asked.
        """
        arming, topic = route.arming, route.local_topic
        if not arming.held:
            return
        if arming.console == console:
            raise LinkError(TakeOverText.HELD_HERE(topic=topic))
        if (before := arming.question_at(self._context.now())) is not None:
            raise LinkError(TakeOverText.ASKED_ALREADY(who=before.who, topic=topic))
        holder, is_there = arming.by, arming.console is None
        route_id, who = route.id, acting_operator()
        answer: asyncio.Future[bool | None] = self._context.loop.create_future()
        arming.question = question = Question(who, self._context.now() + ASKED_FOR, _once(answer))
        if is_there:
            self._peer.send(AskForArming(route_id, who))
        try:
            async with asyncio.timeout(ASKED_FOR):
                gives = await answer
        except TimeoutError:
            return
        except asyncio.CancelledError:
            if is_there and arming.question is question:
                self._peer.send(AskForArming(route_id, who, withdrawn=True))
            raise
        finally:
            if arming.question is question:
                arming.question = None
        if gives is False:
            raise LinkError(TakeOverText.KEPT(who=holder, topic=topic))

    def answer(self, route: Route, console: Hashable, *, gives: bool) -> None:
        """Take the holder's answer.

        Raises:
            LinkError: there is no question, or the console is not the holder's.
        """
        arming, topic = route.arming, route.local_topic
        question = arming.question_at(self._context.now())
        if question is None:
            raise LinkError(TakeOverText.NOT_ASKED(topic=topic))
        if arming.console != console:
            raise LinkError(TakeOverText.NOT_YOURS(topic=topic))
        arming.question = None
        question.answered(gives)

    def handle(self, route: Route, message: HolderMessage) -> None:
        """Act on the peer's question or answer about an open route."""
        arming, now = route.arming, self._context.now()
        match message:
            case HolderSays():
                if arming.question is not None and arming.console is None:
                    arming.question.answered(message.gives)
            case AskForArming(withdrawn=True):
                if arming.question is not None and arming.question.from_peer:
                    arming.question = None
            case AskForArming():
                if not arming.held or arming.console is None:
                    return  # it has just been disarmed, as that side will hear
                if arming.question_at(now) is not None or not self._budget.take(1, now):
                    self._peer.send(HolderSays(route.id, gives=False))
                    return
                route_id, who = route.id, self._peer_operators.says(message.who)

                def answered(gives: bool | None) -> None:
                    if gives is not None:
                        self._peer.send(HolderSays(route_id, gives=gives))

                arming.question = Question(who, now + ASKED_FOR, answered, from_peer=True)


def _once(answer: asyncio.Future[bool | None]) -> Callable[[bool | None], None]:
    def take(gives: bool | None) -> None:
        if not answer.done():
            answer.set_result(gives)

    return take
