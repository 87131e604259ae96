"""Records what operators of the other side do to routes, marked as claims of the other side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import operator
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.lifecycle import PAUSE_WORDS

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.model.session import Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import ByHand, Propose

_AT_ONCE, _A_SECOND = 20.0, 1 / 300
"""Actions of one link's peer that are recorded: the time line keeps 500 of all operators, and a peer must not displace
the actions of this side."""


def acting_operator() -> str:
    """Return the name of the present command's operator, for the other side."""
    return sanitize_text(operator(), TEXT_LENGTH)


def called(route: Route, lane: int, outcome: str = "") -> str:
    """Return the text on a manual call of a route's lane; an unknown lane comes from a newer version."""
    lanes = LANES[route.spec.kind]
    name = lanes[lane].name if lane < len(lanes) else ""
    what = f"{name} called" if name else "called"
    return f"{what} ({outcome})" if outcome else what


class PeerOperators:
    """Records the actions of the other side's operators, within a budget; the routes log them as well.

    The operator's name is the other side's claim, and is marked so: it cannot be mistaken for one of this side.
    """

    def __init__(self, context: Context, peer_name: str) -> None:
        self._events = context.events
        self._now = context.now
        self._peer_name = peer_name
        self._budget = TokenBucket(_AT_ONCE, _A_SECOND, context.now())

    def says(self, who: str) -> str:
        """Return the other side's claim of who it was; `who` may be empty."""
        return f"{self._peer_name} says: {who or 'an operator'}"

    def paused(self, route: Route, who: str) -> None:
        """Record that a route was paused or resumed there; `who` may be empty."""
        paused = route.pausing.paused
        code = EventCode.OPERATOR_PAUSED if paused else EventCode.OPERATOR_RESUMED
        what = "paused" if paused else "resumed"
        self._did(code, what, route, who, PAUSE_WORDS[not paused], PAUSE_WORDS[paused])

    def proposed(self, route: Route, proposal: Propose, *, edited: bool) -> None:
        """Record that an operator there has added or edited a topic, if the proposal names one."""
        if proposal.who and edited:
            self.edited(route, proposal.who, None)
        elif proposal.who:
            self._did(EventCode.OPERATOR_ADDED, "added", route, proposal.who, "", described(route.spec))

    def edited(self, route: Route, who: str, old: Topic | None) -> None:
        """Record that an operator there has changed a topic, which was `old`, or None if that is unknown."""
        what = "changed" if old is None else f"changed ({', '.join(changes(old, route.spec)) or 'nothing differs'})"
        before = "" if old is None else described(old)
        self._did(EventCode.OPERATOR_EDITED, what, route, who, before, described(route.spec))

    def removed(self, route: Route, who: str) -> None:
        """Record that an operator there has removed a topic."""
        self._did(EventCode.OPERATOR_REMOVED, "removed", route, who, described(route.spec), "")

    def dropped_demand(self, route: Route, who: str) -> None:
        """Record that an operator there has dropped the demand to arm a topic."""
        self._did(EventCode.OPERATOR_ARM_DROPPED, "the demand to be armed dropped", route, who, "", "")

    def called(self, route: Route, message: ByHand) -> None:
        """Record the begin or the end of a manual call by an operator there, or a message that one publishes."""
        code = EventCode.OPERATOR_CALL_ENDED if message.outcome else EventCode.OPERATOR_CALLED
        what, new = called(route, message.lane, message.outcome), message.outcome or message.request
        if route.spec.kind == "topic":
            code, what = EventCode.OPERATOR_PUBLISHED, "published by hand"
        self._did(code, what, route, message.who, "", new)

    def _did(self, code: EventCode, what: str, route: Route, who: str, old: str, new: str) -> None:
        if not route.purpose.is_shown:
            return  # a view, whose beginning and end are logged with the topic that is looked at
        if not self._budget.take(1, self._now()):
            return
        topic, who = route.local_topic, self.says(who)
        text, link = f"{topic}: {what}, {who}", route.peer.name
        self._events.add(Level.INFO, code, text, link=link, topic=topic, who=who, old=old, new=new, from_peer=True)
