"""The managed nodes of this side: which there are, and one transition of one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import Wording
from rsb_extras.node_control.cdr_fields import MalformedAnswerError
from rsb_extras.node_control.change_records import (
    GOALS,
    MOST_MANAGED,
    ChangeStep,
    LifecycleAction,
    ManagedNode,
)
from rsb_extras.node_control.lifecycle_messages import (
    CHANGE_STATE,
    CHANGE_STATE_TYPE,
    GET_OFFERS,
    GET_OFFERS_TYPE,
    GET_STATE,
    GET_STATE_TYPE,
    NO_FIELDS,
    OfferedTransition,
    change_request,
    read_offers,
    read_state,
    read_success,
)
from rsb_extras.node_control.node_services import NodeSilentError, both, nodes_serving

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.feature_api import Context
    from rsb_extras.node_control.change_records import Transition
    from rsb_extras.node_control.node_services import NodeServices

TRANSIT_WITHIN = 60.0
"""s for one transition. A round figure: Nav2's planner loads its map and its plugins in some."""
_LOOK_WITHIN = 5.0
_LISTED_WITHIN = 2.0  # s for the states in a list. Round figures
_UP: tuple[Transition, ...] = "configure", "activate"
_DOWN: tuple[Transition, ...] = "deactivate", "cleanup"
_FORWARD = frozenset(_UP)
_BEYOND: Mapping[Transition, frozenset[str]] = {
    "configure": frozenset(("inactive", "active")),
    "activate": frozenset(("active",)),
    "deactivate": frozenset(("inactive", "unconfigured", "finalized")),
    "cleanup": frozenset(("unconfigured", "finalized")),
    "shutdown": frozenset(("finalized",)),
}
"""The states in which a node needs a transition no more."""


class LifecycleProblem(Wording):
    """The reason why a node does not change its state."""

    NOT_OFFERED = "{node} is {state}: it offers {offers} now"
    REFUSED = "{node} refused to {transition}, and is {state} now: see its log"
    NO_ANSWER = "{node}: its answer about its lifecycle cannot be read: {error}"


class LifecycleLook(NamedTuple):
    """The state of a node, and what it offers there."""

    state: str
    offers: tuple[OfferedTransition, ...]


def phases(action: LifecycleAction, nodes: Sequence[str]) -> list[tuple[Transition, Sequence[str]]]:
    """Return the transitions of an action, each with the nodes in the order in which they take it.

    As Nav2's lifecycle manager does, all nodes take one transition before the first takes the next.
    """
    transitions = {"up": _UP, "down": _DOWN}.get(action) or (action,)
    return [(each, nodes if each in _FORWARD else nodes[::-1]) for each in transitions]  # type: ignore[misc]  # no up


async def managed_names(context: Context) -> tuple[str, ...]:
    """Return the names of nodes with a lifecycle, sorted."""
    return await nodes_serving(context, GET_STATE, GET_STATE_TYPE, MOST_MANAGED, also=CHANGE_STATE)


async def look_at(services: NodeServices, node: str, within: float = _LOOK_WITHIN) -> LifecycleLook:
    """Return a node's state, and what it offers; raise `NodeSilentError`."""
    state, offers = await both(
        services.call(node, GET_STATE, GET_STATE_TYPE, NO_FIELDS, within),
        services.call(node, GET_OFFERS, GET_OFFERS_TYPE, NO_FIELDS, within),
    )
    try:
        return LifecycleLook(read_state(state), read_offers(offers))
    except MalformedAnswerError as error:
        raise NodeSilentError(LifecycleProblem.NO_ANSWER(node=node, error=error)) from None


async def managed_node(services: NodeServices, node: str) -> ManagedNode:
    """Return what is known of a node; one that does not answer has no state."""
    try:
        look = await look_at(services, node, _LISTED_WITHIN)
    except NodeSilentError:
        return ManagedNode(node)
    return ManagedNode(node, look.state, tuple(each.transition for each in look.offers))


async def transit(context: Context, services: NodeServices, node: str, transition: Transition) -> ChangeStep | None:
    """Have a node take a transition; return None if it needs it no more."""
    began, state, reason = context.now(), "", ""
    try:
        look = await look_at(services, node)
        state = look.state
        if state in _BEYOND[transition]:
            return None
        offer = next((each for each in look.offers if each.transition == transition), None)
        if offer is None:
            offers = ", ".join(each.transition for each in look.offers) or "nothing"
            reason = LifecycleProblem.NOT_OFFERED(node=node, state=state, offers=offers)
        else:
            state, is_done = await _change(services, node, offer)
            if not is_done:
                reason = LifecycleProblem.REFUSED(node=node, transition=transition, state=state or "silent")
    except NodeSilentError as error:
        reason = str(error)
    return ChangeStep(node, transition, state, reason, context.now() - began)


async def _change(services: NodeServices, node: str, offer: OfferedTransition) -> tuple[str, bool]:
    """Return the state after a transition, and whether the transition has led there."""
    answer = await services.call(node, CHANGE_STATE, CHANGE_STATE_TYPE, change_request(offer), TRANSIT_WITHIN)
    try:
        is_done = read_success(answer)
    except MalformedAnswerError as error:
        raise NodeSilentError(LifecycleProblem.NO_ANSWER(node=node, error=error)) from None
    try:
        state = (await look_at(services, node)).state
    except NodeSilentError:
        # A node may end with its shutdown.
        return "", is_done and offer.transition == "shutdown"
    return state, is_done and state == GOALS[offer.transition]
