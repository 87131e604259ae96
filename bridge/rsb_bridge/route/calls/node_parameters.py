"""The two halves of the route of a node's parameters, which pass on the events of that node only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.event_node import ParameterEventError, node_of, with_node
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.calls_verdict import Trouble
from rsb_bridge.route.calls.providing import ProvidingRoute

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


class CallingParametersRoute(CallingRoute):
    """Offers a node's parameters here."""

    def _take_message(self, frame: CallFrame) -> None:
        """Publish a parameter event of the peer, if it is about the route's node."""
        try:
            why = "" if node_of(frame.content) == self.local_topic else "it is about another node"
        except ParameterEventError as error:
            why = str(error)
        if why:
            text = f"a parameter event of the peer is left out: {why}"
            self.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, text)
        else:
            super()._take_message(frame)


class ProvidingParametersRoute(ProvidingRoute):
    """Tells the peer of a node's parameters here, and passes its calls on."""

    def _find(self) -> Provision:
        found = super()._find()
        if (missing := found.unavailable) is None or missing.cause is not Cause.NO_SERVER:
            return found
        # The node may be there without parameters, or with some of the services.
        node, servers = self.local_topic, self.context.ros.servers
        if any(servers(member.name_on(node)) for member in self.members if not member.is_topic):
            text = NoParameters.SOME_SERVICES(missing=missing.text, node=node)
        elif servers(node + _EVERY_NODE_HAS):
            text = NoParameters.NO_SERVICES(node=node, domain=self.context.domain_id)
        else:
            return found
        return found._replace(unavailable=Trouble(Cause.NO_PARAMETERS, text))

    def published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        """Send the parameter events of the route's node, with the node's name on the callers' side."""
        own, node = [], self.local_topic
        for message in messages:
            try:
                if node_of(message.payload) == node:
                    renamed = message.payload if self.topic == node else with_node(message.payload, self.topic)
                    own.append(message._replace(payload=renamed))
            except ParameterEventError as error:
                text = f"a parameter event is left out: {error}"
                self.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, text)
        super().published(lane, own)
