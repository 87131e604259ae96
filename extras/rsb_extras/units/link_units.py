"""Units over one link: what its peer may see and ask for here, and what this side's operators ask for there.

An action needs a ticket, which is asked for just before, counts once and for some seconds. So nothing is carried out
twice, nor because of a request that has waited for a lost link.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import (
    TEXT_LENGTH,
    ControlMessageBase,
    Count,
    Extension,
    LinkError,
    Name,
    Questions,
    TokenBucket,
    Wording,
    operator,
    sanitize_text,
)
from rsb_extras.units.unit_records import UnitAction, UnitName, UnitOutcome, UnitRecords
from rsb_extras.units.unit_requests import LONGEST, TICKET_WITHIN
from rsb_extras.units.unit_runner import Asker, UnitProblem, UnitRunner

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Link
    from rsb_extras.units.unit_records import UnitRecord

TICKET_LIFE = 5.0
"""s that a ticket counts. A round figure: a link that takes longer for two messages is too slow for such requests."""

_ASKED, ASKED_WITHIN = 12, 60.0
"""Requests of a peer that are judged in so many s, refused ones too. Twice as many as may begin."""


class AskUnits(ControlMessageBase, frozen=True):
    """Asks for the other side's units, or for a ticket. Answered by a `UnitAnswer` of the same number.

    Attributes:
        ticket: whether a ticket is asked for, and no units. Lists take no tickets: each would make another one void.
    """

    request: Count
    ticket: bool = False


class UnitAnswer(ControlMessageBase, frozen=True):
    """A side's units, or a ticket.

    Attributes:
        ticket: for one `RunUnit`, or 0; the tickets before it are void.
    """

    request: Count
    ticket: Count = 0
    units: UnitRecords = ()


class RunUnit(ControlMessageBase, frozen=True):
    """Asks for an action on a unit. Answered by a `UnitEnded` of the same ticket.

    Attributes:
        who: the operator, as the asking side says.
    """

    ticket: Count
    unit: UnitName
    action: UnitAction
    who: Name = ""


class UnitEnded(ControlMessageBase, frozen=True):
    """The end of an action, or why it was refused."""

    ticket: Count
    outcome: UnitOutcome


class LinkUnitsProblem(Wording):
    AWAY = "not linked: {reason}"
    NOT_LINKED = "{link} is not linked: {reason}"
    NOT_THERE = "the other side's installation has no units: install all of rsb-console there"
    BUSY = "an action on a unit of {link} is under way: wait until that is over"
    LOST = "the link was lost: look at the unit's state before you ask again"
    SILENT = "{link} did not answer: look at the unit's state before you ask again"
    TOO_LATE = "the request came too late, and nothing was done: ask again"


class _Ticket(NamedTuple):
    """The newest ticket that a peer has.

    Attributes:
        until: time (s) of `Context.now`.
        association: in which it counts. One of a peer that has not told of this feature is not told by `connected`.
    """

    number: int
    until: float
    association: object


class LinkUnits(Extension):
    """One link's units, in both directions.

    Questions and answers that a lost connection takes along are sent on the next one by the association. So nothing is
    asked again there: a ticket asked for twice would be void.
    """

    def __init__(self, link: Link) -> None:
        self.messages = {
            AskUnits: self._asked,
            UnitAnswer: self._answered,
            RunUnit: self._run_asked,
            UnitEnded: self._ended,
        }
        self._link = link
        self._runner = link.context.shared(UnitRunner)
        self._runner.links.add(link)
        self._questions: Questions[UnitAnswer] = Questions(link, TICKET_WITHIN)
        self._request = 0
        self._peer_has = False
        self._given = _Ticket(0, 0.0, None)
        self._allowance = TokenBucket(_ASKED, _ASKED / ASKED_WITHIN, link.context.now())
        """Of the peer's requests, refused ones too: each is logged."""
        self._waits: tuple[int, asyncio.Future[UnitOutcome]] | None = None

    def connected(self) -> None:
        self._peer_has = True

    def disconnected(self) -> None:
        self._questions.disconnected()
        self._peer_has = False
        if self._waits is not None and not self._waits[1].done():
            self._waits[1].set_exception(LinkError(LinkUnitsProblem.LOST()))

    # --- for the peer

    def _asked(self, ask: AskUnits) -> None:
        self._questions.answer(ask.request, partial(self._answer, ask))

    async def _answer(self, ask: AskUnits) -> UnitAnswer:
        if not ask.ticket:
            return UnitAnswer(ask.request, units=await self._runner.records(Asker("", self._link)))
        until = self._link.context.now() + TICKET_LIFE
        self._given = _Ticket(self._given.number + 1, until, self._link.association)
        return UnitAnswer(ask.request, self._given.number)

    def _run_asked(self, ask: RunUnit) -> None:
        number, until, association = self._given
        is_valid, now = ask.ticket == number and association is self._link.association, self._link.context.now()
        if not is_valid or now >= until:
            reason = LinkUnitsProblem.TOO_LATE()
        else:
            reason = "" if self._allowance.take(1, now) else UnitProblem.TOO_OFTEN(most=_ASKED, seconds=ASKED_WITHIN)
        if reason:
            self._link.send(UnitEnded(ask.ticket, UnitOutcome(refused=True, reason=reason)))
            return
        self._given = _Ticket(number, 0.0, None)
        self._link.spawn(self._run_for_peer(ask))

    async def _run_for_peer(self, ask: RunUnit) -> None:
        association = self._link.association
        asker = Asker(f"{self._link.peer_name}, which says: {ask.who or 'an operator'}", self._link)
        outcome = await self._runner.run(ask.unit, ask.action, asker)
        if self._link.association is association:  # another one knows nothing of it
            self._link.send(UnitEnded(ask.ticket, outcome))

    # --- for this side's operators

    async def list_units(self) -> tuple[UnitRecord, ...]:
        """Return the peer's units.

        Raises:
            LinkError: the link is down, or the peer has no such feature or does not answer.
        """
        return (await self._ask(ticket=False)).units

    async def run(self, unit: str, action: UnitAction) -> UnitOutcome:
        """Have the peer carry out an action; raises as `list_units`."""
        if self._waits is not None:
            raise LinkError(LinkUnitsProblem.BUSY(link=self._link.name))
        done: asyncio.Future[UnitOutcome] = self._link.context.loop.create_future()
        self._waits = 0, done
        try:
            ticket = (await self._ask(ticket=True)).ticket
            self._waits = ticket, done
            self._link.send(RunUnit(ticket, unit, action, sanitize_text(operator(), TEXT_LENGTH)))
            async with asyncio.timeout(LONGEST):
                return await done
        except TimeoutError:
            raise LinkError(LinkUnitsProblem.SILENT(link=self._link.name)) from None
        finally:
            self._waits = None
            if done.done() and not done.cancelled():
                done.exception()  # nobody may have waited for it yet

    async def _ask(self, *, ticket: bool) -> UnitAnswer:
        if not self._link.linked:
            raise LinkError(LinkUnitsProblem.NOT_LINKED(link=self._link.name, reason=self._link.down_reason))
        if not self._peer_has:
            raise LinkError(LinkUnitsProblem.NOT_THERE())
        self._request += 1
        return await self._questions.ask(self._request, AskUnits(self._request, ticket))

    def _answered(self, answer: UnitAnswer) -> None:
        self._questions.answered(answer.request, answer)

    def _ended(self, ended: UnitEnded) -> None:
        if self._waits is not None and self._waits[0] == ended.ticket and not self._waits[1].done():
            self._waits[1].set_result(ended.outcome)
