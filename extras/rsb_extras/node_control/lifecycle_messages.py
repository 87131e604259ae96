"""The services of a managed node (lifecycle_msgs), and what their requests and answers mean."""

from __future__ import annotations

from typing import NamedTuple

from rsb_bridge.feature_api import sanitize_text
from rsb_extras.node_control.cdr_fields import FieldReader, FieldWriter
from rsb_extras.node_control.change_records import TRANSITIONS, Transition

GET_STATE, GET_STATE_TYPE = "/get_state", "lifecycle_msgs/srv/GetState"
GET_OFFERS, GET_OFFERS_TYPE = "/get_available_transitions", "lifecycle_msgs/srv/GetAvailableTransitions"
CHANGE_STATE, CHANGE_STATE_TYPE = "/change_state", "lifecycle_msgs/srv/ChangeState"
NO_FIELDS = FieldWriter().message
_STATE_LENGTH = 32
_MOST_OFFERS = 32
"""Transitions in an answer. A node has at most five, and these may have other names."""


class OfferedTransition(NamedTuple):
    """A transition that a node offers now, and its number there."""

    transition: Transition
    number: int


def read_state(answer: bytes) -> str:
    """Return the state in an answer of GetState; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    reader.number("B")
    return sanitize_text(reader.text(), _STATE_LENGTH)


def read_offers(answer: bytes) -> tuple[OfferedTransition, ...]:
    """Return the transitions in an answer of GetAvailableTransitions; raise `MalformedAnswerError`."""
    reader = FieldReader(answer)
    found: dict[Transition, OfferedTransition] = {}
    for _ in range(reader.count(20, _MOST_OFFERS)):
        number, label = int(reader.number("B")), reader.text()
        for _ in ("start", "goal"):
            reader.number("B")
            reader.text()
        for each in TRANSITIONS:
            if each == label:
                found[each] = OfferedTransition(each, number)
    return tuple(found.values())


def change_request(offer: OfferedTransition) -> bytes:
    """Return a request of ChangeState."""
    return FieldWriter().number("B", offer.number).text(offer.transition).message


def read_success(answer: bytes) -> bool:
    """Return whether an answer of ChangeState says that the transition has succeeded; raise `MalformedAnswerError`."""
    return bool(FieldReader(answer).number("B"))
