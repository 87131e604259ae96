"""The halves of a route of a node's parameters: its services, and its events among those of all nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.verdict import Cause
from rsb_bridge.ros.parameter_events import EventsTopic, ParameterEventError, node_of, with_node
from rsb_bridge.route.calls.call_endpoints import Clients
from rsb_bridge.route.calls.calling import CallingRoute
from rsb_bridge.route.calls.calls_verdict import Trouble
from rsb_bridge.route.calls.providing import ProvidingRoute

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.parameter_events import Listening
    from rsb_bridge.ros.ros_interface import RawMessage
    from rsb_bridge.route.calls.call_endpoints import LaneType
    from rsb_bridge.route.calls.call_servers import Provision
    from rsb_bridge.wire.headers import CallFrame
    from rsb_bridge.wire.records import LaneEntry

_EVERY_NODE_HAS = "/get_type_description"
"""A service of nearly every node, with parameters or without."""


class _ParameterClients(Clients):
    """Clients of a node's services; its events come by the subscription that all nodes' routes share."""

    node = ""

    def _open_topic(self, lane: int, name: str, kind: LaneType) -> Listening:
        qos = self._lanes[lane].qos
        assert qos is not None
        sink, failed = self._sink(lane, self._published)
        topic = EventsTopic(name, kind.type_name, kind.type_hash, self._peer.name)
        return self._context.parameter_events.listen(topic, qos, self.node, sink.put, failed)


class ParametersProvidingRoute(ProvidingRoute):
    """Passes on the events of its node alone, under the name that it has on the callers' side."""

    makes = _ParameterClients
    _clients: _ParameterClients

    def _have_clients(self, entries: Sequence[LaneEntry]) -> None:
        self._clients.node = self.local_topic
        super()._have_clients(entries)

    def _published(self, lane: int, messages: Sequence[RawMessage]) -> None:
        passed = [each._replace(payload=event) for each in messages if (event := self._renamed(each.payload))]
        if passed:
            super()._published(lane, passed)

    def _renamed(self, event: bytes) -> bytes | None:
        """An event as callers know its node; None: it is another node's, or none at all."""
        try:
            if node_of(event) != self.local_topic:
                return None
            return event if self.topic == self.local_topic else with_node(event, self.topic)
        except ParameterEventError as error:
            self.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, f"a parameter event is left out: {error}")
            return None

    def _find(self) -> Provision:
        found = super()._find()
        trouble = found.unavailable
        if trouble is None or trouble.cause is not Cause.NO_SERVER:
            return found
        return found._replace(unavailable=self._why_none(trouble))

    def _why_none(self, trouble: Trouble) -> Trouble:
        """Whether the node is missing, or only its parameters are."""
        ros = self.context.ros
        if any(ros.servers(name) for lane, name in zip(self.lanes, self.local_names, strict=True) if not lane.is_topic):
            text = f"{trouble.text}: {self.local_topic} serves only a part of what parameters take"
            return Trouble(Cause.NO_PARAMETERS, text)
        if ros.servers(self.local_topic + _EVERY_NODE_HAS):
            text = f"{self.local_topic} is in domain {self.context.domain_id}, and serves no parameters: it was made "
            return Trouble(Cause.NO_PARAMETERS, f"{text}without parameter services")
        return trouble


class ParametersCallingRoute(CallingRoute):
    """Publishes no event but the node's own, whatever the peer sends."""

    def _take_message(self, frame: CallFrame) -> None:
        try:
            node = node_of(frame.content)
        except ParameterEventError as error:
            self._left_out(str(error))
            return
        if node != self.local_topic:
            self._left_out("it is about another node")
            return
        super()._take_message(frame)

    def _left_out(self, why: str) -> None:
        self.notices.message_error(EventCode.ROUTE_EVENT_LEFT_OUT, f"a parameter event of the peer is left out: {why}")
