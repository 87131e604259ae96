"""Orders over a link: an operator has the other side carry out something, once, over any number of connections.

An order needs a ticket. The giver asks for it just before, and it counts for some seconds and for one order: given
again by the same ticket, in the next association, the order begins nothing, and the answer is the end of the first one.
So nothing is carried out twice, and nothing after it has waited for a lost link.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import msgspec

from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.questions import Questions
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.commands import operator
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.order_messages import (
    TICKET_WITHIN,
    OrderAnswer,
    OrderBase,
    OrderEnd,
    OrderQuestion,
)
from rsb_bridge.wire.records import OrderOutcome

if TYPE_CHECKING:
    from collections.abc import Coroutine
    from enum import StrEnum

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.snapshot import Level

TICKET_LIFE = 5.0
"""s that a ticket counts. A round figure: a link that takes longer for two messages is too slow for such requests."""
_MOST_TICKETS = 4
"""Tickets that a peer may have at a time: one for each operator who asks just now."""
ASKED, ASKED_WITHIN = 12, 60.0
"""Orders of a peer that are judged at once, and then in so many s, refused ones too: each is logged. Round figures."""
_REMEMBERED = 8
"""Orders of a peer whose ends are remembered for its next association."""


AnswerT = TypeVar("AnswerT", bound=OrderAnswer)
OrderT = TypeVar("OrderT", bound=OrderBase)
OutcomeT = TypeVar("OutcomeT", bound=OrderOutcome)


class OrderProblem(Wording):
    AWAY = "not linked: {reason}"
    NOT_THERE = "the other side's installation has no {feature}: install all of rsb-console there"
    SILENT = "{link} did not answer: look at the state there before you ask again"
    TWICE = "{link} gave the same ticket twice, and nothing was done: ask again in some seconds"
    TOO_LATE = "the request came too late, and nothing was done: ask again"
    FORGOTTEN = "the bridge there knows nothing of it any more: look at the state there before you ask again"
    TOO_OFTEN = "too many requests came: one more is taken each {seconds:g} s"


class Asker(NamedTuple):
    """The one who asks, or gives an order.

    Attributes:
        who: an operator, in words; one of the other side is that side's claim.
        link: from which it comes, or None if it is an operator of this side.
    """

    who: str
    link: Link | None = None

    def log(self, context: Context, level: Level, code: StrEnum, text: str) -> None:
        """Log the beginning, the end or the refusal of an order."""
        link = "" if self.link is None else self.link.name
        context.log(level, code, f"{text}, by {self.who}", link=link, who=self.who, from_peer=self.link is not None)


class _Ticket(NamedTuple):
    """A ticket that has begun nothing yet.

    Attributes:
        until: time (s) of `Context.now`.
        association: in which it counts. One of a peer that has not told of this feature is not told by `connected`.
    """

    until: float
    association: object


class OrderExtension(Extension, Generic[AnswerT, OrderT, OutcomeT]):
    """Orders of one kind over one link, in both directions.

    Attributes:
        question, answer, order, end, outcome: types of its messages, and of what an end tells.
        longest: seconds that an operator waits for an end.
    """

    question: type[OrderQuestion]
    answer: type[AnswerT]
    order: type[OrderT]
    end: type[OrderEnd[OutcomeT]]
    outcome: type[OutcomeT]
    longest: float

    def __init__(self, link: Link) -> None:
        self.messages = {
            self.question: self._asked,
            self.answer: self._answered,
            self.order: self._ordered,
            self.end: self._ended,
        }
        self._link = link
        self._questions: Questions[AnswerT] = Questions(link, TICKET_WITHIN)
        self._request = 0
        self._peer_has = False
        self._last_ticket = link.context.wall_ns() >> 16
        """A bridge that ran before under this name has given lower ones only."""
        self._given: dict[int, _Ticket] = {}
        self._allowance = TokenBucket(ASKED, ASKED / ASKED_WITHIN, link.context.now())
        self._runs: dict[int, asyncio.Task[OutcomeT]] = {}
        self._reporting: set[int] = set()
        """Tickets of orders whose ends this association's peer waits for."""
        self._waits: dict[int, tuple[OrderT, asyncio.Future[OutcomeT]]] = {}

    def connected(self) -> None:
        self._peer_has = True
        for order, _ in self._waits.values():
            self._link.send(msgspec.structs.replace(order, again=True))

    def disconnected(self) -> None:
        self._questions.disconnected()
        self._reporting.clear()
        self._peer_has = False

    # --- for the peer

    async def list_for(self, asker: Asker, request: int) -> AnswerT:
        """Return what this side has, as far as one may see it."""
        raise NotImplementedError

    def carry_out(self, order: OrderT, asker: Asker) -> Coroutine[None, None, OutcomeT]:
        """Carry out the peer's order, or refuse it. It goes on if nobody waits for it any more."""
        raise NotImplementedError

    def _asked(self, ask: OrderQuestion) -> None:
        self._questions.answer(ask.request, partial(self._answer, ask))

    async def _answer(self, ask: OrderQuestion) -> AnswerT:
        if not ask.ticket:
            return await self.list_for(Asker("", self._link), ask.request)
        self._last_ticket += 1
        self._given[self._last_ticket] = _Ticket(self._link.context.now() + TICKET_LIFE, self._link.association)
        if len(self._given) > _MOST_TICKETS:
            del self._given[min(self._given)]
        return self.answer(ask.request, self._last_ticket)

    def _ordered(self, order: OrderT) -> None:
        run = self._runs.get(order.ticket)
        if run is None:
            if reason := self._refusal(order):
                # Given again, it may have run, and be forgotten: a bridge that was started again knows nothing of it.
                self._link.send(self.end(order.ticket, self.outcome(refused=not order.again, reason=reason)))
                return
            run = self._begin(order)
        if order.ticket not in self._reporting:
            self._reporting.add(order.ticket)
            self._link.spawn(self._report(order.ticket, run))

    def _refusal(self, order: OrderT) -> str:
        """Return the reason why an order is not even judged, or an empty string; it is not logged."""
        until, association = self._given.pop(order.ticket, _Ticket(0.0, None))
        now = self._link.context.now()
        if association is not self._link.association or now >= until:
            return (OrderProblem.FORGOTTEN if order.again else OrderProblem.TOO_LATE)()
        return "" if self._allowance.take(1, now) else OrderProblem.TOO_OFTEN(seconds=ASKED_WITHIN / ASKED)

    def _begin(self, order: OrderT) -> asyncio.Task[OutcomeT]:
        asker = Asker(f"{self._link.peer_name}, which says: {order.who or 'an operator'}", self._link)
        run = self._link.context.loop.create_task(self.carry_out(order, asker))
        self._runs[order.ticket] = run
        over = [ticket for ticket, each in self._runs.items() if each.done()]
        for ticket in over[:-_REMEMBERED]:
            del self._runs[ticket]
        return run

    async def _report(self, ticket: int, run: asyncio.Task[OutcomeT]) -> None:
        association = self._link.association
        outcome = await asyncio.shield(run)
        self._reporting.discard(ticket)
        if self._link.association is association:  # another one asks again
            self._link.send(self.end(ticket, outcome))

    # --- for this side's operators

    async def list_of_peer(self) -> AnswerT:
        """Return what the peer has.

        Raises:
            LinkError: the link is down, or the peer has no such feature or does not answer.
        """
        return await self._ask(ticket=False)

    async def give(self, order: OrderT) -> OutcomeT:
        """Have the peer carry out an order, over any number of connections; raises as `list_of_peer`."""
        ticket = (await self._ask(ticket=True)).ticket
        if ticket in self._waits:
            raise LinkError(OrderProblem.TWICE(link=self._link.name))
        order = msgspec.structs.replace(order, ticket=ticket, who=sanitize_text(operator(), TEXT_LENGTH))
        end: asyncio.Future[OutcomeT] = self._link.context.loop.create_future()
        self._waits[ticket] = order, end
        try:
            self._link.send(order)
            async with asyncio.timeout(self.longest):
                return await end
        except TimeoutError:
            raise LinkError(OrderProblem.SILENT(link=self._link.name)) from None
        finally:
            del self._waits[ticket]

    async def _ask(self, *, ticket: bool) -> AnswerT:
        self.check_peer()
        self._request += 1
        return await self._questions.ask(self._request, self.question(self._request, ticket))

    def check_peer(self) -> None:
        if not self._link.linked:
            raise LinkError(Denied.NOT_LINKED(name=self._link.name, reason=self._link.down_reason))
        if not self._peer_has:
            raise LinkError(OrderProblem.NOT_THERE(feature=self.feature))

    def _answered(self, answer: AnswerT) -> None:
        self._questions.answered(answer.request, answer)

    def _ended(self, ended: OrderEnd[OutcomeT]) -> None:
        if ended.ticket in self._waits and not (end := self._waits[ended.ticket][1]).done():
            end.set_result(ended.outcome)
