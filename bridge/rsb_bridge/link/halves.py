"""The halves of routes: which one this side has, and what it is told by the other one about what it carries."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.model.calls import FEATURE
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.calling_action import CallingAction
from rsb_bridge.route.calls.node_parameters import ParametersCallingRoute, ParametersProvidingRoute
from rsb_bridge.route.calls.providing import ProvidingRoute
from rsb_bridge.route.calls.providing_action import ProvidingAction
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.wire.messages import Describe, Provide, Publishers, Ready

if TYPE_CHECKING:
    from collections.abc import Container

    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Propose

_HALVES: dict[str, tuple[type[Route], type[Route]]] = {
    "topic": (OutgoingRoute, IncomingRoute),
    "service": (CallingRoute, ProvidingRoute),
    "action": (CallingAction, ProvidingAction),
    "parameters": (ParametersCallingRoute, ParametersProvidingRoute),
}
"""By kind: of the side that sends, or calls, and of the other one."""


def half_of(proposal: Propose, *, is_client: bool) -> type[Route]:
    """What a route's half on this side is made of."""
    sending, receiving = _HALVES[proposal.kind]
    return sending if proposal.from_client == is_client else receiving


def unsupported(proposal: Propose, features: Container[str]) -> str:
    """Why a peer with these features cannot be asked for that; empty: it can."""
    if proposal.kind == "topic" or FEATURE in features:
        return ""
    return "the other side's rsb-console is too old for services, actions and parameters: update it"


HalfMessage: TypeAlias = Describe | Ready | Publishers | Provide
"""The control messages that one half has for the other, by what they carry."""


def hand_over(message: HalfMessage, route: Route) -> None:
    """Give a message to this side's half; one that such a half does not take is ignored."""
    match message:
        case Describe() if isinstance(route, IncomingRoute):
            route.described(message)
        case Ready() if isinstance(route, OutgoingRoute):
            route.peer_ready(message)
        case Publishers() if isinstance(route, IncomingRoute):
            route.publishers_present(message.present)
        case Provide() if isinstance(route, CallingRoute):
            route.provided(message)
