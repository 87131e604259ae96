"""Changes of nodes over one link: what its peer may see and ask for here, and what operators ask for there.

A change needs a ticket, which is asked for just before, counts for some seconds, and stands for one change: asked again
by the same ticket, on the next connection, a side answers with how that change goes or has ended.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import msgspec

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
from rsb_extras.node_control.change_records import NO_COMPONENT, ChangeAction, ChangeOutcome, Component, Managed, Target
from rsb_extras.node_control.change_requests import LONGEST, TICKET_WITHIN
from rsb_extras.node_control.node_changer import STARTS, STARTS_WITHIN, ChangeAsker, ChangeProblem, NodeChanger
from rsb_extras.node_control.parameter_records import AskParameters, NewValues, ParametersAnswer

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Link

TICKET_LIFE = 5.0
"""s that a ticket counts. A round figure: a link that takes longer for two messages is too slow for such requests."""
_MOST_TICKETS = 4
"""Tickets that a peer may have at a time: one for each operator who asks just now."""
_PAGE_WITHIN = 20.0
"""s for a page of parameters, of which the node has 6, and a thin line some more. A round figure."""
_REMEMBERED = 8
"""Changes of a peer whose ends are remembered for its next connection."""


class AskManaged(ControlMessageBase, frozen=True, omit_defaults=True):
    """Asks for the other side's managed nodes, or for a ticket. Answered by a `ManagedAnswer` of the same number.

    Attributes:
        ticket: whether a ticket is asked for, and no nodes.
    """

    request: Count
    ticket: bool = False


class ManagedAnswer(ControlMessageBase, frozen=True, omit_defaults=True):
    """A side's managed nodes, or a ticket.

    Attributes:
        ticket: for one change, or 0.
    """

    request: Count
    ticket: Count = 0
    managed: Managed = Managed()


class RunChange(ControlMessageBase, frozen=True, omit_defaults=True):
    """Asks for a change. Answered by a `ChangeEnded` of the same ticket, once it has ended or if it is refused.

    Attributes:
        who: the operator, as the asking side says.
        again: whether it was asked for on another connection already.
        values: parameters to be set, if that is the action, or of a component that is loaded.
        component: to be loaded or unloaded.
    """

    ticket: Count
    target: Target
    action: ChangeAction
    who: Name = ""
    again: bool = False
    values: NewValues = ()
    component: Component = NO_COMPONENT


class ChangeEnded(ControlMessageBase, frozen=True):
    """The end of a change, or why it was refused."""

    ticket: Count
    outcome: ChangeOutcome


class LinkChangesProblem(Wording):
    AWAY = "not linked: {reason}"
    NOT_LINKED = "{link} is not linked: {reason}"
    NOT_THERE = "the other side's installation has no node_control: install all of rsb-console there"
    SILENT = "{link} did not answer: look at the nodes' states before you ask again"
    TWICE = "{link} gave the ticket of another change, and nothing was done: ask again once that change is over"
    TOO_LATE = "the request came too late, and nothing was done: ask again"
    FORGOTTEN = "the bridge there knows nothing of it any more: look at the nodes' states before you ask again"


class _Ticket(NamedTuple):
    """A ticket that has begun nothing yet.

    Attributes:
        until: time (s) of `Context.now`.
        association: in which it counts. One of a peer that has not told of this feature is not told by `connected`.
    """

    until: float
    association: object


class _Waiting(NamedTuple):
    """A change that this side has asked for."""

    request: RunChange
    outcome: asyncio.Future[ChangeOutcome]


class LinkChanges(Extension):
    """One link's changes of nodes, in both directions."""

    def __init__(self, link: Link) -> None:
        self.messages = {
            AskManaged: self._asked,
            ManagedAnswer: self._answered,
            RunChange: self._run_asked,
            ChangeEnded: self._ended,
            AskParameters: self._parameters_asked,
            ParametersAnswer: self._parameters_answered,
        }
        self._link = link
        self._changer = link.context.shared(NodeChanger)
        self._changer.links.add(link)
        self._questions: Questions[ManagedAnswer] = Questions(link, TICKET_WITHIN)
        self._pages: Questions[ParametersAnswer] = Questions(link, _PAGE_WITHIN)
        self._request = 0
        self._peer_has = False
        self._last_ticket = link.context.wall_ns() >> 16
        """No bridge that ran before under this name has given those that follow."""
        self._given: dict[int, _Ticket] = {}
        self._allowance = TokenBucket(STARTS, STARTS / STARTS_WITHIN, link.context.now())
        """Of the peer's requests, refused ones too: each is logged."""
        self._runs: dict[int, asyncio.Task[ChangeOutcome]] = {}
        self._reporting: set[int] = set()
        """Tickets of changes whose ends this connection's peer waits for."""
        self._waits: dict[int, _Waiting] = {}

    def connected(self) -> None:
        self._peer_has = True
        for request, _ in self._waits.values():
            self._link.send(msgspec.structs.replace(request, again=True))

    def disconnected(self) -> None:
        self._questions.disconnected()
        self._pages.disconnected()
        self._reporting.clear()
        self._peer_has = False

    # --- for the peer

    def _asked(self, ask: AskManaged) -> None:
        self._questions.answer(ask.request, partial(self._answer, ask))

    async def _answer(self, ask: AskManaged) -> ManagedAnswer:
        if not ask.ticket:
            return ManagedAnswer(ask.request, managed=await self._changer.managed(ChangeAsker("", self._link)))
        self._last_ticket += 1
        self._given[self._last_ticket] = _Ticket(self._link.context.now() + TICKET_LIFE, self._link.association)
        if len(self._given) > _MOST_TICKETS:
            del self._given[min(self._given)]
        return ManagedAnswer(ask.request, self._last_ticket)

    def _run_asked(self, ask: RunChange) -> None:
        run = self._runs.get(ask.ticket)
        if run is None:
            if reason := self._refusal(ask):
                # Asked again, it may have run, and be forgotten: a bridge that was started again knows nothing of it.
                self._link.send(ChangeEnded(ask.ticket, ChangeOutcome(refused=not ask.again, reason=reason)))
                return
            run = self._begin(ask)
        if ask.ticket not in self._reporting:
            self._reporting.add(ask.ticket)
            self._link.spawn(self._report(ask.ticket, run))

    def _refusal(self, ask: RunChange) -> str:
        """Return the reason why a request is not even judged, or an empty string; it is not logged."""
        until, association = self._given.pop(ask.ticket, _Ticket(0.0, None))
        now = self._link.context.now()
        if association is not self._link.association or now >= until:
            return (LinkChangesProblem.FORGOTTEN if ask.again else LinkChangesProblem.TOO_LATE)()
        if not self._allowance.take(1, now):
            return ChangeProblem.TOO_OFTEN(most=STARTS, seconds=STARTS_WITHIN)
        return ""

    def _begin(self, ask: RunChange) -> asyncio.Task[ChangeOutcome]:
        asker = ChangeAsker(f"{self._link.peer_name}, which says: {ask.who or 'an operator'}", self._link)
        work = self._changer.run(ask.target, ask.action, asker, ask.values, ask.component)
        run = self._link.context.loop.create_task(work)
        self._runs[ask.ticket] = run
        over = [ticket for ticket, each in self._runs.items() if each.done()]
        for ticket in over[:-_REMEMBERED]:
            del self._runs[ticket]
        return run

    async def _report(self, ticket: int, run: asyncio.Task[ChangeOutcome]) -> None:
        association = self._link.association
        outcome = await asyncio.shield(run)
        self._reporting.discard(ticket)
        if self._link.association is association:  # another one asks again
            self._link.send(ChangeEnded(ticket, outcome))

    def _parameters_asked(self, ask: AskParameters) -> None:
        self._pages.answer(ask.request, partial(self._changer.parameters, ask, ChangeAsker("", self._link)))

    # --- for this side's operators

    async def managed(self) -> Managed:
        """Return the peer's managed nodes.

        Raises:
            LinkError: the link is down, or the peer has no such feature or does not answer.
        """
        return (await self._ask(ticket=False)).managed

    async def parameters(self, ask: AskParameters) -> ParametersAnswer:
        """Return the peer's answer to a question, whose number does not matter; raises as `managed`."""
        self._check_peer()
        self._request += 1
        return await self._pages.ask(self._request, msgspec.structs.replace(ask, request=self._request))

    async def run(
        self, target: str, action: ChangeAction, values: NewValues = (), component: Component = NO_COMPONENT
    ) -> ChangeOutcome:
        """Have the peer carry out a change, over any number of connections; raises as `managed`."""
        ticket = (await self._ask(ticket=True)).ticket
        if ticket in self._waits:
            raise LinkError(LinkChangesProblem.TWICE(link=self._link.name))
        who = sanitize_text(operator(), TEXT_LENGTH)
        request = RunChange(ticket, target, action, who, values=values, component=component)
        waiting = self._waits[ticket] = _Waiting(request, self._link.context.loop.create_future())
        try:
            self._link.send(request)
            async with asyncio.timeout(LONGEST):
                return await waiting.outcome
        except TimeoutError:
            raise LinkError(LinkChangesProblem.SILENT(link=self._link.name)) from None
        finally:
            del self._waits[ticket]

    async def _ask(self, *, ticket: bool) -> ManagedAnswer:
        self._check_peer()
        self._request += 1
        return await self._questions.ask(self._request, AskManaged(self._request, ticket))

    def _check_peer(self) -> None:
        if not self._link.linked:
            raise LinkError(LinkChangesProblem.NOT_LINKED(link=self._link.name, reason=self._link.down_reason))
        if not self._peer_has:
            raise LinkError(LinkChangesProblem.NOT_THERE())

    def _answered(self, answer: ManagedAnswer) -> None:
        self._questions.answered(answer.request, answer)

    def _parameters_answered(self, answer: ParametersAnswer) -> None:
        self._pages.answered(answer.request, answer)

    def _ended(self, ended: ChangeEnded) -> None:
        waiting = self._waits.get(ended.ticket)
        if waiting is not None and not waiting.outcome.done():
            waiting.outcome.set_result(ended.outcome)
