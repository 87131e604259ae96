"""Messages of orders, which `rsb_bridge.link.orders` explains: a feature has its own of each kind."""

from __future__ import annotations

from typing import Generic, TypeVar

from rsb_bridge.wire.messages import ControlMessageBase
from rsb_bridge.wire.records import Count, Name, OrderOutcome

TICKET_WITHIN = 10.0
"""s for a ticket or a list from the other side, which looks for the states in it for 2 s at most."""


class OrderQuestion(ControlMessageBase, frozen=True, omit_defaults=True):
    """Asks what the other side has, or for a ticket. Answered by an `OrderAnswer` of the same number.

    Attributes:
        ticket: whether a ticket is asked for.
    """

    request: Count
    ticket: bool = False


class OrderAnswer(ControlMessageBase, frozen=True, omit_defaults=True):
    """Tells of all that a side has, or gives a ticket.

    Attributes:
        ticket: for one `OrderBase`, or 0.
    """

    request: Count
    ticket: Count = 0


class OrderBase(ControlMessageBase, frozen=True, omit_defaults=True, kw_only=True):
    """Answered by an `OrderEnd` of the same ticket, once it has ended or if it is refused.

    Attributes:
        who: the operator, as the asking side says.
        again: whether it was given in another association already.
    """

    ticket: Count = 0
    who: Name = ""
    again: bool = False


OutcomeT = TypeVar("OutcomeT", bound=OrderOutcome)


class OrderEnd(ControlMessageBase, Generic[OutcomeT], frozen=True):
    """The end of an order, or why it was refused."""

    ticket: Count
    outcome: OutcomeT
