"""The parameters of a node: of the events of all nodes, its route passes on those of that node only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.event_node import ParameterEventError, node_of, with_node
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.calls.asked_calls import CallerKind
from rsb_bridge.route.calls.calls_end import Trouble
from rsb_bridge.route.calls.provided_calls import ProviderKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.calls.call_servers import Provision
    from rsb_bridge.wire.headers import CallFrame

_EVERY_NODE_HAS = "/get_type_description"
"""A service of nearly every node, with parameters or without."""


class NoParameters(Wording):
    """Reasons why the parameters of a node that runs cannot be reached."""

    SOME_SERVICES = "{missing}: {node} has only some of the parameter services"
    NO_SERVICES = "{node} is in domain {domain}, but has no parameter services: it was started without them"


class CallerParameters(CallerKind):
    """Keeps events of other nodes from subscribers here."""

    def publishes(self, frame: CallFrame) -> bool:
        try:
            why = "" if node_of(frame.content) == self._route.local_topic else "it is about another node"
        except ParameterEventError as error:
            why = str(error)
        if why:
            text = f"a parameter event of the peer is left out: {why}"
            self._route.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, text)
        return not why


class ProviderParameters(ProviderKind):
    """Sends the events of the route's node, and explains why it has no parameters."""

    def explained(self, found: Provision) -> Provision:
        if (missing := found.unavailable) is None or missing.cause is not Cause.NO_SERVER:
            return found
        # The node may be there without parameters, or with some of the services.
        node, ros, members = self._route.local_topic, self._route.context.ros, self._flow.members
        if any(ros.servers(member.name_on(node)) for member in members if not member.is_topic):
            text = NoParameters.SOME_SERVICES(missing=missing.text, node=node)
        elif ros.servers(node + _EVERY_NODE_HAS):
            text = NoParameters.NO_SERVICES(node=node, domain=self._route.context.domain_id)
        else:
            return found
        return found._replace(unavailable=Trouble(Cause.NO_PARAMETERS, text))

    def published(self, lane: int, messages: Sequence[RawMessage]) -> Sequence[RawMessage]:
        """Return the events of the route's node, with the node's name on the callers' side."""
        own, node, callers_node = [], self._route.local_topic, self._route.topic
        for message in messages:
            try:
                if node_of(message.payload) == node:
                    payload = message.payload if callers_node == node else with_node(message.payload, callers_node)
                    own.append(message._replace(payload=payload))
            except ParameterEventError as error:
                text = f"a parameter event is left out: {error}"
                self._route.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, text)
        return own
